"""`onboard.detector: segmentation`: photutils' image segmentation on the star-masked, smoothed image, long segments kept.

Bradley et al., photutils (`detect_sources`, after SExtractor, Bertin & Arnouts 1996, A&AS 117, 393): connected pixels above a
threshold, told apart by their second moments.
"""

import warnings
from dataclasses import dataclass, field

import cv2
import numpy as np
from photutils.segmentation import detect_sources
from photutils.utils.exceptions import NoDetectionsWarning

from onboard.detect import components, whiten
from onboard.detect.single_frame import SingleFrameDetector
from sboc_e2e.icd.signals import Detection, DetectorView


@dataclass(frozen=True, kw_only=True)
class SegmentationDetector(SingleFrameDetector):
    """Smooth, segment, select."""

    n_sigma: float = field(default=3.0, metadata={"doc": "threshold of the smoothed image", "min": 1.0, "max": 100.0})
    min_area_px: int = field(default=12, metadata={"doc": "least number of connected pixels", "min": 1, "max": 10000})
    min_length_px: float = field(default=10.0, metadata={"doc": "least length", "min": 2.0, "max": 1000.0})
    min_axis_ratio: float = field(default=2.5, metadata={"doc": "least ratio of the axes", "min": 1.0, "max": 100.0})

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        masked = components.masked_image(view, self.halo_px)
        smoothed = cv2.GaussianBlur(masked.image.astype(np.float32) / np.float32(whiten.UNIT), (0, 0), view.psf_sigma_px)
        # after the filter one sigma of a pixel is 1 / (2 sqrt(pi) s)
        noise = 1.0 / (2.0 * np.sqrt(np.pi) * view.psf_sigma_px)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NoDetectionsWarning)
            found = detect_sources(smoothed, self.n_sigma * noise, self.min_area_px)
        if found is None:
            return ()
        segments = components.elongated_components(
            found.data > 0, min_length_px=self.min_length_px, min_axis_ratio=self.min_axis_ratio, min_area_px=self.min_area_px
        )
        joined = components.join_collinear(segments, gap_px=20.0, across_px=3.0)
        return components.to_detections(
            masked, joined, psf_sigma_px=view.psf_sigma_px, min_snr=self.min_snr, max_detections=self.max_detections
        )
