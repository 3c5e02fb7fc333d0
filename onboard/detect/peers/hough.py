"""`onboard.detector: hough`: scikit-image's probabilistic Hough transform on the star-masked, PSF-filtered image.

Galambos, Matas & Kittler 1999 ("Progressive probabilistic Hough transform for line detection", CVPR), as
`skimage.transform.probabilistic_hough_line` has it: what most people try first. Its random order of pixels has a fixed seed.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from skimage.transform import probabilistic_hough_line

from onboard.detect import components
from onboard.detect.single_frame import SingleFrameDetector
from sboc_e2e.icd.signals import Detection, DetectorView

MOST_POINTS = 20_000
"""Pixels above the threshold that vote, brightest first: the transform takes time for each."""


def line_segments(points: NDArray[np.bool_], *, votes: int, min_length_px: float, gap_px: float) -> NDArray[np.float64]:
    """Segments (n, 4) row0, col0, row1, col1 of a picture of points."""
    found = probabilistic_hough_line(points, votes, round(min_length_px), round(gap_px), rng=0)
    ends = np.array([(*a, *b) for a, b in found], np.float64).reshape(-1, 4)
    return ends[:, [1, 0, 3, 2]]


@dataclass(frozen=True, kw_only=True)
class HoughDetector(SingleFrameDetector):
    """Threshold, transform, join, at half resolution."""

    n_sigma: float = field(default=3.5, metadata={"doc": "threshold of the filtered image", "min": 1.0, "max": 100.0})
    votes: int = field(default=10, metadata={"doc": "pixels on a line", "min": 2, "max": 1000})
    min_length_px: float = field(default=20.0, metadata={"doc": "least length of a segment", "min": 2.0, "max": 1000.0})
    gap_px: float = field(default=8.0, metadata={"doc": "largest gap in a segment", "min": 0.0, "max": 100.0})

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        masked = components.masked_image(view, self.halo_px)
        if min(view.residual_adu.shape) < 16:
            return ()
        binned = components.half_resolution(masked, view.psf_sigma_px).astype(np.float32)
        binned -= np.median(binned)
        least = max(
            self.n_sigma * components.HALF_RESOLUTION_UNIT,
            float(np.partition(binned, -MOST_POINTS, axis=None)[-MOST_POINTS]) if binned.size > MOST_POINTS else 0.0,
        )
        segments = line_segments(
            binned > least, votes=self.votes, min_length_px=0.5 * self.min_length_px, gap_px=0.5 * self.gap_px
        )
        joined = components.join_collinear(2.0 * segments + 0.5, gap_px=20.0, across_px=6.0)
        return components.to_detections(
            masked, joined, psf_sigma_px=view.psf_sigma_px, min_snr=self.min_snr, max_detections=self.max_detections
        )
