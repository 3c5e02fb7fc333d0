"""Maxima of the PSF-smoothed image summed along the stars' trails."""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.signals import DetectorView, StarMotion

SUM_WORK: Final = 0.25
"""Operations of a step of a sum along the trails, per pixel."""

BLOCK_PX: Final = 128
"""Side of the parts of a frame that have one trail each when the frame turns."""

UNIT: Final = 16.0  # steps of the smoothed image in a sigma, as `detect.whiten.UNIT`
CLIP_SIGMA: Final = 7.5  # with the growth to 1,000 times it 100 px sum to 28,600, which 16 bits hold
GROWTH: Final = 0.2
"""Above `CLIP_SIGMA` the smoothed image grows as a logarithm, scaled by `GROWTH`. A bright point then lights up no more of a path
than its own width, and every trail is still brightest in its middle."""

LONGEST_PX: Final = 100.0
"""Longest trail whose sum is held by 16 bits."""

SHORT_PX: Final = 4.0
"""Shorter trails are stars as points; there are none of the others where the motion is so small."""

DARK_QUARTER: Final = 0.15
"""A path is a trail if each of its quarters has more than this share of the expected light."""


@njit(cache=True)
def _smoothed_rows(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma: NDArray[np.float32],
    tile_px: int,
    kernel: NDArray[np.float32],
    first: int,
    out: NDArray[np.int16],
    margin: int,
) -> None:
    """Rows first ... of the image over its noise, smoothed and compressed, in sigma/UNIT; zeros beyond the frame.

    kernel : centre and one side, of unit noise. out : (rows, cols + 2 margin).
    """
    rows, cols = residual.shape
    radius = kernel.size - 1
    ring = np.zeros((2 * radius + 1, cols), np.float32)
    line = np.zeros(cols + 2 * radius, np.float32)
    scale = np.zeros(cols, np.float32)
    out[:] = 0
    limit = np.float32(CLIP_SIGMA * UNIT)
    for k in range(-radius, out.shape[0] + radius):
        row = first + k
        slot = ring[row % (2 * radius + 1)]
        slot[:] = 0.0
        if 0 <= row < rows:
            nodes = sigma[min(row // tile_px, sigma.shape[0] - 1)]
            for col in range(cols):
                scale[col] = np.float32(UNIT) / max(nodes[min(col // tile_px, nodes.size - 1)], np.float32(1e-9))
            for col in range(cols):
                lit = residual[row, col] * scale[col]
                line[radius + col] = lit if mask[row, col] == 0 else np.float32(0.0)
            for col in range(cols):
                slot[col] = kernel[0] * line[radius + col]
            for m in range(1, radius + 1):
                for col in range(cols):
                    slot[col] += kernel[m] * (line[radius + col - m] + line[radius + col + m])
        at = k - radius
        if 0 <= at < out.shape[0] and 0 <= first + at < rows:
            line[:cols] = kernel[0] * ring[(first + at) % (2 * radius + 1)]
            for m in range(1, radius + 1):
                above, below = ring[(first + at - m) % (2 * radius + 1)], ring[(first + at + m) % (2 * radius + 1)]
                for col in range(cols):
                    line[col] += kernel[m] * (above[col] + below[col])
            for col in range(cols):
                out[at, margin + col] = np.int16(min(max(line[col], -limit), limit))
            for col in range(cols):
                if line[col] > limit:
                    out[at, margin + col] = np.int16(limit * (1.0 + GROWTH * math.log(min(line[col] / limit, 1e3))))
            line[:] = 0.0


@njit(cache=True)
def _add(total: NDArray[np.int16], values: NDArray[np.int16]) -> None:
    for k in range(total.size):
        total[k] += values[k]


@njit(cache=True)
def _collect(
    total: NDArray[np.int16],
    band: NDArray[np.int16],
    at: tuple[int, int],
    corner: tuple[int, int],
    path: NDArray[np.int32],
    least: float,
    unit: float,
    found: NDArray[np.float32],
    count: int,
) -> int:
    """Local maxima of the sums over a path, all of whose quarters are lit.

    total : with a rim of one pixel. at : row and column of total[0, 0] in the band, corner : in the frame.
    """
    n = path.shape[0]
    quarter = np.zeros(4)
    for i in range(1, total.shape[0] - 1):
        for j in range(1, total.shape[1] - 1):
            value = total[i, j]
            if value <= least or value < total[i - 1, j] or value < total[i, j - 1]:
                continue
            if value <= total[i + 1, j] or value <= total[i, j + 1]:
                continue
            if value < max(total[i - 1, j - 1], total[i - 1, j + 1]) or value <= max(total[i + 1, j - 1], total[i + 1, j + 1]):
                continue
            quarter[:] = 0.0
            for k in range(n):
                quarter[4 * k // n] += band[at[0] + i + path[k, 0], at[1] + j + path[k, 1]]
            quarter.sort()
            if quarter[0] < DARK_QUARTER * 0.25 * value:
                continue
            if count < found.shape[0]:
                found[count, 0], found[count, 1], found[count, 2] = corner[0] + i, corner[1] + j, value * unit
                count += 1
    return count


@njit(cache=True)
def trail_peaks(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma: NDArray[np.float32],
    tile_px: int,
    kernel: NDArray[np.float32],
    paths: NDArray[np.int32],
    steps: NDArray[np.int64],
    noise: NDArray[np.float64],
    block_cols: int,
    threshold: float,
    found: NDArray[np.float32],
) -> int:
    """Maxima of the PSF-smoothed image summed along the stars' trails, (row, col, S/N), block by block of the frame.

    paths : (blocks, steps, 2) pixels of the trail from its centre, block by block in rows. steps : (blocks,) how many of them.
    noise : (blocks,) standard deviation of the sum in sigma of a smoothed pixel. Returns how many fitted into `found`.
    """
    rows, cols = residual.shape
    margin = int(np.max(np.abs(paths))) + 2
    band = np.zeros((BLOCK_PX + 2 * margin, cols + 2 * margin), np.int16)
    total = np.zeros((BLOCK_PX + 2, block_cols + 2), np.int16)
    count, block = 0, 0
    for top in range(0, rows, BLOCK_PX):
        height = min(BLOCK_PX, rows - top)
        _smoothed_rows(residual, mask, sigma, tile_px, kernel, top - margin, band, margin)
        for left in range(0, cols, block_cols):
            width = min(block_cols, cols - left)
            if steps[block] > 0:
                path = paths[block, : steps[block]]
                part = total[: height + 2, : width + 2]
                for i in range(height + 2):
                    part[i] = 0
                    for k in range(path.shape[0]):
                        j = margin + left - 1 + path[k, 1]
                        _add(part[i], band[margin - 1 + i + path[k, 0], j : j + width + 2])
                unit = 1.0 / (UNIT * noise[block])
                at, corner = (margin - 1, margin + left - 1), (top - 1, left - 1)
                count = _collect(part, band, at, corner, path, threshold / unit, unit, found, count)
            block += 1
    return count


def sum_work(motion: StarMotion, shape: tuple[int, ...]) -> float:
    """Operations of the sums along the stars' trails at every pixel; 16-bit sums go many at once."""
    row, col = (np.linspace(0.0, n - 1.0, 9) for n in shape)
    steps = np.maximum(*(np.abs(part) for part in motion.at(*(axis.ravel() for axis in np.meshgrid(row, col, indexing="ij")))))
    return float(SUM_WORK * steps.mean() * shape[0] * shape[1])


def path_of(drow: float, dcol: float) -> NDArray[np.int32]:
    """Pixels (n, 2) of a trail from its centre, one for each step along its longer axis."""
    n = 1 + round(max(abs(drow), abs(dcol)))
    along = (np.arange(n) - 0.5 * (n - 1)) / max(n - 1, 1)
    # halves go one way: the middle of an even number of steps lies half a pixel before the centre
    return np.floor(np.outer(along, (drow, dcol)) + 0.5).astype(np.int32)


def matched_peaks(
    view: DetectorView, motion: StarMotion, psf_sigma_px: float, threshold: float, most: int
) -> NDArray[np.float32]:
    """Trails of the stars' motion (n, 3: row, col, S/N), brightest first; where they are short there are none."""
    rows, cols = view.residual_adu.shape
    block_cols = cols if motion.turn_rad == 0.0 else BLOCK_PX
    tops, lefts = np.arange(0, rows, BLOCK_PX), np.arange(0, cols, block_cols)
    at = np.stack(np.meshgrid(tops + 0.5 * BLOCK_PX, lefts + 0.5 * block_cols, indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = np.column_stack(motion.at(at[:, 0], at[:, 1]))
    each = [path_of(*v) if math.hypot(*v) > SHORT_PX else np.zeros((0, 2), np.int32) for v in vectors]
    steps = np.array([len(path) for path in each])
    paths = np.zeros((len(each), max(1, int(steps.max())), 2), np.int32)
    noise = np.ones(len(each))
    for k, path in enumerate(each):
        paths[k, : len(path)] = path
        apart = ((path[:, None, :] - path[None, :, :]) ** 2).sum(axis=-1)
        noise[k] = math.sqrt(max(1.0, float(np.exp(-0.25 * apart / psf_sigma_px**2).sum())))
    side = np.exp(-0.5 * (np.arange(max(2, math.ceil(2.2 * psf_sigma_px)) + 1) / psf_sigma_px) ** 2)
    kernel = (side / math.sqrt(side[0] ** 2 + 2.0 * float(np.sum(side[1:] ** 2)))).astype(np.float32)
    found = np.empty((most, 3), np.float32)
    background = view.background
    count = trail_peaks(
        view.residual_adu,
        view.mask,
        background.sigma_adu,
        background.tile_px,
        kernel,
        paths,
        steps,
        noise,
        block_cols,
        threshold,
        found,
    )
    return found[:count][np.argsort(-found[:count, 2], kind="stable")]
