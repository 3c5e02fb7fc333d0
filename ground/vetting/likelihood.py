"""The step `ground.vetter`: posterior odds of a real object from a few features of its fit."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit


def log_odds(fit: StreakFit, prior_log_odds: float) -> float:
    """Natural log of P(real) / P(false): noise maxima by S/N, sharpness, goodness of fit, flags."""
    score = prior_log_odds + 1.7 * (fit.snr - 6.8)
    score -= 0.5 * max(fit.chi2_nu - 1.5, 0.0) ** 2
    for flag, penalty in ((StreakFlag.COSMIC_LIKE, 6.0), (StreakFlag.STATIC, 6.0), (StreakFlag.SPIKE_LIKE, 5.0)):
        if flag in fit.flags:
            score -= penalty
    if StreakFlag.FIT_FAILED in fit.flags:
        score -= 3.0
    return float(np.clip(score, -30.0, 30.0))


@dataclass(frozen=True, kw_only=True)
class LikelihoodVetter:
    """Likelihood ratio of real trails against noise, particles, star residuals and spikes."""

    prior_odds: float = field(default=1.0, metadata={"doc": "real to false detections before looking", "min": 1e-9, "max": 1e9})

    def probability(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """Probabilities, shape (len(fits),), of being a real object."""
        odds = np.array([log_odds(fit, float(np.log(self.prior_odds))) for fit in fits], dtype=np.float64)
        return 1.0 / (1.0 + np.exp(-odds))
