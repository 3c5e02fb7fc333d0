"""Continuous maximum of the matched filter over a segment's ends, offset, angle and curvature, and what tells it from stars.

A segment is (major0, minor0, major1, minor1, sagitta along minor), in px; see `corridor` for the axes.
"""

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.cross_profile import cross_profile
from onboard.detect.line_integral.strip import Strip, cross_sections, gather, minor_at, path_sums
from onboard.detect.whiten import FOUND_BIT, POINT_BIT


@nb.njit(cache=True, error_model="numpy")
def profile_snr(signal: NDArray[np.float64], weight: NDArray[np.float64], n: int) -> float:
    """Matched-filter S/N of the first n lines of a cross profile: sum(signal) / sqrt(sum(weight))."""
    s = w = 0.0
    for k in range(n):
        s += signal[k]
        w += weight[k]
    return s / math.sqrt(w) if w > 0.0 else 0.0


@nb.njit(cache=True, error_model="numpy")
def best_run(signal: NDArray[np.float64], weight: NDArray[np.float64], n: int, min_px: int) -> tuple[float, int, int]:
    """The run of lines [i, j) with the largest sum(signal)/sqrt(sum(weight)), found on a lattice of steps, then refined.

    Lines without weight, outside the frame or masked, belong to no run: its ends have some.
    """
    cumulative_s, cumulative_w = np.zeros(n + 1), np.zeros(n + 1)
    for k in range(n):
        cumulative_s[k + 1] = cumulative_s[k] + signal[k]
        cumulative_w[k + 1] = cumulative_w[k] + weight[k]
    step = max(1, n // 64)
    best, first, last = -1e9, 0, n
    for i in range(0, n, step):
        for j in range(i + step, n + 1, step):
            w = cumulative_w[j] - cumulative_w[i]
            if w > 0.0 and j - i >= min_px:
                value = (cumulative_s[j] - cumulative_s[i]) / math.sqrt(w)
                if value > best:
                    best, first, last = value, i, j
    while step > 1:
        finer = max(1, step // 4)
        i_low, i_high = max(0, first - step), min(n, first + step)
        j_low, j_high = max(0, last - step), min(n, last + step)
        for i in range(i_low, i_high + 1, finer):
            for j in range(max(j_low, i + min_px), j_high + 1, finer):
                w = cumulative_w[j] - cumulative_w[i]
                if w > 0.0:
                    value = (cumulative_s[j] - cumulative_s[i]) / math.sqrt(w)
                    if value > best:
                        best, first, last = value, i, j
        step = finer
    while first < last and weight[first] == 0.0:
        first += 1
    while last > first and weight[last - 1] == 0.0:
        last -= 1
    return best, first, last


@nb.njit(cache=True, error_model="numpy")
def polish(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    segment: NDArray[np.float64],
    bent_from_px: float,
    psf_sigma_px: float,
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
    strip: Strip,
) -> float:
    """Maximise the matched filter over a segment (major0, minor0, major1, minor1, sagitta), in place; returns the S/N.

    bent_from_px : the sagitta of segments at least this long is free. It is a number and no truth value, which as a literal would
    have numba compile each case.
    """
    values, usable, clean, corner, shift, table, norms = strip
    trial = np.empty(5)
    snr = -1e9
    low = n = 0
    for turn in range(3):
        step = (0.6, 0.3, 0.15)[turn]
        extend = int(max(12.0, 0.3 * (segment[2] - segment[0])))
        # a strip serves all turns, unless the ends have come near its own
        near0 = low > 0 and segment[0] - low < 0.5 * extend
        near1 = low + n < image.shape[0] and low + n - segment[2] < 0.5 * extend
        if turn == 0 or near0 or near1:
            low, n = gather(image, blocked, level, tile_px, segment, extend, values, usable, clean, corner, shift)
        first, last = max(0, math.ceil(segment[0]) - low), min(n, math.floor(segment[2]) + 1 - low)
        for _ in range(6):
            improved = False
            slope = (segment[3] - segment[1]) / max(segment[2] - segment[0], 1e-6)
            cross_sections(slope, psf_sigma_px, table, norms)
            snr = path_sums(values, usable, clean, corner, shift, first, last, low, segment, table, norms, signal, weight)
            for parameter in range(4):
                if parameter == 3 and segment[2] - segment[0] < bent_from_px:
                    continue
                for sign in (-1.0, 1.0):
                    trial[:] = segment
                    trial[1] += sign * step if parameter in (0, 2) else 0.0
                    trial[3] += sign * step if parameter in (1, 2) else 0.0
                    if parameter == 3:  # about its mean place, or bend and offset would wait for each other
                        trial[1] -= 2.0 / 3.0 * sign * step
                        trial[3] -= 2.0 / 3.0 * sign * step
                        trial[4] += sign * step
                    value = path_sums(values, usable, clean, corner, shift, first, last, low, trial, table, norms, signal, weight)
                    if value > snr + 1e-3:
                        snr, improved = value, True
                        segment[:] = trial
                        break
            if not improved:
                break
        whole = path_sums(values, usable, clean, corner, shift, 0, n, low, segment, table, norms, signal, weight)
        if whole < -1e8:  # the segment has turned so far that its extension leaves the strip
            low, n = gather(image, blocked, level, tile_px, segment, extend, values, usable, clean, corner, shift)
            path_sums(values, usable, clean, corner, shift, 0, n, low, segment, table, norms, signal, weight)
        snr, i, j = best_run(signal, weight, n, 4)
        start, stop = low + i - 0.5, low + j - 0.5
        old = max(segment[2] - segment[0], 1e-6)
        begin, end = minor_at(segment, start), minor_at(segment, stop)
        segment[0], segment[1], segment[2], segment[3] = start, begin, stop, end
        segment[4] *= ((stop - start) / old) ** 2
    return snr


@nb.njit(cache=True)
def quarters(signal: NDArray[np.float64], weight: NDArray[np.float64], n: int) -> float:
    """Chi-square (3 degrees of freedom) of four quarters of equal weight against one density."""
    total_s = total_w = 0.0
    for k in range(n):
        total_s += signal[k]
        total_w += weight[k]
    if total_w <= 0.0:
        return 0.0
    density = total_s / total_w
    chi2 = 0.0
    s = w = 0.0
    quarter, seen = 0, 0.0
    for k in range(n):
        s += signal[k]
        w += weight[k]
        seen += weight[k]
        if seen >= 0.25 * (quarter + 1) * total_w or k == n - 1:
            if w > 0.0:
                chi2 += (s - density * w) ** 2 / w
            s = w = 0.0
            quarter += 1
    return chi2


@nb.njit(cache=True)
def blank_path(smooth: NDArray[np.int8], blocked: NDArray[np.uint8], segment: NDArray[np.float64], half_width: float) -> None:
    """Take a found segment out: pixels within half_width across it become 0 in `smooth` and blocked (FOUND_BIT). In place."""
    n_major, n_minor = smooth.shape
    slope = (segment[3] - segment[1]) / max(segment[2] - segment[0], 1e-6)
    reach = half_width * math.sqrt(1.0 + slope * slope)
    for major in range(max(0, int(segment[0] - half_width)), min(n_major - 1, int(segment[2] + half_width) + 1) + 1):
        minor = minor_at(segment, float(major))
        for j in range(max(0, math.ceil(minor - reach)), min(n_minor - 1, math.floor(minor + reach)) + 1):
            smooth[major, j] = 0
            blocked[major, j] |= FOUND_BIT


@nb.njit(cache=True)
def brightest_points(
    smooth: NDArray[np.int8], segment: NDArray[np.float64], apart_px: float, points: NDArray[np.float64]
) -> None:
    """The two brightest point sources on a segment, at least apart_px apart: rows (major, minor, S/N) of points (2, 3)."""
    n_major, n_minor = smooth.shape
    for k in range(2):
        points[k, 2] = 0.0
        for major in range(max(0, int(segment[0]) - 2), min(n_major - 1, int(segment[2]) + 3) + 1):
            if k == 1 and abs(major - points[0, 0]) < apart_px:
                continue
            centre = math.floor(minor_at(segment, float(major)) + 0.5)
            for j in range(max(0, centre - 2), min(n_minor - 1, centre + 2) + 1):
                value = smooth[major, j] / 16.0
                if value > points[k, 2]:
                    points[k, 0], points[k, 1], points[k, 2] = major, j, value


@nb.njit(cache=True)
def blank_point(
    image: NDArray[np.int8], smooth: NDArray[np.int8], blocked: NDArray[np.uint8], major: int, minor: int, radius: int
) -> None:
    """Take a point source out of both images: a disc becomes 0 and blocked (POINT_BIT). In place."""
    n_major, n_minor = image.shape
    for i in range(max(0, major - radius), min(n_major - 1, major + radius) + 1):
        for j in range(max(0, minor - radius), min(n_minor - 1, minor + radius) + 1):
            if (i - major) ** 2 + (j - minor) ** 2 <= radius * radius:
                image[i, j] = 0
                smooth[i, j] = 0
                blocked[i, j] |= POINT_BIT


@nb.njit(cache=True)
def blank_stars_on_path(
    image: NDArray[np.int8], smooth: NDArray[np.int8], blocked: NDArray[np.uint8], segment: NDArray[np.float64], limit: float
) -> int:
    """Take out points on a segment whose smoothed value exceeds `limit` sigma: unlisted stars; returns how many."""
    n_major, n_minor = smooth.shape
    found = 0
    for major in range(max(0, int(segment[0]) - 1), min(n_major - 1, int(segment[2]) + 2) + 1):
        centre = math.floor(minor_at(segment, float(major)) + 0.5)
        for j in range(max(0, centre - 2), min(n_minor - 1, centre + 2) + 1):
            value = smooth[major, j]
            if value <= limit * 16.0:
                continue
            peak = True
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    if 0 <= major + di < n_major and 0 <= j + dj < n_minor and smooth[major + di, j + dj] > value:
                        peak = False
            if peak:
                blank_point(image, smooth, blocked, major, j, 2)
                found += 1
    return found


@nb.njit(cache=True)
def profile_of(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    psf_sigma_px: float,
    segment: NDArray[np.float64],
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> int:
    """Cross profile of a segment (`cross_profile`) into `signal` and `weight`; the number of its lines."""
    major0, minor0, major1, minor1, sagitta = segment[0], segment[1], segment[2], segment[3], segment[4]
    _, n = cross_profile(
        image, blocked, level, tile_px, major0, minor0, major1, minor1, sagitta, 0, psf_sigma_px, signal, weight
    )  # fmt: skip
    return n


@nb.njit(cache=True)
def looks_like_trail(
    image: NDArray[np.int8],
    smooth: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    segment: NDArray[np.float64],
    snr: float,
    psf_sigma_px: float,
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
    points: NDArray[np.float64],
) -> bool:
    """Whether a segment is better explained by one trail than by two point sources, and evenly bright along its quarters."""
    n = profile_of(image, blocked, level, tile_px, psf_sigma_px, segment, signal, weight)
    uneven = quarters(signal, weight, n)
    brightest_points(smooth, segment, 4.7 * psf_sigma_px, points)
    two_points = points[0, 2] ** 2 + points[1, 2] ** 2
    return uneven < 16.0 + (0.3 * snr) ** 2 and snr * snr > two_points
