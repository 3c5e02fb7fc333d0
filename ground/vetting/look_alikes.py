"""Probabilities given how many look-alikes a frame has: lines of the same kind that a search of its negative found.

A vetter's classes are those that were simulated. A frame that nobody calibrated has others: ripples, dust rings, slopes. Their
rate is measured in the frame itself and enters the odds as one more class. A frame that stands alone does not tell stars from
short trails either.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.guard import guarded, probabilities_of
from ground.streaks.centre_line import effective_width_px
from ground.vetting.alike import LookAlikes, follows_readout
from ground.vetting.any_camera import LEAST_PROBABILITY, as_unmodelled, contrasts_of, others_near, probability_in_any_camera
from ground.vetting.bends import bends_too_much
from ground.vetting.beside import against_beside
from ground.vetting.borders import against_border
from ground.vetting.contrast import Contrast, Tiles
from ground.vetting.crosses import Crosses
from ground.vetting.galaxies import of_galaxy
from ground.vetting.likelihood import sharpest_light_px, sharpness_of
from ground.vetting.meteors import for_meteor
from ground.vetting.particles import SHARP, odds_of_particles
from ground.vetting.radiants import for_radiant
from ground.vetting.repeated import doubled
from ground.vetting.rim import ImageCircle
from ground.vetting.short_lines import SHORT_PX, SHORTEST_PX, against_short_lines
from ground.vetting.sides import SkyMap
from ground.vetting.spikes import BrightStars
from ground.vetting.star_arcs import of_turning_stars
from ground.vetting.star_rows import FULL_PER_FRAME, FULL_SNR, LN_LENGTHS, REAL_PER_FRAME, StarField
from ground.vetting.star_trails import Motion, against_chains, move_as
from ground.vetting.surroundings import Surroundings
from ground.vetting.two_areas import is_border
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from sboc_e2e.icd.steps import Vetter

REAL_DENSITY: Final = REAL_PER_FRAME / (math.log(800.0 / 5.0) * LN_LENGTHS)
"""Expected real streaks of a frame for each unit of ln S/N and ln length: half a streak, anything between S/N 5 and 800 and
1.7 and 400 px alike."""

POINT_WIDTHS: Final = 10.0
"""Fits up to so many widths long are points: four full widths. Two hot pixels were 5 px long at S/N 1,070, 0.7 px wide."""
POINTS_PER_REAL: Final = 2.0
"""Hot pixels and cores of stars for each real object of this kind, in frames that were held against others. The neighbours are
where a mover shows again: what they link is published from `ground.veto_below` on, and a point alone is not. Of seven false
lines in 142 frames given together four were points with p of 0.6. Chosen, not measured."""

SPILLED_PER_REAL: Final = FULL_PER_FRAME / REAL_PER_FRAME
"""Expected lines of spilled charge of full stars for each real streak."""
ALIGNED_SHARE: Final = 0.045
"""Share of trails that run along rows or columns: 4 atan(`ALIGNED_SLOPE`) of pi."""

LEAST_TELLING: Final = 0.1
"""Probability from which on a line tells how sharp the optics are, where no star does: by the vetter, and by all but its
sharpness. A band along the rim of a fisheye, 7 px wide and of 0.016 by the vetter, was the only line that told, and nine meteors
of 0.3 to 0.6 px were refused as too sharp. So were eleven beside the ridge of a hill, 5 px wide, of 0.14 and 0.03."""

LEAST_SNR: Final = 7.0
"""Fainter lines of a frame that stands alone are refused: white noise has 0.1 of this S/N in 4096 x 4096 px. The detector asks
for 7.2, but a fit may find less light than it. Of 300 frames of others two had such a line with 0.5 or more, none a trail."""

SHARPEST_LIGHT: Final = -1.0
"""Ln of width over that of the stars, below which a line is no light of optics that are sharper than these told. Of 29 such
lines in 371 frames of others one lies on a trail; published trails go down to -0.73. Tracks of particles beside stars of FWHM
2 px have -1.1. Two columns of a raw frame, 0.05 px wide, had p of 0.64 and 0.98 while its drawn-out stars told a PSF."""
TOO_SHARP: Final = 0.03
"""Probability of such a line, at most: one in 29."""

LEAST: Final = 1e-12
"""Keeps the odds finite."""


def as_sharp_as(
    short_axis_px: float, fits: Sequence[StreakFit], frame: DownlinkFrame
) -> tuple[Sequence[StreakFit], DownlinkFrame]:
    """Fits and their frame whose optics are as sharp as the short axis of its stars, or sharper; unknown ones stay unknown."""
    if frame.psf_sigma_px is None or frame.psf_sigma_px <= short_axis_px:
        return fits, frame
    sharp = [replace(fit, psf_sigma_px=min(fit.psf_sigma_px, short_axis_px)) for fit in fits]
    return sharp, replace(frame, psf_sigma_px=short_axis_px)


def of_spilled_charge(fit: StreakFit) -> float:
    """Odds of spilled charge against a trail: charge of full pixels runs along columns, or rows, and a trail seldom does."""
    full = fit.snr > FULL_SNR or StreakFlag.SATURATED in fit.flags
    return SPILLED_PER_REAL / ALIGNED_SHARE if full and follows_readout(fit.row1 - fit.row0, fit.col1 - fit.col0) else 0.0


def _is_point(fit: StreakFit) -> bool:
    """Whether a fit is about as long as it is wide."""
    return fit.length_px < POINT_WIDTHS * effective_width_px(fit.width_px)


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnEvidence:
    """What a frame itself says of its false lines.

    look_alikes : lines that cannot be real.
    surroundings : the picture about the lines; of none where it was not looked at.
    alone : it was held against no other frame of the same sky, so that stars are not told from what moves.
    seen : first and last row, first and last column in which a pixel saw the sky; None: all of them.
    stars : motion of the stars during the exposure, where the detections of the frame share one; None: they do not.
    shared : finds it among the fits where it is not among the detections, told whether the frame has round stars; None: nothing.
    sky : a map of the sky, slopes and edges included; None: there is none.
    field : the listed stars and the counts around short lines; None: rows of stars are not judged.
    bright : the listed stars with their places; None: spikes are not judged.
    crosses : stars whose arms show in the picture; None: they were not looked for.
    circle : of a lens that does not fill the frame; None: it does, or is not known.
    tiles : counts around the lines; None: the lines are not held against their neighbourhood.
    short_axis_px : of the images of the stars (sigma, the pixel's own taken off); None: they do not tell.
    points : whether the images of the stars are far from lines, told or not how sharp the optics are.
    """

    look_alikes: LookAlikes = field(default_factory=LookAlikes)
    surroundings: Surroundings = field(default_factory=Surroundings)
    alone: bool = False
    seen: tuple[int, int, int, int] | None = None
    stars: Motion | None = None
    shared: Callable[[Sequence[StreakFit], bool], Motion | None] | None = None
    sky: SkyMap | None = None
    field: StarField | None = None
    bright: BrightStars | None = None
    crosses: Crosses | None = None
    circle: ImageCircle | None = None
    tiles: Tiles | None = None
    short_axis_px: float | None = None
    points: bool = False

    def stars_among(self, fits: Sequence[StreakFit], *, round_stars: bool) -> Motion | None:
        """Motion of the stars where they are lines. In a dense field detections of several run together, and fits part them.

        round_stars : whether the frame has stars that are points, which told its PSF.
        """
        return self.shared(fits, round_stars) if self.stars is None and self.shared is not None else self.stars

    def refuses(self, fit: StreakFit, frame: DownlinkFrame) -> bool:
        """Whether a fit may be a slope or an edge, runs along a rim, bends too much, or lies where no pixel saw."""
        if self.sky is not None and self.sky.refuses(fit, frame.header.gain_e_adu or 1.0):
            return True
        if self.circle is not None and self.circle.refuses(fit):
            return True
        shape = frame.header.rows, frame.header.cols
        if bends_too_much(fit, shape, None if self.circle is None else self.circle.radius_px):
            return True
        if self.seen is None:
            return False
        top, bottom, left, right = self.seen
        row, col = 0.5 * (fit.row0 + fit.row1), 0.5 * (fit.col0 + fit.col1)
        return not (top - 0.5 <= row <= bottom + 0.5 and left - 0.5 <= col <= right + 0.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Optics:
    """How sharp the lines of a frame are.

    sharpness : ln of each width over that of the optics, NaN where nothing tells these. by_stars : whether stars tell the optics,
    and no long light is sharper.
    """

    sharpness: list[float]
    by_stars: bool

    @property
    def no_light(self) -> NDArray[np.bool_]:
        """Which lines (n,) are too sharp to be light."""
        return np.less(self.sharpness, SHARPEST_LIGHT) & self.by_stars

    def galaxies(self, fits: Sequence[StreakFit]) -> NDArray[np.float64]:
        """Odds (n,) of galaxies, where stars tell the optics."""
        return np.array([of_galaxy(fit, ln) if self.by_stars else 0.0 for fit, ln in zip(fits, self.sharpness, strict=True)])

    def tracks(self, fits: Sequence[StreakFit]) -> NDArray[np.float64]:
        """Odds (n,) of a particle's track for the lines that are sharper than the optics; infinite where they are no light."""
        sharp = [self.by_stars and each < SHARP for each in self.sharpness]
        return np.where(self.no_light, np.inf, odds_of_particles(fits, sharp))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Lines:
    """Lines of a frame, with what is known of them, and the rules that make probabilities of it, in the order of their use.

    fits : as they were measured. sharp, frame : they and their frame, with optics as sharp as the short axis of its stars.
    known : what the frame itself says. short : (n,) what may be a blend of stars. own : (n,) the vetter's probabilities.
    contrasts : of what may be a trail, where there are tiles. stars : motion of the stars where they are lines.
    """

    fits: Sequence[StreakFit]
    sharp: Sequence[StreakFit]
    frame: DownlinkFrame
    known: OwnEvidence
    short: NDArray[np.bool_]
    own: NDArray[np.float64]
    contrasts: Sequence[Contrast | None]
    stars: Motion | None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        return self.frame.header.rows, self.frame.header.cols

    @property
    def round_stars(self) -> bool:
        """Whether the frame has stars that are points, which told its PSF."""
        return self.frame.psf_sigma_px is not None

    @cached_property
    def borders(self) -> NDArray[np.float64]:
        """Odds (n,) of lines along a border of what was seen."""
        seen = self.known.seen
        return np.array([0.0 if seen is None else against_border(fit, seen) for fit in self.fits])

    @cached_property
    def spikes(self) -> NDArray[np.float64]:
        """Odds (n,) of arms of stars whose arms show in the picture."""
        crosses = self.known.crosses
        return np.array([0.0 if crosses is None else crosses.against(fit) for fit in self.fits])

    def possible(self) -> NDArray[np.float64]:
        """Probabilities (n,) by the vetter and by all that speaks against lines, whatever the camera; 0 of refused ones."""
        refused = self._refused()
        odds_against = (1.0 - self.own) / np.maximum(self.own, LEAST) + self._against_kinds() + self.borders
        odds_against = self._with_parallels(odds_against, refused)
        return np.where((self.own > 0.0) & ~refused, 1.0 / (1.0 + odds_against), 0.0)

    def _against_kinds(self) -> NDArray[np.float64]:
        """Odds (n,) of the kinds of false lines that the frame shows, those along borders apart."""
        fits, known = self.fits, self.known
        against = known.look_alikes.near(fits, self.contrasts) / REAL_DENSITY
        against = against + np.array([of_spilled_charge(fit) for fit in fits])
        if not known.alone:
            against = against + np.array([POINTS_PER_REAL * _is_point(fit) for fit in fits])
        if known.field is not None:
            gain = self.frame.header.gain_e_adu or 1.0
            against = against + np.array([known.field.against(fit, gain) for fit in fits])
        if known.bright is not None:
            against = against + np.array([known.bright.against(fit) for fit in fits])
        against = against + self.spikes
        return against if self.stars is None else against + against_chains(self.stars, fits)

    def _refused(self) -> NDArray[np.bool_]:
        """Which lines (n,) no odds save: by the frame's own evidence, too short to be told from stars, as faint as noise, or
        moving as stars do.
        """
        refused = np.array([self.known.refuses(fit, self.frame) for fit in self.fits])
        # nothing but its contrast tells a short line from a star
        untold = [c is None or fit.length_px < SHORTEST_PX for fit, c in zip(self.fits, self.contrasts, strict=True)]
        refused |= self.short & np.array(untold)
        if self.known.alone:
            refused |= np.array([fit.snr < LEAST_SNR for fit in self.fits])
        if self.stars is not None:
            refused |= move_as(self.stars, self.fits)
        return refused

    def _with_parallels(self, odds_against: NDArray[np.float64], refused: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Odds against (n,) with those of parallel lines beside each line that may still be a trail."""
        tiles, out = self.known.tiles, odds_against.copy()
        if tiles is None:
            return out
        area_px2 = float(self.shape[0] * self.shape[1])
        trails = [fit for fit, no in zip(self.fits, refused, strict=True) if not no]
        for k in np.flatnonzero((odds_against < 1.0 / LEAST_PROBABILITY) & ~refused).tolist():
            out[k] += against_beside(self.fits[k], tiles, area_px2, trails)
        return out

    def in_any_camera(self, possible: NDArray[np.float64], tiles: Tiles) -> NDArray[np.float64]:
        """Probabilities (n,) with the weights across cameras and the rules of the whole frame, of what is possible so far."""
        told = zip(self.contrasts, possible.tolist(), strict=True)
        contrasts = [each if p >= LEAST_PROBABILITY else None for each, p in told]
        about, others = self.known.surroundings.about(self.fits), others_near(self.fits, self.shape)

        def weighed(sharpness: Sequence[float], tracks: NDArray[np.float64]) -> NDArray[np.float64]:
            return probability_in_any_camera(self.fits, possible, sharpness, contrasts, tracks, others, about)

        optics = self._optics(possible, weighed)
        given = self._by_light_along(weighed(optics.sharpness, optics.tracks(self.fits)), contrasts, tiles)
        # such lines win all along them, as trails do: their contrast and length do not outweigh their places
        at_most = 1.0 / (1.0 + self.borders + self.spikes + optics.no_light / TOO_SHARP + optics.galaxies(self.fits))
        return self._among_others(given, at_most, [1.0 if contrast is None else contrast.wins for contrast in contrasts])

    def _optics(
        self,
        possible: NDArray[np.float64],
        weighed: Callable[[Sequence[float], NDArray[np.float64]], NDArray[np.float64]],
    ) -> _Optics:
        """How sharp the optics are by stars and by lines that may be light. weighed : with a sharpness and odds of tracks."""
        # half lines of video are as long and bright as light, and no optics made them
        may_tell = (possible > 0.0) & (self.borders < 1.0)
        psf_sigma_px = self.frame.psf_sigma_px
        if psf_sigma_px is None:
            # lines tell how sharp the optics are that the vetter finds likely, and all else but their sharpness
            else_told = weighed([math.nan] * len(self.fits), np.full(len(self.fits), math.inf))
            may_tell &= np.minimum(possible, else_told) > LEAST_TELLING
        sharpest = sharpest_light_px(self.sharp, may_tell.tolist())
        # stars may be wider than the optics, and long light is not
        by_stars = psf_sigma_px is not None and psf_sigma_px <= sharpest
        return _Optics(sharpness=sharpness_of(self.sharp, psf_sigma_px, sharpest), by_stars=by_stars)

    def _by_light_along(
        self, given: NDArray[np.float64], contrasts: Sequence[Contrast | None], tiles: Tiles
    ) -> NDArray[np.float64]:
        """Probabilities (n,) by how the light of each line goes along and beside it: 0 of borders of areas, more of meteors."""
        out = given.copy()
        for k in np.flatnonzero(given >= LEAST_PROBABILITY).tolist():
            # stars rise and fall as meteors do
            rises = 1.0 if self.short[k] else for_meteor(self.fits[k], tiles, contrasts[k])
            out[k] = 0.0 if is_border(self.fits[k], tiles) else with_odds(given[k], rises)
        return out

    def _among_others(
        self, given: NDArray[np.float64], at_most: NDArray[np.float64], wins: Sequence[float]
    ) -> NDArray[np.float64]:
        """Probabilities (n,) by the rules on all lines of a frame together. at_most : (n,) by their places. wins : of contrasts.

        Repeats go before lines are held against each other, and once more after that, where others may have become the likelier.
        """
        fits, round_stars = self.fits, self.round_stars
        given = _once(fits, np.minimum(given, at_most), wins)
        given = np.where(of_turning_stars(fits, given, self.shape, round_stars=round_stars), 0.0, given)
        shower = for_radiant(fits, given, self.shape, round_stars=round_stars or self.known.points)
        given = np.minimum(with_odds(given, shower), at_most)
        given = given / (1.0 + given * against_short_lines(fits, self.short))
        if self.known.crosses is not None:
            given = np.where(self.known.crosses.crossed(fits, given), 0.0, given)
        return _once(fits, given, wins)


def _once(fits: Sequence[StreakFit], given: NDArray[np.float64], wins: Sequence[float]) -> NDArray[np.float64]:
    """Probabilities (n,), 0 of lines that repeat others."""
    return np.where(doubled(fits, given, wins), 0.0, given)


@dataclass(frozen=True, kw_only=True, eq=False)
class LookAlikeVetter:
    """Another vetter's probabilities, with the look-alikes of each frame as one more class of what is not real.

    evidence : by frame number.
    """

    vetter: Vetter
    evidence: Mapping[int, OwnEvidence]

    def probability(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """Probabilities, shape (len(fits),), of being a real object."""
        known = self.evidence.get(frame.header.frame)
        if known is None or not fits:
            return self._of_classes(fits, frame)
        lines = self._lines(fits, frame, known)
        possible = lines.possible()
        return possible if known.tiles is None else lines.in_any_camera(possible, known.tiles)

    def _lines(self, fits: Sequence[StreakFit], frame: DownlinkFrame, known: OwnEvidence) -> _Lines:
        """The lines of a frame with the vetter's probabilities and their contrasts."""
        stars = known.stars_among(fits, round_stars=frame.psf_sigma_px is not None)
        sharp = fits
        if known.short_axis_px is not None:
            sharp, frame = as_sharp_as(known.short_axis_px, fits, frame)
        # what may be a blend of stars says nothing of the rates of longer lines
        short = np.array([known.alone and fit.length_px < SHORT_PX for fit in fits], dtype=np.bool_)
        own = self._of_classes(sharp, frame)
        if short.any() and not short.all():
            own[~short] = self._of_classes(list(compress(sharp, ~short)), frame)
        contrasts: list[Contrast | None] = [None] * len(fits)
        if known.tiles is not None:
            contrasts = contrasts_of(fits, own, known.tiles)
            own = as_unmodelled(fits, own, contrasts)
        return _Lines(fits=fits, sharp=sharp, frame=frame, known=known, short=short, own=own, contrasts=contrasts, stars=stars)

    def _of_classes(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """The other vetter's probabilities (len(fits),), an array of their own."""
        where = f"frame {frame.header.frame}"
        given = guarded("vetter", self.vetter, where, object, self.vetter.probability, fits, frame)
        return probabilities_of(self.vetter, where, given, len(fits)).copy()


def with_odds(probability: NDArray[np.float64], odds: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Probabilities whose odds are multiplied."""
    return probability * odds / (probability * odds + 1.0 - probability)
