"""Motion of the stars of a frame during its exposure: one shift, or a turn about some point, from their trails alone.

The camera follows something else, or rolls. A rigid motion gives each star the vector (a - w x, b + w y) at (y, x) = (row, col)
from the middle of the frame. Two trails fix a, b and w; those that most trails agree with are refined on fitted trails.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.signals import StarMotion

COMPONENT_SHARE: Final = 0.35
"""A trail consists of connected pixels that are brighter than this share of its bright pixel."""

MOST_COMPONENTS: Final = 150  # of the brightest peaks; `VOTING` of them are combined. A budget of work, not measured
MOST_PIXELS: Final = 4_000  # room of a set: the longest trail, 100 px, 40 px wide
LEAST_PX: Final = 3.0
"""Least length of pieces that are used for the motion."""

VOTE_WORK: Final = 6_000_000
"""Operations of `first_motion`: the pixel sets, and all pairs held against all trails."""

VOTING: Final = 40
"""Brightest trails that are combined in pairs."""

AGREE_PX: Final = 1.5  # error of a vector from a set of pixels, however short. Chosen, not measured
AGREE_SHARE: Final = 0.1
"""A trail agrees with a motion when its vector is as near as this, plus this share of its length."""

LEAST_COMMON: Final = 4
"""Least number of stars with the same motion. One streak across a frame without stars is not a motion of stars."""

LEAST_SHARE: Final = 0.4
"""Least share of the trails with the same motion. Particle tracks and pieces of blends have all directions."""


@njit(cache=True)
def trail_components(
    residual: NDArray[np.float32], peaks: NDArray[np.float32], seen: NDArray[np.uint8], out: NDArray[np.float64]
) -> int:
    """Pixel sets around bright peaks (n, >= 2: row, col), brightest first: rows (row, col, rr, rc, cc) of `out`; how many.

    Those that touch the edge or are too large are left out. seen : zeros of the image's shape, used up.
    """
    rows, cols = residual.shape
    stack = np.empty((MOST_PIXELS, 2), np.int32)
    count = 0
    for k in range(peaks.shape[0]):
        if count == out.shape[0]:
            break
        i, j = int(peaks[k, 0]), int(peaks[k, 1])
        if seen[i, j]:
            continue
        limit = COMPONENT_SHARE * residual[i, j]
        stack[0, 0], stack[0, 1] = i, j
        seen[i, j] = 1
        n, top, whole = 1, 1, limit > 0.0
        sum_r = sum_c = sum_rr = sum_rc = sum_cc = 0.0
        while top > 0 and whole:
            top -= 1
            r, c = stack[top, 0], stack[top, 1]
            y, x = float(r - i), float(c - j)
            sum_r, sum_c = sum_r + y, sum_c + x
            sum_rr, sum_rc, sum_cc = sum_rr + y * y, sum_rc + y * x, sum_cc + x * x
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    a, b = r + dr, c + dc
                    if a < 0 or b < 0 or a >= rows or b >= cols or n >= MOST_PIXELS - 9:
                        whole = False
                    elif seen[a, b] == 0 and residual[a, b] > limit:
                        seen[a, b] = 1
                        stack[top, 0], stack[top, 1] = a, b
                        top += 1
                        n += 1
        if whole and n >= 4:
            y, x = sum_r / n, sum_c / n
            out[count, 0], out[count, 1] = i + y, j + x
            out[count, 2] = sum_rr / n - y * y
            out[count, 3] = sum_rc / n - y * x
            out[count, 4] = sum_cc / n - x * x
            count += 1
    return count


def vectors_of(components: NDArray[np.float64], psf_sigma_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (m, 2) and vectors (m, 2) of the components that are trails; the sign of a vector is not known."""
    rr, rc, cc = components[:, 2:].T
    half, apart = 0.5 * (rr + cc), np.hypot(0.5 * (rr - cc), rc)
    angle = 0.5 * np.arctan2(2.0 * rc, cc - rr)  # of the long axis, from growing col to growing row
    length = np.sqrt(12.0 * np.maximum(half + apart, 0.0)) - psf_sigma_px
    trail = (length > LEAST_PX) & (half + apart > 3.0 * (half - apart))
    vectors = length[:, None] * np.column_stack((np.sin(angle), np.cos(angle)))
    return components[trail, :2], vectors[trail]


