"""Nearest neighbours among points of a frame, by a scan of the rows within reach: lists are thousands long, reach a few px."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def nearest(
    points: NDArray[np.float64], among: NDArray[np.float64], within_px: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance and index of the nearest of `among` (m, 2) to each point (n, 2); inf and 0 where none is within reach."""
    order = np.argsort(among[:, 0])
    row = among[order, 0]
    distance, index = np.full(points.shape[0], np.inf), np.zeros(points.shape[0], dtype=np.int64)
    for n in range(points.shape[0]):
        best = within_px * within_px
        for k in range(np.searchsorted(row, points[n, 0] - within_px), row.size):
            if row[k] > points[n, 0] + within_px:
                break
            square = (row[k] - points[n, 0]) ** 2 + (among[order[k], 1] - points[n, 1]) ** 2
            if square < best:
                best = square
                distance[n], index[n] = math.sqrt(square), order[k]
    return distance, index


@njit(cache=True)
def number_within(points: NDArray[np.float64], within_px: float) -> NDArray[np.int64]:
    """How many of the points (n, 2), itself included, lie within a distance of each."""
    order = np.argsort(points[:, 0])
    row = points[order, 0]
    number = np.zeros(points.shape[0], dtype=np.int64)
    for n in range(points.shape[0]):
        for k in range(np.searchsorted(row, points[n, 0] - within_px), row.size):
            if row[k] > points[n, 0] + within_px:
                break
            square = (row[k] - points[n, 0]) ** 2 + (points[order[k], 1] - points[n, 1]) ** 2
            number[n] += 1 if square <= within_px * within_px else 0
    return number


@njit(cache=True)
def inside(
    row: NDArray[np.float64], col: NDArray[np.float64], ends: tuple[float, float, float, float], reach_px: float
) -> NDArray[np.int64]:
    """Which of some points (n,) lie in the upright rectangle about a segment (row0, col0, row1, col1), grown by a reach (px)."""
    top, bottom = min(ends[0], ends[2]) - reach_px, max(ends[0], ends[2]) + reach_px
    left, right = min(ends[1], ends[3]) - reach_px, max(ends[1], ends[3]) + reach_px
    found, count = np.empty(row.size, np.int64), 0
    for k in range(row.size):
        if top <= row[k] <= bottom and left <= col[k] <= right:
            found[count] = k
            count += 1
    return found[:count]
