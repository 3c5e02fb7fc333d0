"""Who meets whom: all objects against all, every approach nearer than a limit, from states on a grid of time.

Between grid epochs motion is a cubic through states (Hermite); a low orbit is then wrong by less than a metre over a minute. At
each fine step objects are sorted into cells (Alfano & Negron 1993 sieved by orbits; cells sieve by place, which misses nothing).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

GRID_S: Final = 60.0
"""Between epochs of given states."""
_FINE_STEPS: Final = 10
"""In a grid step."""
_FASTEST_KM_S: Final = 22.0
"""Two objects at escape velocity, head on."""
_CHUNK_STEPS: Final = 30  # half an hour of states in memory at once (the message below says so)
_MOST_PER_CHUNK: Final = 4_000_000  # rows of five doubles: 160 MB. Wider limits than the memory are refused
_EMPTY: Final = -1  # no object in a cell: not an index


@dataclass(frozen=True, kw_only=True, eq=False)
class Approaches:
    """Closest approaches (n,), in order of time: indices of both objects, s after the start, km, km/s.

    lost : (k,) objects without a state at some epoch; these were screened for the rest.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    time_s: Array
    distance_km: Array
    speed_km_s: Array
    lost: NDArray[np.int64]


def screen(states: Callable[[Array], Array], duration_s: float, limit_km: float) -> Approaches:
    """Every approach of two objects nearer than a limit that is closest within [0, duration).

    states : of times (m,) s gives (n, m, 6) km, km/s, one inertial frame, NaN where an object has none.
    """
    if not 0.0 < limit_km <= 200.0:
        raise UserError(f"screening: distance: expected more than 0 and at most 200 km, got {limit_km:g}")
    if not 0.0 < duration_s <= 30.0 * 86400.0:
        raise UserError(f"screening: duration: expected more than 0 and at most 30 days, got {duration_s / 86400.0:g}")
    found, lost = [], set[int]()
    steps = math.ceil(duration_s / GRID_S)
    for start in range(0, steps, _CHUNK_STEPS):
        stop = min(start + _CHUNK_STEPS, steps)
        chunk = np.ascontiguousarray(np.swapaxes(states(GRID_S * np.arange(start, stop + 1, dtype=np.float64)), 0, 1))
        there = np.isfinite(chunk).all(axis=(0, 2))
        lost.update(np.flatnonzero(~there).tolist())
        chunk[:, ~there] = np.nan
        rows, count = _chunk(chunk, GRID_S, _FINE_STEPS, limit_km, _FASTEST_KM_S, _MOST_PER_CHUNK)
        if count > _MOST_PER_CHUNK:
            raise UserError(f"screening: over {_MOST_PER_CHUNK} approaches in half an hour: choose less than {limit_km:g} km")
        rows = rows[:count]
        rows[:, 2] += GRID_S * start
        found.append(rows[rows[:, 2] < duration_s])
    table = np.vstack(found) if found else np.empty((0, 5))
    table = table[np.lexsort((table[:, 1], table[:, 0], table[:, 2]))]
    return Approaches(
        first=table[:, 0].astype(np.int64),
        second=table[:, 1].astype(np.int64),
        time_s=table[:, 2],
        distance_km=table[:, 3],
        speed_km_s=table[:, 4],
        lost=np.array(sorted(lost), dtype=np.int64),
    )


@njit(cache=True)
def _at(chunk: Array, i: int, t: float, grid_s: float, out: Array) -> None:
    """State of object i at t s after the first epoch of a chunk, into out (6,): cubic Hermite."""
    k = int(t / grid_s)
    if k > len(chunk) - 2:
        k = len(chunk) - 2
    if k < 0:
        k = 0
    u = t / grid_s - k
    u2, u3 = u * u, u * u * u
    h00, h10, h01, h11 = 2.0 * u3 - 3.0 * u2 + 1.0, u3 - 2.0 * u2 + u, 3.0 * u2 - 2.0 * u3, u3 - u2
    d00, d10, d11 = (6.0 * u2 - 6.0 * u) / grid_s, 3.0 * u2 - 4.0 * u + 1.0, 3.0 * u2 - 2.0 * u
    for c in range(3):
        p0, p1, v0, v1 = chunk[k, i, c], chunk[k + 1, i, c], chunk[k, i, 3 + c], chunk[k + 1, i, 3 + c]
        out[c] = h00 * p0 + h01 * p1 + grid_s * (h10 * v0 + h11 * v1)
        out[3 + c] = d00 * (p0 - p1) + d10 * v0 + d11 * v1


