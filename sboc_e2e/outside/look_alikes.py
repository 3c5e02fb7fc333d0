"""A frame's own count of look-alikes: lines that the detector finds in the negative of the frame.

Nothing real is darker than the sky. Ripples, dust rings, slopes and correlated noise have both signs. What the same search finds
in the negative, after the same background, masks and star list, is therefore what it finds falsely in the frame (the target-decoy
method of Elias and Gygi 2007, doi:10.1038/nmeth1019). What is bright alone, such as cosmic rays, is not counted this way.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from ground.vetting.alike import LookAlikes, follows_readout
from ground.vetting.contrast import Contrast, Line, Tiles
from ground.vetting.crosses import Crosses
from ground.vetting.look_alikes import OwnEvidence
from ground.vetting.readout import is_of_readout
from ground.vetting.short_lines import SHORT_PX
from ground.vetting.sides import SkyMap
from ground.vetting.spikes import BrightStars
from ground.vetting.star_rows import FWHM_PER_SIGMA, LONGEST_PX, MARGIN_PX, MOST_PIXELS, Crop, StarField
from ground.vetting.surroundings import Picture, Surroundings
from onboard.chain import OnboardChain
from onboard.detect.line_integral.detector import LineIntegralDetector
from onboard.detect.line_integral.star_removal import TILE_PX
from onboard.detect.line_integral.static_sky import EarlierFrame, earlier_frame, segment_snr_before
from onboard.detect.whiten import unusable
from onboard.image.registration import IDENTITY
from onboard.latency import REACH_PX
from onboard.options import OnboardOptions
from onboard.state import OnboardResult, OnboardState, OnboardSteps, Prepared
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.results import check_detections
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.icd.steps import Detector
from sboc_e2e.outside import second_processor
from sboc_e2e.outside.frame_memory import FrameMemory
from sboc_e2e.outside.limits import work_meter
from sboc_e2e.outside.star_axes import StarAxes
from sboc_e2e.outside.star_lines import stars_as_lines

IN_WHITE_NOISE: Final = 1.0 / 3.0
"""False lines for each dark one that stands out of white noise, but not of the lines beside it. The threshold of the frame itself
follows the lines beside a detection too, and stars lift bright lines over it: of bright lines 40 to 90 % pass it in frames with
structure and of dark ones 5 to 30 % (22 real and simulated frames), so that it hides most of these."""

WITHOUT_STRUCTURE: Final = 3.0
"""Such lines that say nothing. Eight fields of 4,000 stars in 512 x 512 px, drawn without any structure, have 0 to 3 between
their stars (1.0 in the mean). Four frames of three cameras with interference, nebulae and clouds have 9 to 47."""

LEVELS_SNR: Final = (10.0, 20.0, 50.0, 100.0)
"""S/N at which the counts are published, beside the count of all."""

SHADOW_PX: Final = 64.0
"""Side of the tiles of the sky level. A bright trail lifts the level of its tiles, and leaves dark lines beside itself."""

SHADOW_SNR: Final = 2.0
"""A shadow is fainter than its trail by this factor at least."""

RECURRING_SHARE: Final = 0.5
"""Share of its S/N from which on a dark line was there in the frame beside it too. Chosen, not measured: chance gives 1 / S/N."""

PROFILE_PX: Final = 32
"""How far to both sides of a line its profile is looked at."""

CORE_PX: Final = 2
"""Pixels within it of a line hold its light."""

LEAST_WIDTH_PX: Final = 0.1
"""Sigma of the narrowest dark line, that of a pixel taken off."""

NO_LINE: Final = StreakFlag.POINT_LIKE | StreakFlag.COSMIC_LIKE


def negative_of(view: DetectorView) -> DetectorView:
    """The view with bright and dark exchanged, without neighbouring frames and with work of its own."""
    negative = np.negative(view.residual_adu)
    negative.flags.writeable = False
    return replace(view, residual_adu=negative, history=(), work=work_meter(negative.size))


@dataclass(frozen=True, kw_only=True)
class Dark:
    """The negative of a view and the lines that the detector finds in it.

    structure : lines that stand out of white noise, but not of the lines beside them.
    """

    view: DetectorView
    lines: Sequence[Detection]
    structure: Sequence[Detection] = ()

    @classmethod
    def of(cls, detector: Detector, view: DetectorView) -> "Dark":
        """Search the negative of a view."""
        negative = negative_of(view)
        if not isinstance(detector, LineIntegralDetector):
            found = detector.detect(negative)
            check_detections(found, view.mask.shape)
            return cls(view=negative, lines=found)
        # most bright lines as short are stars, which have no negative: dark ones would tell little of them
        detector = replace(detector, blend_px=max(detector.blend_px, SHORT_PX))
        in_white_noise, found = detector.detect_in_white_noise(negative)
        known = {_ends(each) for each in found}
        return cls(view=negative, lines=found, structure=tuple(each for each in in_white_noise if _ends(each) not in known))


def _ends(line: Detection) -> tuple[float, float, float, float]:
    return line.row0, line.col0, line.row1, line.col1


def look_alikes(dark: Dark, view: DetectorView, detections: Sequence[Detection]) -> LookAlikes:
    """The lines in the negative of a frame that tell of false ones.

    detections : of the frame itself. Dark lines beside a line that is much brighter are its shadow and do not count. Neither do
    lines of the readout: the vetter of uncalibrated frames refuses such lines by their place, and they tell nothing of others.
    Nor do dark lines that a neighbouring frame has too, among the stars or on the sensor: bright ones that stay are not detected.
    """

    def of_readout(line: Detection) -> bool:
        shape = view.header.rows, view.header.cols
        return is_of_readout(line.row1 - line.row0, line.col1 - line.col0, view.psf_sigma_px, shape)

    earlier = earlier_frame(view, REACH_PX) if (dark.lines or dark.structure) and view.history else None

    def counting(lines: Sequence[Detection]) -> list[Detection]:
        return [
            each
            for each in lines
            if not (each.flags & NO_LINE or of_readout(each) or any(_shadow(each, of) for of in detections))
            and not (earlier is not None and _recurs(each, earlier, view))
        ]

    lines, structure = counting(dark.lines), counting(dark.structure)
    share = IN_WHITE_NOISE * max(1.0 - WITHOUT_STRUCTURE / len(structure), 0.0) if structure else 0.0
    if share == 0.0:
        structure = []
    weighted = [(each, 1.0) for each in lines] + [(each, share) for each in structure]
    weighted.sort(key=lambda pair: -pair[0].snr)
    counted = [each for each, _ in weighted]
    table = np.array(
        [
            (
                each.snr, each.length_px, *shape_of(each, dark.view.residual_adu, dark.view.mask),
                follows_readout(each.row1 - each.row0, each.col1 - each.col0),
            )
            for each in counted
        ],
        dtype=np.float64,
    ).reshape(-1, 5)  # fmt: skip
    weight = np.array([each for _, each in weighted], dtype=np.float64)
    return LookAlikes(
        table=table,
        weight=weight,
        stand_out=_stand_out(counted, table[:, 2], dark.view),
        place=np.array([(0.5 * (each.row0 + each.row1), 0.5 * (each.col0 + each.col1)) for each in counted]).reshape(-1, 2),
        shape=view.mask.shape,
    )


def _stand_out(lines: Sequence[Detection], width_px: NDArray[np.float64], negative: DetectorView) -> NDArray[np.float64]:
    """Wins and peak (k, 2) of lines of a negative, whose widths (k,) include that of a pixel; NaN where nothing tells them."""
    tiles = Tiles.of(negative.residual_adu, negative.mask, [_ends(each) for each in lines])
    own = np.sqrt(np.maximum(width_px**2 - PIXEL_VARIANCE_PX2, LEAST_WIDTH_PX**2))
    shaped = [
        Line(
            row0=each.row0, col0=each.col0, row1=each.row1, col1=each.col1, length_px=each.length_px, width_px=w,
            sagitta_px=each.sagitta_px, snr=each.snr,
        )
        for each, w in zip(lines, own.tolist(), strict=True)
    ]  # fmt: skip
    seen = [Contrast.of(each, tiles) for each in shaped]
    told = [(math.nan, math.nan) if each is None else (each.wins, each.peak) for each in seen]
    return np.array(told, dtype=np.float64).reshape(-1, 2)


def shape_of(line: Detection, residual_adu: NDArray[np.float32], mask: NDArray[np.uint8]) -> tuple[float, float]:
    """Width of a line (sigma of the Gaussian of its full width at half maximum, px; the pixel's own included) and its evenness.

    The profile is the median along the line, masked pixels left out. Its level is the median of the outer half. Evenness is the
    median of the light along the line over its mean, 0 to 1: one clump of the line's light gives 0.
    """
    along = np.linspace(0.0, 1.0, max(2, round(line.length_px)))
    length = max(line.length_px, 1e-6)
    across = np.array([line.col0 - line.col1, line.row1 - line.row0]) / length
    offset = np.arange(-PROFILE_PX, PROFILE_PX + 1)
    row = line.row0 + along[:, None] * (line.row1 - line.row0) + offset * across[0]
    col = line.col0 + along[:, None] * (line.col1 - line.col0) + offset * across[1]
    r, c = np.rint(row).astype(np.int64), np.rint(col).astype(np.int64)
    inside = (r >= 0) & (c >= 0) & (r < mask.shape[0]) & (c < mask.shape[1])
    r, c = np.where(inside, r, 0), np.where(inside, c, 0)
    value = np.where(inside & (mask[r, c] == 0), residual_adu[r, c], np.nan)
    return _width(value, offset), _evenness(value, offset)


def _width(value: NDArray[np.float32], offset: NDArray[np.intp]) -> float:
    """Of pixels (n, k) at n places along a line and k across it; NaN where masked."""
    known = np.isfinite(value).any(axis=0)
    profile = np.zeros(offset.size)
    profile[known] = np.nanmedian(value[:, known], axis=0)
    outer = known & (np.abs(offset) > PROFILE_PX // 2)
    above = profile - (float(np.median(profile[outer])) if outer.any() else 0.0)
    middle = PROFILE_PX - 2 + int(np.argmax(above[PROFILE_PX - 2 : PROFILE_PX + 3]))
    half = above > 0.5 * above[middle]
    left, right = (next((k for k, lit in enumerate(side) if not lit), side.size) for side in (half[middle::-1], half[middle:]))
    return max(left + right - 1, 1) / FWHM_PER_SIGMA


def _evenness(value: NDArray[np.float32], offset: NDArray[np.intp]) -> float:
    """Of the same pixels: those within `CORE_PX` of the line over the outer half. 1 where they do not tell."""
    core, outer = np.abs(offset) <= CORE_PX, np.abs(offset) > PROFILE_PX // 2
    both = np.isfinite(value[:, core]).any(axis=1) & np.isfinite(value[:, outer]).any(axis=1)
    if not both.any():
        return 1.0
    light = np.nanmean(value[both][:, core], axis=1) - np.nanmean(value[both][:, outer], axis=1)
    mean = float(np.mean(light))
    return min(max(float(np.median(light)) / mean, 0.0), 1.0) if mean > 0.0 else 1.0


def seen_of(mask: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """First and last row, first and last column with a pixel that is not masked, of a view that has one."""
    rows, cols = (np.flatnonzero((mask == 0).any(axis=axis)) for axis in (1, 0))
    return int(rows[0]), int(rows[-1]), int(cols[0]), int(cols[-1])


def _recurs(dark: Detection, earlier: EarlierFrame, view: DetectorView) -> bool:
    """Whether the neighbouring frame of a view is dark too where a dark line lies, among the stars or on the sensor."""
    ends = np.array([dark.row0, dark.col0, dark.row1, dark.col1])
    blocked = np.zeros(view.mask.shape, np.uint8)
    level = np.zeros([-(-side // TILE_PX) for side in view.mask.shape], np.float32)
    return any(
        segment_snr_before(earlier.frame.pixels, transform, IDENTITY, (blocked, 0), (level, TILE_PX), ends, view.psf_sigma_px)
        < -RECURRING_SHARE * dark.snr
        for transform in (earlier.transform, IDENTITY)
    )


def _shadow(dark: Detection, of: Detection) -> bool:
    """Whether a dark line lies along a brighter one."""
    if of.length_px == 0.0 or of.snr < SHADOW_SNR * dark.snr:
        return False
    drow, dcol = (of.row1 - of.row0) / of.length_px, (of.col1 - of.col0) / of.length_px
    for row, col in ((dark.row0, dark.col0), (dark.row1, dark.col1)):
        r, c = row - of.row0, col - of.col0
        if abs(r * dcol - c * drow) > SHADOW_PX or not -SHADOW_PX <= r * drow + c * dcol <= of.length_px + SHADOW_PX:
            return False
    return True


@dataclass(frozen=True, kw_only=True, eq=False)
class Sky:
    """Counts of a frame, in units of `adu_scale` ADU, which of its pixels are masked, and the map of its sky.

    unusable : nonzero where a pixel tells nothing; of masked ones the full do tell.
    """

    counts: NDArray[Any]
    adu_scale: np.float32
    mask: NDArray[np.uint8]
    unusable: NDArray[np.uint8]
    map: SkyMap

    @classmethod
    def of(cls, prepared: Prepared) -> "Sky":
        """The sky of a prepared frame."""
        counts, mask = prepared.counts, prepared.view.mask
        hidden = unusable(mask)
        sky = SkyMap.of(counts.pixels, hidden, counts.adu_scale)
        return cls(counts=counts.pixels, adu_scale=np.float32(counts.adu_scale), mask=mask, unusable=hidden, map=sky)

    def stars(self, prepared: Prepared, found: Sequence[Detection]) -> tuple[StarField, BrightStars]:
        """The stars of the frame, with the counts around its short lines; and their places."""
        listed, area_px2 = prepared.view.stars, float(self.mask.size - np.count_nonzero(self.mask))
        bright = BrightStars.of(listed.row, listed.col, listed.flux_e, area_px2)
        return StarField(flux_e=bright.flux_e, area_px2=area_px2, crops=tuple(self._crops(found))), bright

    def tiles(self, found: Sequence[Detection]) -> Tiles:
        """Counts around the lines of the frame, the brightest first."""
        lines = [_ends(line) for line in sorted(found, key=lambda each: -each.snr)]
        return Tiles.of(self.counts, self.unusable, lines, float(self.adu_scale))

    def surroundings(self, found: Sequence[Detection]) -> Surroundings:
        """The picture about the lines of the frame."""
        return Surroundings.of(Picture.of(self.counts, self.unusable), [_ends(line) for line in found])

    def _crops(self, found: Sequence[Detection]) -> Iterator[Crop]:
        """Counts around lines of the frame, short ones first and the brightest of them, as far as `MOST_PIXELS` goes.

        A pair of bright stars was found as a line of 148 px and fitted as one of 50.
        """
        left = MOST_PIXELS
        for line in sorted(found, key=lambda each: (each.length_px > LONGEST_PX, -each.snr)):
            rows, cols = sorted((line.row0, line.row1)), sorted((line.col0, line.col1))
            top, first = (max(math.floor(low) - MARGIN_PX, 0) for low in (rows[0], cols[0]))
            box = slice(top, math.ceil(rows[1]) + MARGIN_PX + 1), slice(first, math.ceil(cols[1]) + MARGIN_PX + 1)
            crop = np.where(self.mask[box] != 0, np.float32(np.nan), self.counts[box].astype(np.float32) * self.adu_scale)
            left -= crop.size
            if left < 0:
                return
            yield Crop(adu=crop, row=top, col=first)


class CountingChain(OnboardChain):
    """The on-board chain, which searches the negative of each frame too. The chain's own results do not depend on it.

    evidence : what is learned of false lines in this way, by frame number. same_exposure : frames that a frame is not compared
    with (`same_exposure.same_exposures`); it may grow as frames come.
    """

    def __init__(
        self,
        options: OnboardOptions,
        steps: OnboardSteps,
        *,
        camera: NominalCamera,
        run_id: int,
        same_exposure: Mapping[int, frozenset[int]] | None = None,
    ) -> None:
        super().__init__(options, steps, calibration=None, camera=camera, run_id=run_id, work_meter=work_meter)
        self._detector = steps.detector
        self._same_exposure = {} if same_exposure is None else same_exposure
        self._memory = FrameMemory(frames=steps.detector.history_frames)
        self.evidence: dict[int, OwnEvidence] = {}

    def history_for(self, state: OnboardState, header: FrameHeader) -> tuple[Any, ...]:
        """As `OnboardChain.history_for`, without frames of the same exposure."""
        same = self._same_exposure.get(header.frame)
        return self._memory.remembered(same) if same else super().history_for(state, header)

    def may_compare(self, one: FrameHeader, other: FrameHeader) -> bool:
        """Whether two frames are of different exposures."""
        return not any(b.frame in self._same_exposure.get(a.frame, ()) for a, b in ((one, other), (other, one)))

    def prepare(self, state: OnboardState, frame: Frame) -> Prepared:
        """As `OnboardChain.prepare`. A frame that came twice is looked at, for nobody sees it otherwise."""
        if frame.header.frame not in self._same_exposure:
            return super().prepare(state, frame)
        prepared = super().prepare(replace(state, pixel_check=None), frame)
        again = prepared.pixel_check == state.pixel_check
        return replace(prepared, flags=prepared.flags | FrameFlag.REPEATED_FRAME) if again else prepared

    def judge(self, state: OnboardState, prepared: Prepared) -> tuple[OnboardState, OnboardResult]:
        """As `OnboardChain.judge`; the search of the negative is added to `evidence`.

        In large frames the negative is searched in a thread beside.
        """
        view = prepared.view
        if not prepared.usable:
            return super().judge(state, prepared)
        number = view.header.frame
        same = self._same_exposure.get(number, frozenset())
        state = replace(state, recent=self._memory.found(same)) if same else state
        worth = isinstance(self._detector, LineIntegralDetector) and second_processor.is_worth(view.mask.size)
        with second_processor.threaded(worth=worth) as begin:
            dark = begin(Dark.of, self._detector, view)
            after, result = super().judge(state, prepared)
            found = result.detections
            seen = Sky.of(prepared) if found else None
            field, bright = seen.stars(prepared, found) if seen else (None, None)
            axes = StarAxes.of(view) if seen else None
            self._memory = self._memory.after(number, after.history[-1:], found, same)
            self.evidence[number] = OwnEvidence(
                look_alikes=look_alikes(dark(), view, found),
                alone=self.looks_back and not view.history,
                seen=seen_of(view.mask),
                stars=stars_as_lines([line for line in found if not line.flags & NO_LINE], shape=view.mask.shape),
                shared=partial(stars_as_lines, shape=view.mask.shape),
                sky=seen.map if seen else None,
                field=field,
                bright=bright,
                crosses=Crosses.of(seen.counts, seen.unusable, bright) if seen and bright else None,
                tiles=seen.tiles(found) if seen else None,
                surroundings=seen.surroundings(found) if seen else Surroundings(),
                short_axis_px=None if axes is None else axes.short_px,
                points=axes is not None and axes.are_points,
            )
        return after, result


def counts_of(known: LookAlikes) -> dict[str, int]:
    """Number of look-alikes, as published: in all, and from each of `LEVELS_SNR` on."""
    table = known.table
    return {"all": len(table)} | {f"snr_{level:g}": int(np.sum(table[:, 0] >= level)) for level in LEVELS_SNR}
