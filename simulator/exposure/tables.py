"""Points onto pixels from tables of a PSF, and the light far from bright ones."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

FAINTEST_E = 0.02
"""Electrons per pixel below which light far from a point is left out."""
FARTHEST_PX = 600.0
"""Rings are drawn no farther, arms to four times as far: a budget of time for saturated stars. Chosen, not measured."""


@numba.njit(cache=True)
def add_table_points(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    node: NDArray[np.int64],
    tables: NDArray[np.float32],
    reach: NDArray[np.float64],
    phases: int,
    faintest_e: float,
) -> None:
    """Add points, each with the table of its node, bilinear between the table's phases, in place.

    tables : (nodes, n, n), n = 2 half phases + 1, share of a pixel ``(i / phases - half, j / phases - half)`` from the point.
    reach : (half + 1,) largest share at this many pixels or farther. Points are drawn to where it still gives `faintest_e`.
    """
    rows, cols = image_e.shape
    farthest = reach.size - 1
    for p in range(row.size):
        flux = flux_e[p]
        if not flux > 0.0:
            continue
        half = 1
        while half < farthest and flux * reach[half] > faintest_e:
            half += 1
        first_row, first_col = math.ceil(row[p] - half), math.ceil(col[p] - half)
        if first_row >= rows or first_col >= cols or first_row + 2 * half < 0 or first_col + 2 * half < 0:
            continue
        x = (first_row - row[p] + farthest) * phases
        y = (first_col - col[p] + farthest) * phases
        i0, j0 = int(x), int(y)
        fx, fy = x - i0, y - j0
        w00 = np.float32(flux * (1.0 - fx) * (1.0 - fy))
        w01 = np.float32(flux * (1.0 - fx) * fy)
        w10 = np.float32(flux * fx * (1.0 - fy))
        w11 = np.float32(flux * fx * fy)
        table = tables[node[p]]
        last = table.shape[0] - 1
        n_rows = 2 * half + (1 if first_row == row[p] - half else 0)
        n_cols = 2 * half + (1 if first_col == col[p] - half else 0)
        from_col, to_col = max(0, -first_col), min(n_cols, cols - first_col)
        for k in range(max(0, -first_row), min(n_rows, rows - first_row)):
            upper = table[i0 + k * phases]
            lower = table[min(i0 + k * phases + 1, last)]
            line = image_e[first_row + k]
            for m in range(from_col, to_col):
                j = j0 + m * phases
                j1 = min(j + 1, last)
                line[first_col + m] += w00 * upper[j] + w01 * upper[j1] + w10 * lower[j] + w11 * lower[j1]


@numba.njit(cache=True)
def add_rings(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    profile: NDArray[np.float64],
    per_px: int,
    half: int,
    faintest_e: float,
) -> None:
    """Add what a round profile has outside the squares that `add_table_points` fills, in place.

    profile : (n,) falling share of a pixel at distances k / per_px.
    """
    rows, cols = image_e.shape
    for p in range(row.size):
        flux = flux_e[p]
        low, high = 0, profile.size - 1
        while low < high:  # the last distance at which the light is drawn
            middle = (low + high + 1) // 2
            if flux * profile[middle] > faintest_e:
                low = middle
            else:
                high = middle - 1
        radius = low / per_px
        if radius <= half:
            continue
        for r in range(max(0, math.ceil(row[p] - radius)), min(rows, math.floor(row[p] + radius) + 1)):
            d_row = r - row[p]
            near = abs(d_row) <= half
            across = math.sqrt(max(radius * radius - d_row * d_row, 0.0))
            line = image_e[r]
            for c in range(max(0, math.ceil(col[p] - across)), min(cols, math.floor(col[p] + across) + 1)):
                d_col = c - col[p]
                if near and abs(d_col) <= half:
                    continue
                place = math.sqrt(d_row * d_row + d_col * d_col) * per_px
                k = int(place)
                line[c] += np.float32(flux * (profile[k] + (profile[min(k + 1, profile.size - 1)] - profile[k]) * (place - k)))


@numba.njit(cache=True)
def add_arms(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    arms: NDArray[np.float64],
    share: float,
    core_px: float,
    sigma_px: float,
    half: int,
    faintest_e: float,
) -> None:
    """Add diffraction spikes outside the squares of the tables: arms along (row, col) unit vectors, Gaussian across, in place."""
    rows, cols = image_e.shape
    width = math.sqrt(2.0 * math.pi) * sigma_px
    side = math.ceil(4.0 * sigma_px) + 1
    for p in range(row.size):
        peak = flux_e[p] * share * 2.0 / math.pi * core_px / width
        if peak <= faintest_e * core_px * core_px:
            continue
        length = min(math.sqrt(peak / faintest_e), 4.0 * FARTHEST_PX)
        for a in range(arms.shape[0]):
            d_row, d_col = arms[a, 0], arms[a, 1]
            steep = abs(d_row) >= abs(d_col)
            lead = d_row if steep else d_col
            slope = (d_col / d_row) if steep else (d_row / d_col)
            start = row[p] if steep else col[p]
            other = col[p] if steep else row[p]
            n = rows if steep else cols
            limit = cols if steep else rows
            first = math.ceil(min(start, start + lead * length))
            stop = math.floor(max(start, start + lead * length)) + 1
            for k in range(max(0, first), min(n, stop)):
                middle = other + slope * (k - start)
                for m in range(max(0, math.floor(middle) - 2 * side), min(limit, math.ceil(middle) + 2 * side + 1)):
                    r, c = (k, m) if steep else (m, k)
                    y, x = r - row[p], c - col[p]
                    if abs(y) <= half and abs(x) <= half:
                        continue
                    along, across = y * d_row + x * d_col, y * d_col - x * d_row
                    if along < 0.0:
                        continue
                    image_e[r, c] += np.float32(
                        peak / (core_px * core_px + along * along) * math.exp(-0.5 * (across / sigma_px) ** 2)
                    )


@numba.njit(cache=True)
def add_discs(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    diameter_px: float,
    faintest_e: float,
) -> None:
    """Add uniform discs, in place; a pixel on the rim gets the part of it that a straight rim would leave."""
    rows, cols = image_e.shape
    radius = 0.5 * diameter_px
    for p in range(row.size):
        level = flux_e[p] / (math.pi * radius * radius)
        if level <= faintest_e:
            continue
        for r in range(max(0, math.ceil(row[p] - radius - 1.0)), min(rows, math.floor(row[p] + radius + 1.0) + 1)):
            for c in range(max(0, math.ceil(col[p] - radius - 1.0)), min(cols, math.floor(col[p] + radius + 1.0) + 1)):
                distance = math.sqrt((r - row[p]) ** 2 + (c - col[p]) ** 2)
                image_e[r, c] += np.float32(level * min(max(radius - distance + 0.5, 0.0), 1.0))
