"""Particle tracks through the sensitive layer: charge shared by path length, spread by diffusion, clipped at edges."""

import math
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

_REACH: Final = 3.5
"""Sigmas of diffusion beyond which no charge is looked for."""
_STEP_PX: Final = 0.25  # of a diffusing track; a pixel errs by 2 % of the track's charge at most, with 0.5 px by 5 %
_SPREAD_NEGLIGIBLE_PX: Final = 0.02  # narrower clouds stay in their pixel: 0.05 px from a border 1 % would leave


@numba.njit(cache=True)
def deposit(
    row0: NDArray[np.float64],
    col0: NDArray[np.float64],
    row1: NDArray[np.float64],
    col1: NDArray[np.float64],
    depth0: NDArray[np.float64],
    depth1: NDArray[np.float64],
    charge_e: NDArray[np.float64],
    spread_px: float,
    rows: int,
    cols: int,
    capacity: int,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float64]]:
    """Charge in pixels from straight pieces of tracks.

    Charge per unit of path is constant along a piece. Each is cut where it crosses pixel borders, so that without
    diffusion the split by path length is exact. Diffusion is a Gaussian of ``spread_px sqrt(depth)``, depth being 0 at the
    face of the electrodes and 1 at the far one (transport by drift: the spread grows with the root of drift time).

    Returns rows, cols and electrons of pixels, and the electrons that each piece leaves inside the detector.
    """
    out_row = np.empty(capacity, np.int32)
    out_col = np.empty(capacity, np.int32)
    out_e = np.empty(capacity, np.float32)
    inside = np.zeros(row0.size)
    n = 0
    weights = np.empty(64)
    for t in range(row0.size):
        d_row = row1[t] - row0[t]
        d_col = col1[t] - col0[t]
        length = math.sqrt(d_row * d_row + d_col * d_col)
        at = 0.0
        while at < 1.0:
            until = min(1.0, at + _STEP_PX / max(length, 1e-9)) if spread_px > _SPREAD_NEGLIGIBLE_PX else 1.0
            until = min(until, _next_border(row0[t], d_row, at), _next_border(col0[t], d_col, at))
            middle = 0.5 * (at + until)
            row = row0[t] + middle * d_row
            col = col0[t] + middle * d_col
            here_e = charge_e[t] * (until - at)
            sigma = spread_px * math.sqrt(depth0[t] + middle * (depth1[t] - depth0[t]))
            at = until
            r_pixel = math.floor(row + 0.5)
            c_pixel = math.floor(col + 0.5)
            reach = 0 if sigma < _SPREAD_NEGLIGIBLE_PX else min(math.ceil(_REACH * sigma), 15)
            if r_pixel < -reach or r_pixel >= rows + reach or c_pixel < -reach or c_pixel >= cols + reach:
                continue
            if reach == 0:
                if n < capacity:
                    out_row[n], out_col[n], out_e[n] = r_pixel, c_pixel, here_e
                    inside[t] += here_e
                    n += 1
                continue
            scale = 1.0 / (sigma * math.sqrt(2.0))
            width = 2 * reach + 1
            for k in range(width):
                low = (c_pixel - reach + k - 0.5 - col) * scale
                weights[k] = 0.5 * (math.erf(low + scale) - math.erf(low))
            for i in range(width):
                r = r_pixel - reach + i
                if r < 0 or r >= rows:
                    continue
                low = (r - 0.5 - row) * scale
                share = 0.5 * (math.erf(low + scale) - math.erf(low)) * here_e
                for k in range(width):
                    c = c_pixel - reach + k
                    charge = share * weights[k]
                    if c < 0 or c >= cols or charge < 1e-3 or n >= capacity:
                        continue
                    out_row[n], out_col[n], out_e[n] = r, c, charge
                    inside[t] += charge
                    n += 1
    return out_row[:n], out_col[:n], out_e[:n], inside


@numba.njit(cache=True, inline="always")
def _next_border(start: float, step: float, at: float) -> float:
    """Track parameter of the next pixel border along one axis, 1 if there is none before the end."""
    if step == 0.0:
        return 1.0
    position = start + at * step
    if step > 0.0:
        border = math.floor(position + 0.5) + 0.5
    else:
        border = math.ceil(position - 0.5) - 0.5
    where = (border - start) / step
    if where <= at + 1e-12:
        where += 1.0 / abs(step)
    return where
