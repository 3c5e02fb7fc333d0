"""A detector from another laboratory: ten lines around one line of numpy."""

from dataclasses import dataclass, field

import numpy as np

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView


@dataclass(frozen=True, kw_only=True)
class BrightestPixel:
    """The brightest unmasked pixel of a frame, if it is bright enough."""

    n_sigma: float = field(default=8.0, metadata={"doc": "threshold in noise sigmas", "min": 1.0, "max": 1000.0})

    @property
    def history_frames(self) -> int:
        """Looks at one frame only."""
        return 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """One point-like detection or none."""
        usable = np.where((view.mask == 0) & np.isfinite(view.residual_adu), view.residual_adu, -np.inf)
        row, col = np.unravel_index(int(np.argmax(usable)), usable.shape)
        snr = float(usable[row, col] / max(float(np.median(view.background.sigma_adu)), 1e-6))
        if not np.isfinite(snr) or snr < self.n_sigma:
            return ()
        place = {"row0": float(row), "col0": float(col), "row1": float(row), "col1": float(col)}
        return (Detection(**place, snr=snr, flags=StreakFlag.POINT_LIKE),)
