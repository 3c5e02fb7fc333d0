"""`onboard.detector: threshold`: pixels above a threshold, connected and selected by elongation.

The recipe of ground surveys with SExtractor (Bertin & Arnouts 1996, A&AS 117, 393) in its library form sep (Barbary 2016,
JOSS 1, 58): extraction without deblending, axis ratio and size from the second moments. The limit is set per pixel, so it
moves with the square root of the length: fast, good for short and bright trails, blind to long faint ones.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import sep
from numpy.typing import NDArray

from onboard.detect import components, star_mask
from sboc_e2e.icd.signals import Detection, DetectorView

FAINT_STARS_PX = 8.0
"""Stars so near to a segment may shine into it."""


def extract_elongated(
    image: NDArray[np.int16], *, threshold: float, min_area_px: int, min_axis_ratio: float
) -> NDArray[np.float64]:
    """Segments (n, 4) row0, col0, row1, col1 of the elongated sources of an image; `threshold` in its units."""
    # sep writes to its whole pixel stack first: room for the pixels above the threshold is enough and ten times as fast
    room_before = sep.get_extract_pixstack()
    sep.set_extract_pixstack(int(np.count_nonzero(image > math.floor(threshold))) + 1000)
    pixels = image.astype(np.float32)
    del image
    try:
        sources = sep.extract(pixels, threshold, minarea=min_area_px, filter_kernel=None, deblend_cont=1.0, clean=False)
    finally:
        sep.set_extract_pixstack(room_before)
    long = sources[sources["a"] >= min_axis_ratio * np.maximum(sources["b"], 0.29)]
    half = 0.5 * np.sqrt(12.0) * long["a"]
    d_row, d_col = half * np.sin(long["theta"]), half * np.cos(long["theta"])
    return np.stack([long["y"] - d_row, long["x"] - d_col, long["y"] + d_row, long["x"] + d_col], axis=1)


@dataclass(frozen=True, kw_only=True)
class ThresholdDetector:
    """sep on the PSF-filtered half-resolution image without its stars, elongation cut, joined pieces."""

    n_sigma: float = field(default=3.5, metadata={"doc": "threshold of the filtered pixels", "min": 0.5, "max": 100.0})
    min_area_px: int = field(default=8, metadata={"doc": "least area at half resolution", "min": 1, "max": 10000})
    min_axis_ratio: float = field(default=3.0, metadata={"doc": "least ratio of the axes", "min": 1.0, "max": 100.0})
    min_snr: float = field(default=10.0, metadata={"doc": "least matched-filter S/N", "min": 0.0, "max": 1000.0})
    halo_px: float = field(default=1.0, metadata={"doc": "star mask growth per sqrt(S/N / 100)", "min": 0.0, "max": 20.0})
    max_detections: int = field(default=200, metadata={"doc": "most detections of a frame", "min": 1, "max": 10000})

    @property
    def history_frames(self) -> int:
        """Works on single frames."""
        return 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        if min(view.residual_adu.shape) < 8:
            return ()
        masked = components.masked_image(view, self.halo_px, star_mask.FAINT_SNR)
        segments = extract_elongated(
            components.half_resolution(masked, view.psf_sigma_px),
            threshold=self.n_sigma * components.HALF_RESOLUTION_UNIT,
            min_area_px=self.min_area_px,
            min_axis_ratio=self.min_axis_ratio,
        )
        joined = components.join_collinear(2.0 * segments + 0.5, gap_px=20.0, across_px=2.5)
        # faint stars are smaller than the least area; they must go only where chance has lined some of them up
        components.take_out_near(
            masked, view, joined, below_snr=star_mask.FAINT_SNR, within_px=FAINT_STARS_PX, halo_px=self.halo_px
        )
        return components.to_detections(
            masked, joined, psf_sigma_px=view.psf_sigma_px, min_snr=self.min_snr, max_detections=self.max_detections
        )
