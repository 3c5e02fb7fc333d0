"""`onboard.detector: difference`: two successive exposures aligned on their stars, subtracted, thresholded, selected.

The Difference Method developed for ESA's optical in-situ monitor (Vives Vallduriola, Suárez Trujillo, Helfers, Daens, Utzmann,
Pittet & Lièvre 2018, "The use of streak observations to detect space debris", Int. J. Remote Sensing 39, 8002): what stays at
the same place among the stars cancels, what moved remains; connected remainders are selected by size and shape. No star mask
is needed, and objects as small as a star are found. It costs sqrt(2) in noise and wants the preceding frame.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.detect import components, whiten
from onboard.image import registration
from sboc_e2e.icd.signals import Detection, DetectorView


def subtract_aligned(now: NDArray[np.int8], earlier: NDArray[np.int8], transform: NDArray[np.float64]) -> NDArray[np.float32]:
    """``now - earlier`` with `earlier` moved by the (2, 3) transform of (row, col); both in sigma/16; result in sigma."""
    swap = transform[[1, 0]][:, [1, 0, 2]]
    moved = cv2.warpAffine(
        earlier.astype(np.float32), swap, (now.shape[1], now.shape[0]), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
    )
    return np.asarray((now.astype(np.float32) - moved) / np.float32(whiten.UNIT), np.float32)


@dataclass(frozen=True, kw_only=True)
class DifferenceDetector:
    """Align, subtract, select."""

    n_sigma: float = field(default=4.5, metadata={"doc": "threshold of the filtered difference", "min": 1.0, "max": 100.0})
    min_area_px: int = field(default=6, metadata={"doc": "least number of connected pixels", "min": 1, "max": 10000})
    star_margin: float = field(
        default=0.35, metadata={"doc": "difference tolerated at a star, as a fraction of its light", "min": 0.0, "max": 1.0}
    )
    reach_px: float = field(default=300.0, metadata={"doc": "largest shift between frames", "min": 1.0, "max": 5000.0})
    min_snr: float = field(default=6.0, metadata={"doc": "least matched-filter S/N", "min": 0.0, "max": 1000.0})
    max_detections: int = field(default=200, metadata={"doc": "most detections of a frame", "min": 1, "max": 10000})

    @property
    def history_frames(self) -> int:
        """Needs the preceding frame."""
        return 1

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N; none while there is no earlier frame of the same stars."""
        earlier = view.history[-1] if view.history else None
        if earlier is None or earlier.residual_adu.shape != view.residual_adu.shape:
            return ()
        transform = registration.register(earlier.stars, view.stars, reach_px=self.reach_px)
        if transform is None:
            return ()
        now = whiten.quantise(view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px)
        before = whiten.quantise(earlier.residual_adu, earlier.mask, earlier.background.sigma_adu, earlier.background.tile_px)
        difference = subtract_aligned(now, before, transform)
        width = (0, 0)
        smoothed = cv2.GaussianBlur(difference, width, view.psf_sigma_px)
        old = cv2.GaussianBlur(now.astype(np.float32) / np.float32(whiten.UNIT) - difference, width, view.psf_sigma_px)
        # after the filter one sigma of a pixel is 1 / (2 sqrt(pi) s); two frames carry sqrt(2) of it
        noise = np.sqrt(2.0) / (2.0 * np.sqrt(np.pi) * view.psf_sigma_px)
        spread = cv2.dilate(np.maximum(old, 0.0), np.ones((3, 3), np.uint8))
        above = smoothed > self.n_sigma * noise + self.star_margin * spread
        segments = components.elongated_components(above, min_length_px=0.0, min_axis_ratio=1.0, min_area_px=self.min_area_px)
        masked = components.MaskedImage(image=now, blocked=whiten.unusable(view.mask))
        joined = components.join_collinear(segments, gap_px=12.0, across_px=2.5)
        return components.to_detections(
            masked, joined, psf_sigma_px=view.psf_sigma_px, min_snr=self.min_snr, max_detections=self.max_detections
        )
