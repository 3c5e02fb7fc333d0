"""`onboard.detector: lsd`: the line segment detector of OpenCV on the star-masked, PSF-filtered image in 8 bits.

Grompone von Gioi, Jakubowicz, Morel & Randall 2012, IPOL 2, 35; for satellite trails on star-masked matched-filtered images
as in the AstroPack pipeline (Ofek et al. 2023, PASP 135, 124502). A trail has two edges: segments come in antiparallel pairs
and in pieces, which are joined.
"""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.detect import components
from onboard.detect.single_frame import SingleFrameDetector
from sboc_e2e.icd.signals import Detection, DetectorView


def line_segments(image: NDArray[np.uint8], *, min_length_px: float) -> NDArray[np.float64]:
    """Segments (n, 4) row0, col0, row1, col1 of an 8-bit image, pixel centres at integers."""
    found: Any = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD, 1.0).detect(image)[0]  # None when there are none
    ends = np.asarray([] if found is None else found, np.float64).reshape(-1, 4)[:, [1, 0, 3, 2]]
    return ends[np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1]) >= min_length_px]


@dataclass(frozen=True, kw_only=True)
class LsdDetector(SingleFrameDetector):
    """OpenCV's LSD at half resolution."""

    stretch_sigma: float = field(
        default=12.0, metadata={"doc": "S/N per filtered pixel shown as white", "min": 1.0, "max": 100.0}
    )
    min_length_px: float = field(default=10.0, metadata={"doc": "least length of a segment", "min": 2.0, "max": 1000.0})

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        masked = components.masked_image(view, self.halo_px)
        if min(view.residual_adu.shape) < 16:
            return ()
        binned = components.half_resolution(masked, view.psf_sigma_px)
        white = components.HALF_RESOLUTION_UNIT * self.stretch_sigma
        grey = np.clip(binned.astype(np.float32) * (255.0 / white), 0.0, 255.0).astype(np.uint8)
        segments = 2.0 * line_segments(grey, min_length_px=0.5 * self.min_length_px) + 0.5
        joined = components.join_collinear(segments, gap_px=20.0, across_px=6.0)
        return components.to_detections(
            masked, joined, psf_sigma_px=view.psf_sigma_px, min_snr=self.min_snr, max_detections=self.max_detections
        )
