"""How the camera turned during each exposure: from the attitudes of a run's frames, and from what telemetry says.

Stars give the attitude of a frame to hundredths of an arcsec, and so the mean rate between frames; telemetered rates have noise
of some tenths of an arcsec per second, which over half an exposure of 1 s puts the ends of trails off by as much. The path of
rotation vectors about a frame's attitude has the rate as its slope at that frame: of a parabola through the frames beside it.
How far the parabola through the next but one frames differs says how smooth the path is, and telemetry is weighed by how far
it is off in the run as a whole.

Between frames the camera shakes. Third differences of the attitudes, which no steady turning has, tell how far it wanders in a
second; taken as a random walk, this tells how far the slope within an exposure is off the one through frames beside it. A shake
that is over sooner than the next frame is larger than that: trails tell (`ground.link.shake`).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.sky.apparent import mid_frame_tai_ns
from ground.sky.rotation import matrix_of
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution

Array = NDArray[np.float64]

LEAST_FRAMES: Final = 5
"""Frames with a rate from their neighbours from which the error of telemetered rates is estimated."""
UNUSUAL_JUMP: Final = 5.0
"""Jump of the rate at a frame, over the median of the run, beyond which a manoeuvre began or ended there."""
LEAST_TOLD: Final = 0.1
"""Telemetered rates are believed to err by no less than this share of their distance from the neighbours'."""
MEDIAN_CHI2: Final = 0.4549
"""Median of a squared standard normal."""
LARGEST_ANGLE_RAD: Final = 0.3
"""Frames that the camera turned by more between are too far apart to tell a rate."""


class Attitude(NamedTuple):
    """What a rate needs of a frame: epoch, matrix (3, 3) of its attitude and errors (3,) in rad, and the rate told (3,), rad/s.

    solved : whether stars gave the attitude. measured : whether telemetry gave the rate. exposure_s : 0 knows no shake.
    """

    tai_ns: int
    matrix: Array
    sigma_rad: Array
    told_rad_s: Array
    solved: bool
    measured: bool
    exposure_s: float = 0.0


class Rate(NamedTuple):
    """Angular velocity in the camera frame, rad/s, and one sigma of a component across the axis; 0 where it is unknown."""

    rate_rad_s: Array
    sigma_rad_s: float


def attitude_of(header: FrameHeader, solution: FrameSolution) -> Attitude:
    """Of one frame."""
    sigma = np.sqrt(np.maximum(np.nan_to_num(np.diag(solution.covariance_rad2)), 0.0))
    return Attitude(
        tai_ns=mid_frame_tai_ns(header),
        matrix=matrix_of(np.asarray(solution.quaternion)),
        sigma_rad=sigma,
        told_rad_s=np.asarray(solution.rate_rad_s),
        solved=not solution.flags & FrameFlag.NO_SOLUTION,
        measured=header.attitude is not None,
        exposure_s=header.exposure_ns * 1e-9,
    )


class _Slope(NamedTuple):
    """A rate (3,), its errors (3,), and by how much the rate jumps at the frame (3,): 0 where it changes steadily."""

    rate_rad_s: Array
    sigma_rad_s: Array
    jump_rad_s: Array


def rates_of(frames: Sequence[Attitude]) -> list[Rate]:
    """The rate of each frame of a run, frames in order of time; what was told where neighbours say nothing."""
    slopes = [_by_neighbours(frames, k) for k in range(len(frames))]
    jumps = np.array([np.linalg.norm(s.jump_rad_s) for s in slopes if s is not None])
    usual = float(np.median(jumps)) if len(jumps) else 0.0
    found = [
        None if s is None or np.linalg.norm(s.jump_rad_s) > UNUSUAL_JUMP * usual + s.sigma_rad_s.max() else s[:2] for s in slopes
    ]
    off = [frames[k].told_rad_s - f[0] for k, f in enumerate(found) if f is not None and frames[k].measured]
    walk = walk_rad2_s(frames)
    shaken = [_shake(frames, k, walk) for k in range(len(frames))]
    # median of |normal| is 0.6745 sigma; of all three axes, which differ little
    sigma_told = float(np.median(np.abs(off)) / 0.6745) if len(off) >= LEAST_FRAMES else np.nan
    if np.isfinite(sigma_told):
        by_shake = float(np.median([s[1] for s, f in zip(shaken, found, strict=True) if f is not None]))
        # told rates are of the whole exposure, and some of the difference is what they see and neighbours do not
        sigma_told = float(np.sqrt(max(sigma_told**2 - by_shake, LEAST_TOLD**2 * sigma_told**2)))
    return [
        _weighed(frame, None if by is None else (by[0], np.sqrt(by[1] ** 2 + shake[1])), sigma_told, shake[0])
        for frame, by, shake in zip(frames, found, shaken, strict=True)
    ]


