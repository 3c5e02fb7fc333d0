"""Detectors from another laboratory: a dozen lines around one line of numpy."""

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

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


@dataclass(frozen=True, kw_only=True)
class LongPatches:
    """Patches of pixels above a threshold that are longer than a star is wide."""

    n_sigma: float = field(default=3.0, metadata={"doc": "threshold in noise sigmas", "min": 1.0, "max": 1000.0})
    length_px: float = field(default=12.0, metadata={"doc": "shortest patch", "min": 1.0, "max": 1000.0})

    @property
    def history_frames(self) -> int:
        """Looks at one frame only."""
        return 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Each long patch as the segment between its outermost pixels."""
        sigma = max(float(np.median(view.background.sigma_adu)), 1e-6)
        light = np.where((view.mask == 0) & np.isfinite(view.residual_adu), view.residual_adu, 0.0)
        labels, _ = ndimage.label(light > self.n_sigma * sigma, np.ones((3, 3)))
        found = []
        for number, (rows, cols) in enumerate(ndimage.find_objects(labels), 1):
            if max(rows.stop - rows.start, cols.stop - cols.start) < self.length_px:
                continue
            row, col = np.nonzero(labels[rows, cols] == number)
            far = row + col if np.cov(row, col)[0, 1] >= 0 else row - col
            ends = [(float(row[k] + rows.start), float(col[k] + cols.start)) for k in (np.argmin(far), np.argmax(far))]
            snr = float(light[rows, cols][row, col].sum() / (sigma * np.sqrt(len(row))))
            found.append(Detection(row0=ends[0][0], col0=ends[0][1], row1=ends[1][0], col1=ends[1][1], snr=snr))
        return tuple(sorted(found, key=lambda detection: -detection.snr))
