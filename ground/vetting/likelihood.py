"""The step `ground.vetter`: posterior probability of a real object among the classes that detectors deliver.

Each class (real trail, noise maximum, particle track, group of hits, hot line, chain of stars, recurring artefact) has a density
of the features of its fits (`class_densities`) and a rate per frame. The rates start from the options and follow the frame by
expectation-maximisation. If a particle storm fills a frame with sharp short tracks, the odds of each further track change.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.class_densities import REAL, RECURRING, class_densities, log_odds_calibration
from ground.vetting.features import Features, features_of, is_aligned
from ground.vetting.particles import odds_of_particles
from ground.vetting.readout import odds_of_readout
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

ITERATIONS: Final = 40
"""Class probabilities and the frame's rates in turn: a budget of work. Chosen, not measured."""

UNKNOWN_PSF_SIGMA_PX: Final = 1.2
"""PSF sigma where neither stars nor a camera tell it: an FWHM of 2.8 px, between a sampled and an undersampled camera's.
Chosen."""
UNKNOWN_LN_PSF: Final = 0.7
"""One sigma of the logarithm of an unknown PSF's width: half to twice. Cameras sample their PSF: FWHM of 1.4 to 6 px."""

PLACE_LN_PSF: Final = 0.05
"""One sigma of ln of the PSF's width at a place of the field. Stars tell the width at the centre and its growth with the radius;
along and across an astigmatic image of 250 nm rms widths differ by 5 to 10 %."""

PSF_SHAPE_ERROR: Final = 0.03
"""Share of the light that a Gaussian misplaces in the image of a real lens. Trails of S/N 260 and 3,500 with 250 nm of wavefront
error and an aureole of 2 % had a chi-square that asks for 0.04."""

WIDEST_UNKNOWN: Final = 3.0
"""A faint fit that is wider than this many assumed widths is more often a slope of the background than a trail."""

NARROWEST_PX: Final = 0.3
"""No optics in front of pixels are narrower (FWHM 0.7 px): columns, particles. Pictures that were made smaller and sharpened have
lines that are. Their lengths tell these from particles, and columns do not drift."""

LEAST_SNR_UNKNOWN: Final = 12.0
"""S/N up to which lines of a frame without a PSF are refused. Residuals of the flat field and rows of stars reach 20 and more,
and are told by the frame itself (docs/vetting.md, faint lines without a PSF)."""

FARTHEST_OUTSIDE_PX: Final = 20.0
"""A fit that ends farther outside the frame has left its pixels."""

GROUPED: Final = 0.05
"""Groups of hits that are taken for one trail, for each track that is: about as at 1,000 hits in a frame of 4096 x 4096; storms
of 5,000 have more and quiet frames none."""

LN_BRIGHTEST_SNR: Final = math.log(100.0)
LN_BRIGHTEST_SNR_UNKNOWN: Final = math.log(300.0)
"""The class densities cover debris up to some S/N. Other telescopes see satellites; brighter trails count as this bright. If the
PSF is unknown, the S/N is the main feature that separates bright trails from slopes."""

WIDER_LN_PSF: Final = 0.5
"""One sigma of ln of the width of a trail over that of the optics, where it is wider, in frames that nobody calibrated: there
satellites are near and out of focus, and full pixels widen fireballs. With 0 instead eight lines on trails of 364 frames of
others have less than a half, and two of no trail, in one picture."""

FAINT_SNR: Final = 20.0
"""Lines up to this S/N leave residuals that are noise alone,"""
FAINT_PX: Final = 15.0
"""where they are so long at least: shorter ones are stars."""
FEWEST_FAINT: Final = 5
"""So many of them tell the frame's noise. Chosen."""

LEAST_LIGHT_SNR: Final = 50.0
"""So bright that noise and chance do not make it; chosen, not measured."""
UNBROKEN_BINS: Final = 8
"""Bins of a light curve from which on it tells whether a line is lit all along. Chosen, not measured."""
UNBROKEN_SHARE: Final = 0.3
"""Least light of each of them, as a share of the median one: a row of stars or galaxies has gaps. Chosen, not measured."""
DIMMED_BINS: Final = 0.05
"""Share of them that may have less: what was taken out beside bright stars dims a few of 200. Chosen, not measured."""
LONGEST_PARTICLE_PX: Final = 400.0
"""Of tracks through a detector of d pixels' thickness a share of d^2 / (d^2 + L^2) is longer than L, for particles from all
sides: 0.2 % here for 250 um and pixels of 15 um. A longer line that is lit all along it is light, and the optics are as sharp as
that."""
LEAST_READOUT_ODDS: Final = 0.01
"""Odds of `odds_of_readout` below which a line that runs along rows or columns drifts across them, as columns do not. Four
satellites 0.1 to 0.4 deg from the columns, 807 px long, were refused for their direction alone. Chosen, not measured."""
LEAST_ELONGATION: Final = 4.0 * 2.355
"""Least ratio of length to width (sigma) at which a trail differs from blended stars or a galaxy if no star shows the PSF."""


