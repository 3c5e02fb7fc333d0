"""Position, velocity and attitude of the camera during one frame, at any instant of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simulator.platform.jitter import Jitter
from simulator.platform.observer import Observer
from simulator.platform.pointing import Attitude
from simulator.platform.rotation import rotation_vector_of, small_rotation, turned
from simulator.platform.shutter import FrameTiming

Array = NDArray[np.float64]

NODES = 33
"""Instants of a frame at which the orbit and the commanded attitude are evaluated; splines join them."""
_FINEST_STEP_S = 5e-4  # at 100 Hz, where default jitter ends, 20 a period: linear between them errs by 1.2 % of the amplitude
_MOST_STEPS = 4096  # bounds memory and time; frames longer than 2 s have coarser steps


@dataclass(frozen=True, kw_only=True, eq=False)
class LineOfSight:
    """The camera during one frame. Times are seconds after the epoch of the run.

    node_s : (k,) times; observer_km, velocity_km_s : (k, 3) at them.
    reference : (3, 3) GCRS to camera at `reference_s`, mid-exposure of the middle row.
    fine_s : (m,) times; turn_rad : (m, 3) rotation of the camera since the reference, jitter included.
    """

    node_s: Array
    observer_km: Array
    velocity_km_s: Array
    reference_s: float
    reference: Array
    fine_s: Array
    turn_rad: Array

    def turn_at(self, time_s: Array) -> Array:
        """Rotation vectors (n, 3) since the reference, linear between the fine steps."""
        return self._interpolated(self.turn_rad, time_s)

    def _interpolated(self, values: Array, time_s: Array) -> Array:
        """Values (m, k) of the fine steps, linear in between; times outside take the end values."""
        steps = len(self.fine_s) - 1
        at = (time_s - self.fine_s[0]) * (steps / (self.fine_s[-1] - self.fine_s[0]))
        index = np.clip(at.astype(np.intp), 0, steps - 1)
        share = np.clip(at - index, 0.0, 1.0)[:, None]
        return np.asarray(values[index] * (1.0 - share) + values[index + 1] * share)

    def to_camera(self, time_s: Array, vectors: Array) -> Array:
        """GCRS vectors (n, 3) in the camera frame, each at its own time."""
        return turned(vectors @ self.reference.T, self.turn_at(time_s))

    def to_gcrs(self, time_s: Array, vectors: Array) -> Array:
        """Camera-frame vectors (n, 3) in GCRS axes, each at its own time."""
        return np.asarray(turned(vectors, -self.turn_at(time_s)) @ self.reference)

    def observer_at(self, time_s: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 3)."""
        return CubicSpline(self.node_s, self.observer_km)(time_s), CubicSpline(self.node_s, self.velocity_km_s)(time_s)

    @property
    def middle_velocity_km_s(self) -> Array:
        """Velocity (3,) of the observer in the middle of the frame."""
        return np.asarray(self.velocity_km_s[len(self.velocity_km_s) // 2])

    def rate_rad_s(self) -> Array:
        """Angular velocity (3,) of the camera frame, in the camera frame, mean over the frame."""
        span = self.fine_s[-1] - self.fine_s[0]
        return np.asarray((self.turn_rad[-1] - self.turn_rad[0]) / span)

    def mean_turn(self, open_s: Array, close_s: Array) -> tuple[Array, Array]:
        """Mean rotation (n, 3) between pairs of times, and its variance (n, 3)."""
        moments = np.concatenate([self.turn_rad, self.turn_rad**2], axis=1)
        integral = _integral(np.diff(self.fine_s)[:, None], moments)
        mean = (self._interpolated(integral, close_s) - self._interpolated(integral, open_s)) / (close_s - open_s)[:, None]
        return mean[:, :3], np.maximum(mean[:, 3:] - mean[:, :3] ** 2, 0.0)


def _integral(step: Array, values: Array) -> Array:
    """Trapezoidal running integral of (m, k) values."""
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0)])


def line_of_sight(timing: FrameTiming, epoch_tai_ns: int, observer: Observer, commanded: Attitude, jitter: Jitter) -> LineOfSight:
    """The camera's motion during the frame of a timing."""
    margin_ns = 1000
    first, last = timing.first_open_tai_ns - margin_ns, timing.last_close_tai_ns + margin_ns
    node_ns = [first + (last - first) * k // (NODES - 1) for k in range(NODES)]
    node_s = np.array([(t - epoch_tai_ns) * 1e-9 for t in node_ns])
    states = [observer.state(t) for t in node_ns]
    reference_s = (timing.middle_tai_ns - epoch_tai_ns) * 1e-9
    middle = commanded(timing.middle_tai_ns)
    slow = rotation_vector_of(np.stack([commanded(t) for t in node_ns]) @ middle.T)
    steps = int(np.clip(np.ceil((node_s[-1] - node_s[0]) / _FINEST_STEP_S), 64, _MOST_STEPS))
    fine_s = np.linspace(node_s[0], node_s[-1], steps + 1)
    shake = jitter.rotation_vector(np.append(fine_s, reference_s))
    true_middle = small_rotation(shake[-1]) @ middle
    history = small_rotation(shake[:-1]) @ small_rotation(CubicSpline(node_s, slow)(fine_s)) @ middle
    return LineOfSight(
        node_s=node_s,
        observer_km=np.array([s[0] for s in states]),
        velocity_km_s=np.array([s[1] for s in states]),
        reference_s=reference_s,
        reference=true_middle,
        fine_s=fine_s,
        turn_rad=rotation_vector_of(history @ true_middle.T),
    )
