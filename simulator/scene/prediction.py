"""Measurement prediction: which objects of a large catalogue cross the field during a window of time.

States every few seconds are joined by straight lines relative to the camera; what such a line, widened by the neglected
acceleration and by the camera's turn, brings into the field is looked at again in fine steps. 26,000 objects over a minute
take seconds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simulator.optics.projection import Projection
from simulator.platform.observer import Observer
from simulator.platform.pointing import Attitude
from simulator.scene.satellites import Satellite, propagate

Array = NDArray[np.float64]

STEP_S = 4.0  # of the look at who may cross; half of it bends a path by 0.04 km, which `may_cross` allows
FINE_STEPS = 129  # least instants of the look at a crossing; runs longer than 2.6 s have one every 0.02 s
_LARGEST_ACCELERATION_KM_S2 = 0.02
"""Of one object against another: twice the gravity at the ground."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Watch:
    """A camera with a field of `shape` pixels between two times (s after the epoch); it sees objects out to `farthest_km`."""

    observer: Observer
    attitude: Attitude
    projection: Projection
    shape: tuple[int, int]
    epoch_tai_ns: int
    from_s: float
    to_s: float
    farthest_km: float = 1e6


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """A satellite in the field from `enter_s` to `leave_s` after the epoch; range and rate in the middle of it."""

    satellite: Satellite
    enter_s: float
    leave_s: float
    range_km: float
    rate_deg_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """Crossings, and the names of satellites that SGP4 refused with its error code."""

    crossings: list[Crossing]
    refused: dict[str, int]


def predict_crossings(satellites: list[Satellite], watch: Watch) -> Prediction:
    """Satellites that cross a watched field, lit or not."""
    epoch_tai_ns, duration_s = watch.epoch_tai_ns, watch.to_s - watch.from_s
    n = max(int(np.ceil(duration_s / STEP_S)), 1)
    half_s = 0.5 * duration_s / n
    time_s = np.asarray(watch.from_s + half_s * (2.0 * np.arange(n) + 1.0), dtype=np.float64)
    position, velocity, error = propagate(satellites, epoch_tai_ns, time_s)
    bad = error.any(axis=1)
    refused = {satellites[k].name: int(error[k].max()) for k in np.flatnonzero(bad)}
    # about the boresight, as wide as a window off it needs
    axis = watch.projection.center_row, watch.projection.center_col
    half_row, half_col = (
        (0.5 * side + abs(0.5 * (side - 1) - middle)) / watch.projection.focal_px * 1.02
        for side, middle in zip(watch.shape, axis, strict=True)
    )
    possible = np.zeros(len(satellites), dtype=bool)
    for k, t in enumerate(time_s):
        now = epoch_tai_ns + round(t * 1e9)
        here, motion = watch.observer.state(now)
        frame = watch.attitude(now)
        turn = _turn_rad(frame, watch.attitude(now + round(half_s * 1e9)))
        camera = (position[:, k] - here) @ frame.T
        rate = (velocity[:, k] - motion) @ frame.T
        possible |= may_cross(camera, rate, half_s, half_row, half_col, turn)
    possible &= ~bad
    crossings = []
    candidates = [satellites[k] for k in np.flatnonzero(possible)]
    for satellite in candidates:
        crossings.extend(_crossings_of(satellite, watch))
    return Prediction(crossings=crossings, refused=refused)


def _turn_rad(before: Array, after: Array) -> float:
    """Angle between two attitudes."""
    return float(np.arccos(np.clip(0.5 * (np.trace(after @ before.T) - 1.0), -1.0, 1.0)))


def may_cross(
    camera_km: Array, rate_km_s: Array, half_s: float, half_row: float, half_col: float, turn_rad: float
) -> NDArray[np.bool_]:
    """Whether straight motion within +-half_s brings points (m, 3) into the widened field."""
    error_km = 0.5 * _LARGEST_ACCELERATION_KM_S2 * half_s**2
    earliest = np.full(len(camera_km), -half_s)
    latest = np.full(len(camera_km), half_s)
    for axis, half in ((0, half_col), (1, half_row)):
        wide = np.tan(min(np.arctan(half) + turn_rad, 1.5))
        for sign in (1.0, -1.0):
            inside = wide * camera_km[:, 2] + sign * camera_km[:, axis] + error_km * (1.0 + wide)
            slope = wide * rate_km_s[:, 2] + sign * rate_km_s[:, axis]
            with np.errstate(divide="ignore", invalid="ignore"):
                root = -inside / slope
            latest = np.where(slope < 0.0, np.minimum(latest, root), latest)
            earliest = np.where(slope > 0.0, np.maximum(earliest, root), earliest)
            latest = np.where((slope == 0.0) & (inside < 0.0), -np.inf, latest)
    return np.asarray(latest >= earliest)


def _crossings_of(satellite: Satellite, watch: Watch) -> list[Crossing]:
    """Crossings of one satellite, their ends good to a fine step."""
    epoch_tai_ns, shape, from_s, to_s = watch.epoch_tai_ns, watch.shape, watch.from_s, watch.to_s
    n = max(FINE_STEPS, int((to_s - from_s) / 0.02) + 1)
    time_s = np.linspace(from_s, to_s, n)
    position, _, _ = propagate([satellite], epoch_tai_ns, time_s)
    coarse = np.linspace(from_s, to_s, max(int((to_s - from_s) / 1.0) + 2, 9))
    states = [watch.observer.state(epoch_tai_ns + round(t * 1e9))[0] for t in coarse]
    vector = position[0] - CubicSpline(coarse, np.array(states))(time_s)
    frames = CubicSpline(coarse, np.array([watch.attitude(epoch_tai_ns + round(t * 1e9)) for t in coarse]))(time_s)
    camera = np.einsum("nij,nj->ni", frames, vector)
    row, col = watch.projection.to_pixels(camera)
    distance = np.linalg.norm(vector, axis=1)
    inside = (row > -0.5) & (row < shape[0] - 0.5) & (col > -0.5) & (col < shape[1] - 0.5) & (distance < watch.farthest_km)
    change = np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8))
    found = []
    for first, beyond in zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1), strict=True):
        middle = min((int(first) + int(beyond)) // 2, n - 2)
        a, b = vector[middle] / distance[middle], vector[middle + 1] / distance[middle + 1]
        rate = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b) / (time_s[1] - time_s[0])
        found.append(
            Crossing(
                satellite=satellite,
                enter_s=float(time_s[first]),
                leave_s=float(time_s[beyond - 1]),
                range_km=float(distance[middle]),
                rate_deg_s=float(np.degrees(rate)),
            )
        )
    return found
