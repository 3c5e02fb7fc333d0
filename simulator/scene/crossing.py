"""Exposure of a moving object: a row-dependent shutter decides which part of a path leaves light on the detector.

An object at row r(t) is exposed while its own row is open, ``0 <= t - (t_start + line_time r(t)) <= exposure``. For
``r = r0 + v t`` that lasts ``exposure / |1 - v line_time|``; nothing here assumes a constant speed. The row of the PSF's
centre decides for the whole PSF (the next rows open 10 us later, in which 10,000 px/s are 0.1 px).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.platform.shutter import FrameTiming

Array = NDArray[np.float64]
Place = Callable[[Array], tuple[Array, Array]]
"""Times (s after the epoch of the run) to rows and cols of the read-out window; NaN where nothing is seen."""

_SCAN = 2049  # instants of the first look: stretches shorter than 1/2048 of the span may be missed
_REFINE = 33  # instants of each of four looks at an end: 1 / (2048 x 32^4) of the span is 5e-10


@dataclass(frozen=True, kw_only=True)
class RowShutter:
    """Opening of rows: row r is open from ``open_s + line_s r`` for `exposure_s`."""

    open_s: float
    line_s: float
    exposure_s: float
    rows: int
    cols: int

    def since_open(self, time_s: Array, row: Array) -> Array:
        """Seconds since the row opened."""
        return np.asarray(time_s - self.open_s - self.line_s * row)


def row_shutter(timing: FrameTiming, epoch_tai_ns: int, exposure_s: float, shape: tuple[int, int]) -> RowShutter:
    """When the rows of a window of a given shape (rows, cols) are open in a frame; seconds after the epoch."""
    return RowShutter(
        open_s=(timing.t_start_tai_ns - epoch_tai_ns) * 1e-9,
        line_s=timing.line_time_ns * 1e-9,
        exposure_s=exposure_s,
        rows=shape[0],
        cols=shape[1],
    )


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An exposed stretch of a path. `edge` : whether the frame's edge ends it instead of the shutter."""

    start_s: float
    end_s: float
    edge_start: bool
    edge_end: bool


def exposed_intervals(place: Place, shutter: RowShutter, margin_px: float, from_s: float, to_s: float) -> list[Interval]:
    """Stretches of time within [from_s, to_s] during which the object is exposed and at most `margin_px` outside the frame.

    Their ends are accurate to 1e-9 of the scanned span; stretches shorter than 1/2048 of it may be missed. None where to_s is
    not after from_s.
    """
    if to_s <= from_s:
        return []

    def slack(time_s: Array) -> tuple[Array, Array]:
        row, col = place(time_s)
        inside = np.minimum(
            np.minimum(row + margin_px, shutter.rows - 1 + margin_px - row),
            np.minimum(col + margin_px, shutter.cols - 1 + margin_px - col),
        )
        since = shutter.since_open(time_s, row)
        lit = np.minimum(since, shutter.exposure_s - since)
        return np.nan_to_num(inside, nan=-1.0), np.nan_to_num(lit, nan=-1.0)

    time_s = np.linspace(from_s, to_s, _SCAN)
    inside, lit = slack(time_s)
    seen = (inside >= 0.0) & (lit >= 0.0)
    if not seen.any():
        return []
    change = np.diff(np.concatenate([[False], seen, [False]]).astype(np.int8))
    intervals = []
    for first, beyond in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
        start_s, edge_start = time_s[first], inside[first] < lit[first] and first > 0
        if first > 0:
            start_s, edge_start = _refine(slack, time_s[first - 1], time_s[first])
        end_s, edge_end = time_s[beyond - 1], False
        if beyond < _SCAN:
            end_s, edge_end = _refine(slack, time_s[beyond], time_s[beyond - 1])
        if end_s > start_s:
            intervals.append(
                Interval(start_s=float(start_s), end_s=float(end_s), edge_start=bool(edge_start), edge_end=bool(edge_end))
            )
    return intervals


def _refine(slack: Callable[[Array], tuple[Array, Array]], dark_s: float, seen_s: float) -> tuple[float, bool]:
    """The instant between an unseen and a seen one, on the seen side, and whether the frame's edge decides it."""
    edge = False
    for _ in range(4):
        time_s = np.linspace(dark_s, seen_s, _REFINE)
        inside, lit = slack(time_s)
        seen = (inside >= 0.0) & (lit >= 0.0)
        seen[-1] = True
        first = int(np.argmax(seen))
        if first == 0:
            return float(time_s[0]), edge
        edge = bool(inside[first - 1] < 0.0)
        dark_s, seen_s = time_s[first - 1], time_s[first]
    return float(seen_s), edge


def arc_length_px(chord_px: float, sagitta_px: float) -> float:
    """Length of a flat arc, ``c + 8 s^2 / 3 c``; jitter along the way is not counted as length."""
    if chord_px <= 4.0 * abs(sagitta_px):
        return float(np.hypot(chord_px, 2.0 * sagitta_px))
    return float(chord_px + 8.0 * sagitta_px**2 / (3.0 * chord_px))


def time_bins(place: Place, interval: Interval, step_px: float, longest_s: float = np.inf) -> Array:
    """Edges (n + 1,) of equal bins, so short that the object moves at most `step_px` in each, and at most `longest_s` long."""
    nodes = np.linspace(interval.start_s, interval.end_s, 65)
    row, col = place(nodes)
    fastest = float(np.hypot(np.diff(row), np.diff(col)).max()) * 64.0
    n = max(int(np.ceil(fastest / step_px)), int(np.ceil((interval.end_s - interval.start_s) / longest_s)), 2)
    return np.linspace(interval.start_s, interval.end_s, n + 1)