def posterior_of_classes(
    log_density: NDArray[np.float64], rate_per_frame: NDArray[np.float64], frames_worth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Class probabilities (n, classes) of n detections of one frame.

    log_density : (n, classes). rate_per_frame : (classes,) expected detections. frames_worth : (classes,) weight of the
    expectation in frames (a gamma prior of the Poisson rate). With a larger weight, one frame changes the rate less.
    """
    likelihood = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    rate = rate_per_frame.copy()
    share = np.zeros_like(likelihood)
    for _ in range(ITERATIONS):
        share = likelihood * rate
        share /= share.sum(axis=1, keepdims=True)
        rate = (rate_per_frame * frames_worth + share.sum(axis=0)) / (frames_worth + 1.0)
    return share


def noise_excess(fits: Sequence[StreakFit]) -> float:
    """Chi-square of what is noise alone in a frame: the median of its faint lines, 1 at least and where too few tell it.

    Hot pixels leave tails of the noise that a robust scatter does not see: in raw frames of an uncooled camera it is 5.
    """
    faint = [fit.chi2_nu for fit in fits if fit.snr < FAINT_SNR and fit.length_px >= FAINT_PX and math.isfinite(fit.chi2_nu)]
    return max(float(np.median(faint)), 1.0) if len(faint) >= FEWEST_FAINT else 1.0


def _beyond_knowledge(fit: StreakFit, frame: DownlinkFrame) -> bool:
    """Whether a fit cannot be trusted in a frame without calibration and without a PSF from its stars."""
    outside = max(-fit.row0, -fit.row1, -fit.col0, -fit.col1)
    outside = max(outside, max(fit.row0, fit.row1) - frame.header.rows, max(fit.col0, fit.col1) - frame.header.cols)
    return fit.snr < LEAST_SNR_UNKNOWN or outside > FARTHEST_OUTSIDE_PX


def _told_px(fit: StreakFit, psf_sigma_px: float, *, unknown: bool) -> float:
    """Width of the optics at a fit. psf_sigma_px : of the frame. unknown : its stars do not tell it.

    Then the pixels' own is a first guess from round sources, which stars that are drawn out give as well: it counts where it is
    wider than what is assumed.
    """
    if not math.isfinite(fit.psf_sigma_px):
        return psf_sigma_px
    return max(fit.psf_sigma_px, psf_sigma_px) if unknown else fit.psf_sigma_px


def _odds_of_narrow(fits: Sequence[StreakFit], light: Sequence[bool]) -> NDArray[np.float64]:
    """Odds (n,) against lines that no optics made: tracks of particles, by the lengths of all of them, and columns.

    light : see `_light`. Such lines may be as narrow.
    """
    narrow = [fit.width_px < NARROWEST_PX and not lit for fit, lit in zip(fits, light, strict=True)]
    odds = odds_of_particles(fits, [thin and not is_aligned(fit.angle_deg) for fit, thin in zip(fits, narrow, strict=True)])
    return np.where(narrow, odds, 0.0)


def _snr_over_residuals(fit: StreakFit) -> float:
    """S/N relative to the residual scatter of the fit, if this exceeds the noise."""
    return fit.snr / math.sqrt(max(fit.chi2_nu, 1.0)) if math.isfinite(fit.chi2_nu) else 0.0


def _is_unbroken(fit: StreakFit) -> bool:
    """Whether a line has light all along it."""
    curve = fit.light_curve_e_px
    return (
        curve.size >= UNBROKEN_BINS
        and float(np.quantile(curve, DIMMED_BINS, method="lower")) >= UNBROKEN_SHARE * float(np.median(curve)) > 0.0
    )


def _light(fits: Sequence[StreakFit], readout: NDArray[np.float64]) -> list[bool]:
    """Which of the fits of a frame are light without doubt: long, bright, lit all along, and no line of the readout.

    readout : odds of that, see `odds_of_readout`.
    """
    return [
        fit.length_px >= LONGEST_PARTICLE_PX
        and fit.snr >= LEAST_LIGHT_SNR
        and not fit.flags & (StreakFlag.FIT_FAILED | StreakFlag.STATIC)
        and not (is_aligned(fit.angle_deg) and odds >= LEAST_READOUT_ODDS)
        and _is_unbroken(fit)
        for fit, odds in zip(fits, readout, strict=True)
    ]


def sharpest_light_px(fits: Sequence[StreakFit], believed: Sequence[bool]) -> float:
    """Width (sigma, px) that the optics do not exceed, as long bright lines show it; infinite where there is none.

    Stars do not always tell: full, stretched or crowded ones are wider than the optics. Satellites of one train had an eighth of
    their width. believed : lines that may be trails, as far as is known. Bands of cloud are long and bright, and they are not.
    """
    light = _light(fits, odds_of_readout(fits))
    return _sharpest_px(fits, [lit and trail for lit, trail in zip(light, believed, strict=True)])


def _sharpest_px(fits: Sequence[StreakFit], light: Sequence[bool]) -> float:
    """The same, where it is known which fits are light. Beside lines as wide as round sources, much wider ones do not tell."""
    lit = [fit for fit, one in zip(fits, light, strict=True) if one]
    narrow = [fit for fit in lit if fit.width_px <= WIDEST_UNKNOWN * _told_px(fit, UNKNOWN_PSF_SIGMA_PX, unknown=True)]
    widths = [fit.width_px for fit in narrow or lit]
    return float(np.median(widths)) if widths else math.inf


def sharpness_of(fits: Sequence[StreakFit], psf_sigma_px: float | None, sharpest_px: float) -> list[float]:
    """Ln of the width of each fit over that of the optics (pixel included); NaN where it failed, or nothing tells the optics.

    psf_sigma_px : of the frame's stars, None where they do not tell. sharpest_px : see `sharpest_light_px`.
    """
    optics = [fit.psf_sigma_px if math.isfinite(fit.psf_sigma_px) else psf_sigma_px for fit in fits]
    known = [min(math.inf if psf_sigma_px is None else float(width or math.inf), sharpest_px) for width in optics]
    return [
        features_of(fit, width).sharpness if math.isfinite(width) else math.nan for fit, width in zip(fits, known, strict=True)
    ]


def _blob(fit: StreakFit, psf_sigma_px: float, *, unknown: bool) -> bool:
    """Whether a source is too round to be distinguished from blends, galaxies and halos, its width being unknown or not the
    PSF's."""
    return fit.length_px < LEAST_ELONGATION * fit.width_px and (unknown or fit.width_px > WIDEST_UNKNOWN * psf_sigma_px)


PARTICLE_PER_FRAME: Final = 0.1
"""Expected particle tracks per frame."""

HOT_LINE_PER_FRAME: Final = 0.02
"""Expected bad rows or columns per frame."""

STAR_CHAIN_PER_FRAME: Final = 0.05
"""Expected star residuals per frame."""

RECURRING_PER_FRAME: Final = 0.01
"""Expected spikes, ghosts and glow per frame."""

NOISE_FRAME_PX: Final = 4096.0 * 4096.0
"""Pixels of the frame that `noise_per_frame` is stated for. Noise maxima go with the area: in white noise of 256 to 2048 px a
side the detector finds 0.3 to 0.7 a megapixel from S/N 6.0 on (21 in 44 megapixels)."""

STEADY_FRAMES: Final = 30.0
"""Frames that the expected rates of real streaks and of noise count as."""

WIDEST: Final = 12.0
"""Width over the PSF beyond which a trail is a slope of the background."""

WIDEST_SNR: Final = 100.0
"""S/N from which a trail may be wider than that."""


@dataclass(frozen=True, kw_only=True)
class LikelihoodVetter:
    """Posterior of class membership from the features of a fit; rates are of detections above the detector's threshold."""

    model_error: float = field(
        default=0.0,
        metadata={
            "doc": "share of a real trail's light that turbulence and tracking move from the model",
            "min": 0.0,
            "max": 1.0,
        },
    )
    real_per_frame: float = field(default=0.5, metadata={"doc": "expected real streaks per frame", "min": 1e-9, "max": 1e4})
    noise_per_frame: float = field(
        default=0.1,
        metadata={
            "doc": "expected noise maxima per frame; with a model_error, in 4096 x 4096 px",
            "min": 1e-9,
            "max": 1e4,
        },
    )

    def probability(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """Probabilities, shape (len(fits),), of being a real object."""
        if not fits:
            return np.zeros(0)
        if self.model_error > 0.0 and (excess := noise_excess(fits)) > 1.0:
            root = math.sqrt(excess)
            fits = [replace(fit, chi2_nu=fit.chi2_nu / excess, snr=fit.snr / root) for fit in fits]
        offset, slope = log_odds_calibration()
        unknown = frame.psf_sigma_px is None
        psf_sigma_px = UNKNOWN_PSF_SIGMA_PX if frame.psf_sigma_px is None else frame.psf_sigma_px
        ln_psf_error = math.hypot(UNKNOWN_LN_PSF, self.model_error) if unknown else self.model_error
        ln_psf_error = math.hypot(ln_psf_error, PLACE_LN_PSF)
        model_error = max(self.model_error, PSF_SHAPE_ERROR)
        readout = odds_of_readout(fits)
        hot = np.ones(len(fits), dtype=np.bool_)
        light = _light(fits, readout)
        sharpest = _sharpest_px(fits, light) if self.model_error > 0.0 else math.inf
        widths = [_told_px(fit, psf_sigma_px, unknown=unknown) for fit in fits]
        may_vary = self.model_error > 0.0
        wider_error = math.hypot(ln_psf_error, WIDER_LN_PSF) if may_vary else ln_psf_error
        optics = [min(width, sharpest) for width in widths]
        errors = [wider_error if fit.width_px > width else ln_psf_error for fit, width in zip(fits, optics, strict=True)]
        features = [
            features_of(fit, width, ln_psf_error=error, model_error=model_error, may_vary=may_vary)
            for fit, width, error in zip(fits, optics, errors, strict=True)
        ]
        if self.model_error > 0.0:
            # on board a full trail is a row of full stars, which it aims at; here `spikes` asks for a star that outshines it
            exact = readout >= LEAST_READOUT_ODDS
            # one that drifts across rows and columns is no hot line, however narrow and uneven it is
            hot = exact
            features = [
                replace(each, spike=False, aligned=each.aligned and bool(on)) for each, on in zip(features, exact, strict=True)
            ]
        if unknown or self.model_error > 0.0:
            brightest = LN_BRIGHTEST_SNR_UNKNOWN if unknown else LN_BRIGHTEST_SNR
            features = [replace(each, ln_snr=min(each.ln_snr, brightest)) for each in features]
        area = frame.header.rows * frame.header.cols / NOISE_FRAME_PX if self.model_error > 0.0 else 1.0
        log_odds = self.log_odds(features, area=area, hot=hot)
        probability = 1.0 / (1.0 + np.exp(-(offset + slope * log_odds)))
        if self.model_error > 0.0:
            probability = probability / (1.0 + probability * readout)
        if unknown:
            probability = probability / (1.0 + _odds_of_narrow(fits, light))
        told = widths if unknown else [psf_sigma_px] * len(fits)
        refused = [self._refused(fit, frame, width, unknown=unknown) for fit, width in zip(fits, told, strict=True)]
        return np.asarray(np.where(refused, 0.0, probability), dtype=np.float64)

    def _refused(self, fit: StreakFit, frame: DownlinkFrame, psf_sigma_px: float, *, unknown: bool) -> bool:
        """Whether a fit is rejected independently of the densities. unknown : the PSF's width is assumed."""
        # The class densities end far below such widths: stray light, dead borders. No defocus makes them at these ranges.
        widest = min(WIDEST, WIDEST_UNKNOWN) if unknown else WIDEST
        uncalibrated = self.model_error > 0.0
        snr = _snr_over_residuals(fit) if uncalibrated else fit.snr
        if fit.width_px > widest * psf_sigma_px and snr < WIDEST_SNR:
            return True
        if unknown and _beyond_knowledge(fit, frame):
            return True
        return uncalibrated and _blob(fit, psf_sigma_px, unknown=unknown)

    def class_rates(self, *, area: float = 1.0) -> dict[str, tuple[float, float]]:
        """For each class: expected detections per frame, and the weight of this expectation in frames.

        area : of the frame, over that which the rate of noise maxima is stated for: frames that nobody calibrated come in all
            sizes. What is known of this rate is worth the same area in frames of any size.
        """
        return {
            REAL: (self.real_per_frame, STEADY_FRAMES),
            "noise": (self.noise_per_frame * area, STEADY_FRAMES / area),
            "particle": (PARTICLE_PER_FRAME, 1.0),
            "hit_group": (GROUPED * PARTICLE_PER_FRAME, 1.0),
            "hot_line": (HOT_LINE_PER_FRAME, 1.0),
            "star_chain": (STAR_CHAIN_PER_FRAME, 1.0),
            RECURRING: (RECURRING_PER_FRAME, 1.0),
        }

    def log_odds(
        self, features: Sequence[Features], *, area: float = 1.0, hot: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """ln P(real) / P(not real), shape (n,), of the detections of one frame, features taken as independent.

        area : as for `class_rates`. hot : (n,) which of them may be a hot line, one that follows a row or column; None: all.
        """
        densities, classes = class_densities(), self.class_rates(area=area)
        log_density = np.array([[densities[name].log_density(name, f) for name in classes] for f in features])
        if hot is not None:
            log_density[~hot, list(classes).index("hot_line")] = -math.inf
        rate, worth = (np.array(column) for column in zip(*classes.values(), strict=True))
        real = np.array([name == REAL for name in classes])
        share = posterior_of_classes(log_density, rate, worth)
        yes, no = share[:, real].sum(axis=1), share[:, ~real].sum(axis=1)
        return np.asarray(np.log(np.maximum(yes, 1e-12)) - np.log(np.maximum(no, 1e-12)), dtype=np.float64)