def walk_rad2_s(frames: Sequence[Attitude]) -> float:
    """Variance that an axis across the boresight gains in a second, of a random walk as rough as the attitudes; 0 if unknown.

    Attitudes are means over exposures T, P apart: a third difference has (6 P - 10 T / 3) of it, and 20 of their own.
    """
    found, own = [], []
    for k in range(1, len(frames) - 2):
        four = frames[k - 1 : k + 3]
        step_s = np.diff([f.tai_ns for f in four]) * 1e-9
        exposure_s, even = frames[k].exposure_s, np.ptp(step_s) <= 0.01 * step_s.mean()
        if not all(f.solved for f in four) or not even or not 0.0 < exposure_s < step_s.mean():
            continue
        path = np.array([_rotation_vector(frames[k].matrix @ f.matrix.T) for f in four])
        if np.abs(path).max() > LARGEST_ANGLE_RAD:
            continue
        third = (path[3] - 3.0 * path[2] + 3.0 * path[1] - path[0])[:2]
        per_walk = 6.0 * step_s.mean() - 10.0 / 3.0 * exposure_s
        found.append(third**2 / per_walk)
        own.append(20.0 * np.mean([f.sigma_rad[:2] ** 2 for f in four], axis=0) / per_walk)
    if not found:
        return 0.0
    # a manoeuvre may add to the mean no more than three sigma do
    usual = float(np.median(found)) / MEDIAN_CHI2
    return max(float(np.mean(np.minimum(found, 9.0 * usual)) - np.mean(own)), 0.0)


def _shake(frames: Sequence[Attitude], k: int, walk: float) -> tuple[float, float]:
    """Variances (rad^2/s^2) by a random walk: of the slope of frame k's exposure about its mean rate, and of this about the rate
    that frames beside it give."""
    exposure_s = frames[k].exposure_s
    beside = [j for j in (k - 1, k + 1) if 0 <= j < len(frames)]
    if exposure_s <= 0.0 or walk <= 0.0 or not beside:
        return 0.0, 0.0
    step_s = max(float(np.mean([abs(frames[j].tai_ns - frames[k].tai_ns) for j in beside])) * 1e-9, exposure_s)
    slope = (2.0 * step_s - exposure_s / 3.0) / (4.0 * step_s**2)
    return 0.2 * walk / exposure_s, walk * (slope + 1.0 / exposure_s - 1.0 / step_s)


def _weighed(frame: Attitude, by_neighbours: tuple[Array, Array] | None, sigma_told: float, variance: float) -> Rate:
    """The mean of both by their errors. variance : of the exposure's slope about its mean rate, which neither knows."""
    told_error = float(np.hypot(sigma_told, np.sqrt(variance))) if np.isfinite(sigma_told) else 0.0
    if by_neighbours is None:
        return Rate(frame.told_rad_s, told_error if frame.measured else 0.0)
    rate, sigma = by_neighbours
    if not frame.measured:
        return Rate(rate, float(np.sqrt(np.mean(sigma[:2] ** 2) + variance)))
    if not np.isfinite(sigma_told):
        return Rate(frame.told_rad_s, 0.0)
    weight = np.stack([np.full(3, max(sigma_told, 1e-12) ** -2), np.maximum(sigma, 1e-12) ** -2])
    mean = (weight[0] * frame.told_rad_s + weight[1] * rate) / weight.sum(axis=0)
    return Rate(mean, float(np.sqrt(np.mean(1.0 / weight.sum(axis=0)[:2]) + variance)))


def _by_neighbours(frames: Sequence[Attitude], k: int) -> _Slope | None:
    """Rate of frame k and its errors (3,) by the attitudes of the frames beside it; None where these do not tell."""
    n = len(frames)
    pairs = [(k - 1, k + 1), (k - 2, k + 2)] if 0 < k < n - 1 else [(k + 1, k + 2)] if k == 0 else [(k - 1, k - 2)]
    pairs = [pair for pair in pairs if all(0 <= j < n and frames[j].solved for j in pair)]
    if not frames[k].solved or not pairs or {k - 1, k + 1}.isdisjoint(pairs[0]):
        return None
    slopes = []
    for i, j in pairs:
        t1, t2 = ((frames[m].tai_ns - frames[k].tai_ns) * 1e-9 for m in (i, j))
        a, b = (_rotation_vector(frames[k].matrix @ frames[m].matrix.T) for m in (i, j))
        if t1 * t2 * (t2 - t1) == 0.0 or max(np.abs(a).max(), np.abs(b).max()) > LARGEST_ANGLE_RAD:
            return None
        by_a, by_b = t2 / (t1 * (t2 - t1)), -t1 / (t2 * (t2 - t1))
        noise = np.hypot(np.hypot(by_a * frames[i].sigma_rad, by_b * frames[j].sigma_rad), (by_a + by_b) * frames[k].sigma_rad)
        slopes.append((by_a * a + by_b * b, noise, a / t1, b / t2 - a / t1))
    rate, noise, straight, bend = slopes[0]
    # the error of a parabola grows with the square of its span: three times as much is the difference to one twice as wide
    rough = np.abs(slopes[1][0] - rate) / 3.0 if len(slopes) > 1 else np.abs(straight - rate)
    # a steady change is twice as large over twice the span, a jump the same over any
    jump = 0.5 * (2.0 * bend - slopes[1][3]) if len(slopes) > 1 else np.zeros(3)
    return _Slope(rate, np.hypot(noise, rough), jump)


def _rotation_vector(matrix: Array) -> Array:
    """Rotation vector of a rotation matrix, ``v -> v + theta x v`` to first order; angles below pi."""
    axis = 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(matrix) - 1.0)))
    return axis * (angle / sine if sine > 0.0 else 1.0)
