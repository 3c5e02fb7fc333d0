"""The step `ground.vetter`: posterior probability of a real object among the classes that detectors deliver.

Each class (real trail, noise maximum, particle track, hot line, chain of stars, recurring artefact) has a density of the
features of its fits (`class_densities`) and a rate per frame. The rates start from what the options expect and follow the
frame itself by expectation-maximisation: where a particle storm fills a frame with sharp short tracks, the odds of the next
one turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.class_densities import REAL, RECURRING, class_densities, log_odds_calibration
from ground.vetting.features import Features, features_of
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.products import StreakFit

ITERATIONS: Final = 40


def posterior_of_classes(
    log_density: NDArray[np.float64], rate_per_frame: NDArray[np.float64], frames_worth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Class probabilities (n, classes) of n detections of one frame.

    log_density : (n, classes). rate_per_frame : (classes,) expected detections. frames_worth : (classes,) how many frames
    the expectation is worth (a gamma prior of the Poisson rate): the larger, the less one frame can move it.
    """
    likelihood = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    rate = rate_per_frame.copy()
    share = np.zeros_like(likelihood)
    for _ in range(ITERATIONS):
        share = likelihood * rate
        share /= share.sum(axis=1, keepdims=True)
        rate = (rate_per_frame * frames_worth + share.sum(axis=0)) / (frames_worth + 1.0)
    return share


@dataclass(frozen=True, kw_only=True)
class LikelihoodVetter:
    """Posterior of class membership from the features of a fit; rates are of detections above the detector's threshold."""

    psf_sigma_px: float = field(
        default=0.85,
        metadata={"doc": "PSF sigma that a real trail has, in frames whose stars do not tell", "min": 0.05, "max": 100.0},
    )
    real_per_frame: float = field(default=0.5, metadata={"doc": "expected real streaks per frame", "min": 1e-9, "max": 1e4})
    noise_per_frame: float = field(default=0.1, metadata={"doc": "expected noise maxima per frame", "min": 1e-9, "max": 1e4})
    particle_per_frame: float = field(
        default=0.1, metadata={"doc": "expected particle tracks per frame", "min": 1e-9, "max": 1e4}
    )
    hot_line_per_frame: float = field(
        default=0.02, metadata={"doc": "expected bad rows or columns per frame", "min": 1e-9, "max": 1e4}
    )
    star_chain_per_frame: float = field(
        default=0.05, metadata={"doc": "expected star residuals per frame", "min": 1e-9, "max": 1e4}
    )
    recurring_per_frame: float = field(
        default=0.01, metadata={"doc": "expected spikes, ghosts and glow per frame", "min": 1e-9, "max": 1e4}
    )
    steady_frames: float = field(
        default=30.0, metadata={"doc": "frames that the rates of real streaks and noise are worth", "min": 0.1, "max": 1e6}
    )
    widest: float = field(
        default=12.0,
        metadata={"doc": "width over the PSF beyond which a trail is a slope of the background", "min": 1.5, "max": 1e4},
    )
    widest_snr: float = field(
        default=100.0, metadata={"doc": "S/N from which a trail may be wider than that", "min": 0.0, "max": 1e6}
    )

    def probability(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """Probabilities, shape (len(fits),), of being a real object."""
        if not fits:
            return np.zeros(0)
        offset, slope = log_odds_calibration()
        psf_sigma_px = self.psf_sigma_px if frame.psf_sigma_px is None else frame.psf_sigma_px
        log_odds = self.log_odds([features_of(fit, psf_sigma_px) for fit in fits])
        probability = 1.0 / (1.0 + np.exp(-(offset + slope * log_odds)))
        # The class densities end far below such widths: stray light, dead borders. No defocus makes them at these ranges.
        slope_of_sky = [f.width_px > self.widest * psf_sigma_px and f.snr < self.widest_snr for f in fits]
        return np.asarray(np.where(slope_of_sky, 0.0, probability), dtype=np.float64)

    def class_rates(self) -> dict[str, tuple[float, float]]:
        """Of each class: expected detections per frame, and how many frames that expectation is worth."""
        return {
            REAL: (self.real_per_frame, self.steady_frames),
            "noise": (self.noise_per_frame, self.steady_frames),
            "particle": (self.particle_per_frame, 1.0),
            "hot_line": (self.hot_line_per_frame, 1.0),
            "star_chain": (self.star_chain_per_frame, 1.0),
            RECURRING: (self.recurring_per_frame, 1.0),
        }

    def log_odds(self, features: Sequence[Features]) -> NDArray[np.float64]:
        """ln P(real) / P(not real), shape (n,), of the detections of one frame, features taken as independent."""
        densities, classes = class_densities(), self.class_rates()
        log_density = np.array([[densities[name].log_density(name, f) for name in classes] for f in features])
        rate, worth = (np.array(column) for column in zip(*classes.values(), strict=True))
        share = posterior_of_classes(log_density, rate, worth)
        real = share[:, list(classes).index(REAL)]
        rest = np.delete(share, list(classes).index(REAL), axis=1).sum(axis=1)
        return np.asarray(np.log(np.maximum(real, 1e-12)) - np.log(np.maximum(rest, 1e-12)), dtype=np.float64)
