"""The step `ground.streak_fitter`: trailed-PSF fit of one ROI group."""

from dataclasses import dataclass, field

from ground.streaks.fit_record import failed_fit
from ground.streaks.no_trail import NoTrailError
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
        """Best model with its uncertainties; where the pixels allow none, the detection's values, FIT_FAILED and the reason."""
        options = FitOptions(max_shift_px=self.max_shift_px, max_iterations=self.max_iterations)
        try:
            return fit_trail(pixels, detection, options)
        except NoTrailError as error:
            return failed_fit(detection, pixels, error.reason)
