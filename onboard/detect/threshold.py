"""`onboard.detector: threshold`: pixels above a threshold, connected and selected by elongation.

The recipe of ground surveys with SExtractor (Bertin & Arnouts 1996, A&AS 117, 393) as sep (Barbary 2016, JOSS 1, 58) computes it:
extraction without deblending, axis ratio and size from the second moments. The limit is set per pixel, so it moves with the
square root of the length: fast, good for short and bright trails, blind to long faint ones.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect import components, star_mask
from onboard.detect.single_frame import SingleFrameDetector
from sboc_e2e.icd.signals import Detection, DetectorView

FAINT_STARS_PX: Final = 8.0
"""Stars so near to a segment may shine into it."""

PIECE_PX: Final = 32
"""Pixels of a row that are looked at one by one only when some of them exceed the threshold."""

FLAT: Final = 0.00694
"""Least determinant of a source's second moments: 1 / 144, that of a pixel's own, 1 / 12 each, as SExtractor rounds it."""
PIXEL_VARIANCE: Final = 0.0833333
"""What is added to both variances of a source below `FLAT`: those of a pixel, 1 / 12, as SExtractor rounds it."""


@nb.njit(cache=True)
def _count_above(line: NDArray[np.int16], least: np.int16) -> int:
    count = np.int32(0)
    for j in range(line.size):
        count += np.int32(line[j] > least)
    return int(count)


@nb.njit(cache=True)
def _runs(image: NDArray[np.int16], least: np.int16) -> NDArray[np.int32]:
    """Runs of pixels above `least`, (n, 3) row, first and last column, in order."""
    rows, cols = image.shape
    out, n = np.empty((1024, 3), np.int32), 0
    for i in range(rows):
        for first in range(0, cols, PIECE_PX):
            line = image[i, first : first + PIECE_PX]
            if _count_above(line, least) == 0:
                continue
            for j in range(first, first + line.size):
                if image[i, j] <= least:
                    continue
                if n > 0 and out[n - 1, 0] == i and out[n - 1, 2] == j - 1:
                    out[n - 1, 2] = j
                    continue
                if n == out.shape[0]:
                    out = np.concatenate((out, np.empty_like(out)))
                out[n, 0], out[n, 1], out[n, 2] = i, j, j
                n += 1
    return out[:n]


@nb.njit(cache=True)
def _root(parent: NDArray[np.int32], k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@nb.njit(cache=True)
def _connect(runs: NDArray[np.int32]) -> NDArray[np.int32]:
    """For each run the first run of its component; runs of neighbouring rows that touch, corners included, are connected."""
    n = runs.shape[0]
    parent = np.arange(n).astype(np.int32)
    above = 0
    for k in range(n):
        while runs[above, 0] < runs[k, 0] - 1 or (runs[above, 0] == runs[k, 0] - 1 and runs[above, 2] < runs[k, 1] - 1):
            above += 1
        m = above
        while m < k and runs[m, 0] == runs[k, 0] - 1 and runs[m, 1] <= runs[k, 2] + 1:
            a, b = _root(parent, k), _root(parent, m)
            parent[max(a, b)] = min(a, b)
            m += 1
    for k in range(n):
        parent[k] = _root(parent, k)
    return parent


@nb.njit(cache=True)
def _moments(
    image: NDArray[np.int16], runs: NDArray[np.int32], of: NDArray[np.int32], min_area_px: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """First runs (n,) of components that are large enough, and sums over them, (n, 6): light, light times y, x, yy, xx, xy.

    y and x are counted from the first run's row and first column.
    """
    area = np.zeros(runs.shape[0], np.int32)
    for k in range(runs.shape[0]):
        area[of[k]] += runs[k, 2] - runs[k, 1] + 1
    large = np.flatnonzero(area >= min_area_px).astype(np.int32)
    place = np.full(runs.shape[0], -1, np.int32)
    for n in range(large.size):
        place[large[n]] = n
    out = np.zeros((large.size, 6))
    for k in range(runs.shape[0]):
        first, n = of[k], place[of[k]]
        if n < 0:
            continue
        y = float(runs[k, 0] - runs[first, 0])
        for j in range(runs[k, 1], runs[k, 2] + 1):
            x, value = float(j - runs[first, 1]), float(image[runs[k, 0], j])
            out[n, 0] += value
            out[n, 1] += value * y
            out[n, 2] += value * x
            out[n, 3] += value * y * y
            out[n, 4] += value * x * x
            out[n, 5] += value * x * y
    return large, out


def extract_elongated(
    image: NDArray[np.int16], *, threshold: float, min_area_px: int, min_axis_ratio: float
) -> NDArray[np.float64]:
    """Segments (n, 4) row0, col0, row1, col1 of the elongated sources of an image; `threshold` in its units.

    Axes and angle of the pixels' second moments, weighted by their values, as `sep.extract` without filter, deblending and
    cleaning gives them. Sources whose determinant falls below that of a pixel, 1 / 144, have a pixel's variance added.
    """
    runs = _runs(image, np.int16(min(math.floor(threshold), 32767)))
    if len(runs) == 0:
        return np.zeros((0, 4))
    large, sums = _moments(image, runs, _connect(runs), min_area_px)
    light, y, x, yy, xx, xy = sums.T
    y, x = y / light, x / light
    var_row, var_col, cov = yy / light - y * y, xx / light - x * x, xy / light - x * y
    flat = var_row * var_col - cov * cov < FLAT
    var_row, var_col = var_row + PIXEL_VARIANCE * flat, var_col + PIXEL_VARIANCE * flat
    spread = np.hypot(0.5 * (var_col - var_row), cov)
    major, minor = (np.sqrt(np.maximum(0.5 * (var_row + var_col) + sign * spread, 0.0)) for sign in (1.0, -1.0))
    long = major >= min_axis_ratio * np.maximum(minor, 0.29)
    angle, half = 0.5 * np.arctan2(2.0 * cov, var_col - var_row)[long], 0.5 * np.sqrt(12.0) * major[long]
    row, col = runs[large, 0][long] + y[long], runs[large, 1][long] + x[long]
    d_row, d_col = half * np.sin(angle), half * np.cos(angle)
    return np.stack([row - d_row, col - d_col, row + d_row, col + d_col], axis=1)


@dataclass(frozen=True, kw_only=True)
class ThresholdDetector(SingleFrameDetector):
    """SExtractor on the PSF-filtered half-resolution image without its stars, elongation cut, joined pieces."""

    n_sigma: float = field(default=3.5, metadata={"doc": "threshold of the filtered pixels", "min": 0.5, "max": 100.0})
    min_area_px: int = field(default=8, metadata={"doc": "least area at half resolution", "min": 1, "max": 10000})
    min_axis_ratio: float = field(default=3.0, metadata={"doc": "least ratio of the axes", "min": 1.0, "max": 100.0})
    min_snr: float = field(default=10.0, metadata={"doc": "least matched-filter S/N", "min": 0.0, "max": 1000.0})

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