def _agreement(
    places: NDArray[np.float64], vectors: NDArray[np.float64], motions: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which trails (m) agree with which motions (h, 3: a, b, w), shape (h, m); and the sign that they have then."""
    a, b, w = (motions[:, k, None] for k in range(3))
    d_row, d_col = a - w * places[:, 1], b + w * places[:, 0]
    sign = np.where(d_row * vectors[:, 0] + d_col * vectors[:, 1] >= 0.0, 1.0, -1.0)
    apart = np.hypot(sign * vectors[:, 0] - d_row, sign * vectors[:, 1] - d_col)
    return apart < AGREE_PX + AGREE_SHARE * np.hypot(d_row, d_col), sign


def _solved(places: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares motions (..., 3) of trails (..., n, 2) at places (..., n, 2)."""
    at, mean = places.mean(axis=-2, keepdims=True), vectors.mean(axis=-2, keepdims=True)
    p, v = places - at, vectors - mean
    power = np.maximum(np.sum(p * p, axis=(-2, -1)), 1e-9)
    turn = np.sum(v[..., 1] * p[..., 0] - v[..., 0] * p[..., 1], axis=-1) / power
    return np.stack((mean[..., 0, 0] + turn * at[..., 0, 1], mean[..., 0, 1] - turn * at[..., 0, 0], turn), axis=-1)


def common_motion(places: NDArray[np.float64], vectors: NDArray[np.float64], middle: tuple[float, float]) -> StarMotion | None:
    """The rigid motion that most trails (m, 2), brightest first, agree with; None when too few do."""
    if len(places) < LEAST_COMMON:
        return None
    places = places - np.array(middle)
    first, second = np.triu_indices(min(len(places), VOTING), 1)
    at = places[np.stack((first, second), 1)]
    motions = np.concatenate([_solved(at, np.stack((vectors[first], k * vectors[second]), 1)) for k in (1.0, -1.0)])
    agree, _ = _agreement(places, vectors, motions)
    best = motions[int(np.argmax(agree.sum(axis=1)))]
    for _ in range(4):
        agree, sign = _agreement(places, vectors, best[None])
        if agree.sum() < max(LEAST_COMMON, LEAST_SHARE * len(places)):
            return None
        best = _solved(places[agree[0]], sign[0, agree[0], None] * vectors[agree[0]])
    return motion_of(best, middle)


def motion_of(motion: NDArray[np.float64], middle: tuple[float, float]) -> StarMotion:
    """A motion (a, b, w) as a record."""
    return StarMotion(
        drow=float(motion[0]), dcol=float(motion[1]), turn_rad=float(motion[2]), middle_row=middle[0], middle_col=middle[1]
    )


def longest_px(motion: StarMotion) -> float:
    """Longest trail in the frame."""
    row, col = 2.0 * motion.middle_row * np.array([0.0, 0.0, 1.0, 1.0]), 2.0 * motion.middle_col * np.array([0.0, 1.0, 0.0, 1.0])
    return float(np.hypot(*motion.at(row, col)).max())


def first_motion(
    residual: NDArray[np.float32], peaks: NDArray[np.float32], psf_sigma_px: float
) -> tuple[StarMotion | None, NDArray[np.float64]]:
    """The stars' motion from pixel sets around bright peaks (n, >= 2), brightest first; and places (m, 2) of trails with it."""
    out = np.empty((MOST_COMPONENTS, 5))
    n = trail_components(residual, peaks, np.zeros(residual.shape, np.uint8), out)
    places, vectors = vectors_of(out[:n], psf_sigma_px)
    middle = (0.5 * (residual.shape[0] - 1), 0.5 * (residual.shape[1] - 1))
    motion = common_motion(places, vectors, middle)
    if motion is None:
        return None, np.zeros((0, 2))
    agree, _ = _agreement(places - np.array(middle), vectors, np.array([[motion.drow, motion.dcol, motion.turn_rad]]))
    return motion, places[agree[0]]


def refined_motion(places: NDArray[np.float64], vectors: NDArray[np.float64], motion: StarMotion) -> StarMotion | None:
    """The motion again, by least squares from fitted trails (m, 2) of any sign; None when fewer than `LEAST_COMMON` agree."""
    if len(places) < LEAST_COMMON:
        return None
    middle = (motion.middle_row, motion.middle_col)
    places = places - np.array(middle)
    best = np.array([motion.drow, motion.dcol, motion.turn_rad])
    for _ in range(4):
        agree, sign = _agreement(places, vectors, best[None])
        use = agree[0]
        if np.count_nonzero(use) < max(LEAST_COMMON, 0.5 * len(places)):
            return None
        best = _solved(places[use], sign[0, use, None] * vectors[use])
        if abs(best[2]) * math.hypot(*middle) < 0.3:
            best = np.array([*np.median(sign[0, use, None] * vectors[use], axis=0), 0.0])
    return motion_of(best, middle)
