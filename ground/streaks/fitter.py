"""The step `ground.streak_fitter`: trailed-PSF fit of one ROI group."""

from dataclasses import dataclass, field

import numpy as np

from ground.streaks.fit_record import failed_fit
from ground.streaks.trail_fit import FitOptions, fit_trail
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection


@dataclass(frozen=True, kw_only=True)
class TrailedPsfFitter:
    """Trailed-PSF likelihood fit: Fisher scoring for the centre line, posterior mean for ends and flux.

    See `ground.streaks.trail_fit` for the method.
    """

    max_shift_px: float = field(
        default=4.0, metadata={"doc": "how far across the trail the on-board detection may be off", "min": 1.0, "max": 50.0}
    )
    max_iterations: int = field(default=25, metadata={"doc": "Fisher-scoring iterations of one model", "min": 3, "max": 500})

    def fit(self, pixels: StreakPixels, detection: Detection) -> StreakFit:
        """Best model with its uncertainties; a failed fit is flagged FIT_FAILED and carries the detection's values."""
        options = FitOptions(max_shift_px=self.max_shift_px, max_iterations=self.max_iterations)
        try:
            result = fit_trail(pixels, detection, options)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            # singular matrices and the like of pixels that hold no trail; one bad ROI must not stop a run
            result = None
        return failed_fit(detection, pixels) if result is None else result
