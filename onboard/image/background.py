"""Background mesh: level and noise of the sky on square tiles, straight from raw minus dark.

Every eighth row is enough (a tile of 64 x 64 px then has 512 samples: level to 0.05 sigma, noise to 3 %); the mesh is
median-filtered over 3 x 3 tiles against bright stars, as in Source Extractor (Bertin & Arnouts 1996, section 7.1).
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image.least_noise import LEAST_SIGMA, with_least_noise
from sboc_e2e.icd.signals import BackgroundModel

PROBES = 49
"""Samples of a tile that centre its histogram."""

BINS = 512  # sigma is below 12 of them (`clipped_mesh`), so that they reach 21 sigma to either side
CLIP_SIGMA = 3.0  # sigmas; CLIPPED_STD belongs to it
CLIPPED_STD = 0.9866
"""Standard deviation of a unit Gaussian cut at +-3: 0.98658."""

LEAST_SAMPLES = 32  # a mean good to 0.18 sigma; tiles with fewer are filled from others
FREE_SLOPE = 0.5
"""Slopes of a mesh, in sigma from tile to tile, that go on beyond the outer nodes whatever lies inside of them."""


@njit(cache=True)
def _probe_tiles(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: NDArray[np.int16],
    mask: NDArray[np.uint8],
    row0: int,
    row1: int,
    tile_px: int,
    probes: NDArray[np.int64],
    count: NDArray[np.int64],
) -> None:
    """Up to `PROBES` usable pixels spread over each tile of a row of tiles, sorted, into (tiles, PROBES); and how many."""
    cols, side = pixels.shape[1], 7
    count[:] = 0
    for i in range(side):
        row = row0 + (2 * i + 1) * (row1 - row0) // (2 * side)
        for tile in range(count.size):
            col0, col1 = tile * tile_px, min((tile + 1) * tile_px, cols)
            sorted_probes = probes[tile]
            for j in range(side):
                col = col0 + (2 * j + 1) * (col1 - col0) // (2 * side)
                if mask[row, col] == 0:
                    value = np.int64(pixels[row, col]) - np.int64(dark[row, col])
                    k = count[tile]
                    while k > 0 and sorted_probes[k - 1] > value:
                        sorted_probes[k] = sorted_probes[k - 1]
                        k -= 1
                    sorted_probes[k] = value
                    count[tile] += 1


@njit(cache=True)
def _shortest_half(probes: NDArray[np.int64]) -> tuple[int, int]:
    """Middle and half width of the shortest half of sorted values; (0, -1) if there are none.

    The shortest half (Rousseeuw 1984, JASA 79, 871) stays with the sky when stars or an overscan fill up to half a tile.
    """
    if probes.size == 0:
        return 0, -1
    half = probes.size // 2
    best = 0
    for k in range(probes.size - half):
        if probes[k + half] - probes[k] < probes[best + half] - probes[best]:
            best = k
    return (probes[best] + probes[best + half]) // 2, (probes[best + half] - probes[best]) // 2


@njit(cache=True)
def _bins_of_row(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: NDArray[np.int16],
    mask: NDArray[np.uint8],
    base: int,
    shift: int,
    out: NDArray[np.int32],
) -> None:
    """Bin of each pixel of a row, `BINS` for those that are masked or beyond; vector instructions, apart from the counting."""
    for col in range(out.size):
        value = (np.int64(pixels[col]) - np.int64(dark[col]) - base) >> shift
        inside = 0 <= value < BINS and mask[col] == 0
        out[col] = np.int32(value) if inside else np.int32(BINS)


@njit(cache=True)
def _clipped_moments(histogram: NDArray[np.int32], start: int, spread: float) -> tuple[float, float, int]:
    """Mean and standard deviation, in bins, of the values within +-3 sigma of the mean, iterated from a start."""
    centre, sigma, number = float(start), spread, 0
    for _ in range(8):
        low = max(0, math.ceil(centre - CLIP_SIGMA * sigma))
        high = min(BINS - 1, math.floor(centre + CLIP_SIGMA * sigma))
        number, total, squares = 0, 0.0, 0.0
        for k in range(low, high + 1):
            number += histogram[k]
            total += histogram[k] * k
            squares += histogram[k] * float(k) * k
        if number == 0:
            return centre, sigma, 0
        mean = total / number
        new_sigma = max(math.sqrt(max(squares / number - mean * mean, 0.0)) / CLIPPED_STD, LEAST_SIGMA)
        settled = abs(mean - centre) < 0.002 * sigma and abs(new_sigma - sigma) < 0.002 * sigma
        centre, sigma = mean, new_sigma
        if settled:
            break
    return centre, sigma, number


@njit(cache=True)
def clipped_mesh(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: NDArray[np.int16],
    mask: NDArray[np.uint8],
    tile_px: int,
    row_step: int,
    level: NDArray[np.float32],
    sigma: NDArray[np.float32],
) -> None:
    """Clipped mean and standard deviation of pixels - dark in each tile; NaN where too few pixels are usable."""
    rows, cols = pixels.shape
    tiles = level.shape[1]
    probes, count = np.empty((tiles, PROBES), dtype=np.int64), np.empty(tiles, dtype=np.int64)
    base, shift, half_range = np.empty(tiles, np.int64), np.empty(tiles, np.int64), np.empty(tiles, np.int64)
    histogram = np.empty((tiles, BINS + 1), dtype=np.int32)
    bins = np.empty(tile_px, dtype=np.int32)
    for i in range(level.shape[0]):
        row0, row1 = i * tile_px, min((i + 1) * tile_px, rows)
        _probe_tiles(pixels, dark, mask, row0, row1, tile_px, probes, count)
        for j in range(tiles):
            middle, half_range[j] = _shortest_half(probes[j, : count[j]])
            shift[j] = 0  # bins are a power of two wide
            while half_range[j] >> (shift[j] + 3) > 0:
                shift[j] += 1
            base[j] = middle - (np.int64(BINS // 2) << shift[j])
        histogram[:] = 0
        step = row_step if row1 - row0 >= 4 * row_step else 1
        # along the rows, as the memory lies
        for row in range(row0 + step // 2, row1, step):
            for j in range(tiles):
                part = slice(j * tile_px, min((j + 1) * tile_px, cols))
                width = part.stop - part.start
                _bins_of_row(pixels[row, part], dark[row, part], mask[row, part], base[j], shift[j], bins[:width])
                for k in range(width):
                    histogram[j, bins[k]] += 1
        for j in range(tiles):
            level[i, j] = np.nan
            sigma[i, j] = np.nan
            if half_range[j] < 0:
                continue
            bin_width = float(np.int64(1) << shift[j])
            mean, deviation, number = _clipped_moments(histogram[j], BINS // 2, max(1.5 * half_range[j] / bin_width, 1.5))
            if number >= LEAST_SAMPLES:
                level[i, j] = base[j] + mean * bin_width + 0.5 * (bin_width - 1.0)
                variance = (deviation * bin_width) ** 2 - (bin_width * bin_width - 1.0) / 12.0
                sigma[i, j] = math.sqrt(max(variance, LEAST_SIGMA * LEAST_SIGMA))


def neighbourhoods(mesh: NDArray[np.float32]) -> NDArray[np.float32]:
    """(9, rows, cols): every node with its eight neighbours; the outer nodes are repeated beyond the edge."""
    return _blocks(np.pad(mesh, 1, mode="edge"))


def straight_neighbourhoods(mesh: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """(9, rows, cols): the same, straight on beyond the edge: there, too, their median and mean on a slope are the node."""
    return _blocks(continued(mesh, sigma))


def _blocks(padded: NDArray[np.float32]) -> NDArray[np.float32]:
    """(9, rows, cols) of a mesh (rows + 2, cols + 2)."""
    rows, cols = padded.shape[0] - 2, padded.shape[1] - 2
    return np.stack([padded[i : i + rows, j : j + cols] for i in range(3) for j in range(3)])


def continued(mesh: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """The mesh with one node more on each side, where the slope of the outer interval leads; (rows + 2, cols + 2).

    A slope of more than `FREE_SLOPE` sigma goes on if the next interval has half as much of it: a step between the two outer
    nodes, as an overscan makes it, does not.
    """
    for axis in (0, 1):
        nodes = np.moveaxis(mesh, axis, 0)
        before, after = (_next(outer, FREE_SLOPE * sigma) for outer in (nodes[:3], nodes[-3:][::-1]))
        mesh = np.moveaxis(np.concatenate((before[None], nodes, after[None])), 0, axis)
    return mesh


def _next(outer: NDArray[np.float32], free: float) -> NDArray[np.float32]:
    """The nodes beyond the outer ones (up to 3, n); the first is at the edge. free : slope that always goes on."""
    if len(outer) < 3:
        return np.asarray(outer[0])
    slope, inner = outer[0] - outer[1], 2.0 * (outer[1] - outer[2])
    most = np.maximum(np.where(slope * inner > 0.0, np.abs(inner), 0.0), free)
    return np.asarray(outer[0] + np.clip(slope, -most, most), dtype=outer.dtype)


def fill_gaps(mesh: NDArray[np.float32], otherwise: float) -> NDArray[np.float32]:
    """Replace NaN nodes by the mean of their known neighbours, ring by ring; a mesh of NaN becomes a constant."""
    known = np.isfinite(mesh)
    if not known.any():
        return np.full_like(mesh, otherwise)
    filled = np.where(known, mesh, 0.0).astype(np.float64)
    while not known.all():
        values, weights = np.pad(filled * known, 1), np.pad(known.astype(np.float64), 1)
        rows, cols = mesh.shape
        shifts = [(i, j) for i in range(3) for j in range(3)]
        total = np.sum([values[i : i + rows, j : j + cols] for i, j in shifts], axis=0)
        weight = np.sum([weights[i : i + rows, j : j + cols] for i, j in shifts], axis=0)
        new = ~known & (weight > 0)
        filled[new] = total[new] / weight[new]
        known = known | new
    return filled.astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class MeshBackground:
    """`mesh`: clipped mean and noise on square tiles."""

    tile_px: int = field(default=64, metadata={"doc": "side of a tile", "min": 8, "max": 1024})
    row_step: int = field(default=8, metadata={"doc": "rows from one that is looked at to the next", "min": 1, "max": 64})

    def estimate(
        self, pixels_adu: NDArray[np.int32] | NDArray[np.uint16], dark_adu: NDArray[np.int16], mask: NDArray[np.uint8]
    ) -> BackgroundModel:
        """Mesh of ``pixels - dark`` over pixels whose mask is 0."""
        rows, cols = pixels_adu.shape
        shape = (-(-rows // self.tile_px), -(-cols // self.tile_px))
        level, sigma = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
        clipped_mesh(pixels_adu, dark_adu, mask, self.tile_px, self.row_step, level, sigma)
        level, sigma = fill_gaps(level, 0.0), with_least_noise(fill_gaps(sigma, 1.0), 1.0)
        return BackgroundModel(
            tile_px=self.tile_px,
            level_adu=np.median(straight_neighbourhoods(level, float(np.median(sigma))), axis=0),
            sigma_adu=np.median(neighbourhoods(sigma), axis=0),
        )
