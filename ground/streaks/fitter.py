"""The step `ground.streak_fitter`: trailed-PSF fit of one ROI group."""

from dataclasses import dataclass, field

from ground.streaks.fading import with_fading_ends
from ground.streaks.fit_record import failed_fit
from ground.streaks.no_trail import NoTrailError
from ground.streaks.trail_fit import fit_trail
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection


@dataclass(frozen=True, kw_only=True)
class TrailedPsfFitter:
    """Trailed-PSF likelihood fit: Fisher scoring for the centre line, posterior mean for ends and flux.

    See `ground.streaks.trail_fit` for the method.
    """

    fading_ends: bool = field(
        default=False, metadata={"doc": "whether trails may fade before the border, as in frames of telescopes on the ground"}
    )

    def fit(self, pixels: StreakPixels, detection: Detection) -> StreakFit:
        """Best model with its uncertainties; where the pixels allow none, the detection's values, FIT_FAILED and the reason."""
        try:
            fit = fit_trail(pixels, detection)
        except NoTrailError as error:
            return failed_fit(detection, pixels, error.reason)
        return with_fading_ends(fit, pixels) if self.fading_ends else fit