@njit(cache=True)
def _opening(chunk: Array, i: int, j: int, t: float, grid_s: float, a: Array, b: Array) -> tuple[float, float, float]:
    """Relative place times relative velocity, squared distance and squared speed of two objects at t."""
    _at(chunk, i, t, grid_s, a)
    _at(chunk, j, t, grid_s, b)
    opening = distance2 = speed2 = 0.0
    for c in range(3):
        away, drift = b[c] - a[c], b[3 + c] - a[3 + c]
        opening += away * drift
        distance2 += away * away
        speed2 += drift * drift
    return opening, distance2, speed2


@njit(cache=True)
def _chunk(chunk: Array, grid_s: float, fine_steps: int, limit_km: float, fastest_km_s: float, most: int) -> tuple[Array, int]:
    """Rows (i, j, time, distance, speed) of approaches within a chunk (m, n, 6) of states, and how many there are."""
    m, n = chunk.shape[0], chunk.shape[1]
    dt = grid_s / fine_steps
    half = 0.5 * dt
    # two that meet within half a step are now within this of each other; their relative acceleration adds little
    reach = limit_km + fastest_km_s * half
    bins = 1
    while bins < 4 * n:
        bins *= 2
    mask = bins - 1
    head = np.empty(bins, dtype=np.int64)
    after = np.empty(n, dtype=np.int64)
    cell = np.empty((n, 3), dtype=np.int64)
    now = np.empty((n, 6))
    rows = np.empty((1024, 5))
    count = 0
    a, b = np.empty(6), np.empty(6)
    for step in range((m - 1) * fine_steps):
        t = (step + 0.5) * dt
        head[:] = _EMPTY
        for i in range(n):
            if math.isnan(chunk[0, i, 0]):
                continue
            _at(chunk, i, t, grid_s, now[i])
            for c in range(3):
                cell[i, c] = math.floor(now[i, c] / reach)
            # its own cell and the 26 around it, against those sorted in before it
            for x in range(cell[i, 0] - 1, cell[i, 0] + 2):
                for y in range(cell[i, 1] - 1, cell[i, 1] + 2):
                    for z in range(cell[i, 2] - 1, cell[i, 2] + 2):
                        j = head[(x * 73856093 ^ y * 19349663 ^ z * 83492791) & mask]
                        while j != _EMPTY:
                            if cell[j, 0] == x and cell[j, 1] == y and cell[j, 2] == z:
                                count = _meet(chunk, j, i, now, t, half, grid_s, limit_km, a, b, rows, count)
                                if count == len(rows):
                                    if count >= most:
                                        return rows, most + 1
                                    more = np.empty((2 * count, 5))
                                    more[:count] = rows
                                    rows = more
                            j = after[j]
            key = (cell[i, 0] * 73856093 ^ cell[i, 1] * 19349663 ^ cell[i, 2] * 83492791) & mask
            after[i] = head[key]
            head[key] = i
    return rows, count


@njit(cache=True)
def _meet(
    chunk: Array, i: int, j: int, now: Array, t: float, half: float, grid_s: float, limit_km: float,
    a: Array, b: Array, rows: Array, count: int,
) -> int:  # fmt: skip
    """Add the approach of two objects within half a step of t, if there is one; the new count."""
    opening = distance2 = speed2 = 0.0
    for c in range(3):
        away, drift = now[j, c] - now[i, c], now[j, 3 + c] - now[i, 3 + c]
        opening += away * drift
        distance2 += away * away
        speed2 += drift * drift
    # on straight lines, with what half a step can bend them: relative acceleration times half a step squared
    bend = 0.02 * half * half
    reach = limit_km + bend + math.sqrt(speed2) * half
    if distance2 > reach * reach:
        return count
    if speed2 * half > bend * bend:
        miss2 = distance2 - opening * opening / speed2
        if miss2 > (limit_km + bend) ** 2:
            return count
    low, high = t - half, t + half
    before, _, _ = _opening(chunk, i, j, low, grid_s, a, b)
    later, _, _ = _opening(chunk, i, j, high, grid_s, a, b)
    if before >= 0.0 or later < 0.0:
        return count
    for _ in range(60):
        middle = 0.5 * (low + high)
        here, _, s2 = _opening(chunk, i, j, middle, grid_s, a, b)
        guess = middle - here / s2 if s2 > 0.0 else middle
        if here < 0.0:
            low = middle
        else:
            high = middle
        if low < guess < high:
            value, _, _ = _opening(chunk, i, j, guess, grid_s, a, b)
            if value < 0.0:
                low = guess
            else:
                high = guess
        if high - low < 1e-7:
            break
    best = 0.5 * (low + high)
    _, distance2, speed2 = _opening(chunk, i, j, best, grid_s, a, b)
    if distance2 >= limit_km * limit_km:
        return count
    rows[count, 0], rows[count, 1] = min(i, j), max(i, j)
    rows[count, 2], rows[count, 3], rows[count, 4] = best, math.sqrt(distance2), math.sqrt(speed2)
    return count + 1
