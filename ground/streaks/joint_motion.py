"""The common motion of a tracklet's frames: its prior, where it puts their ends, and where a fit of it begins."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.streaks.fit_record import edges_of
from ground.streaks.joint_evidence import Evidence, TrackletFrame


class AccelerationPrior(NamedTuple):
    """Prior of the change of rate, unit of `along` per s^2: even about the usual one up to the scale, an inverse cube beyond.

    The change is 2 w^2 c for an object that passes at the rate w. c is the cotangent of the angle of its relative velocity with
    the line of sight. Directions at random give c the density (1 + c^2)^(-3/2) / 2, with the same tails. But most slow objects
    of a run may lean one way, as orbits of one sense do from one place: a peak in the middle would shift each of them.
    """

    usual: float
    scale: float

    @property
    def wide(self) -> float:
        """96 % lie within it."""
        return 3.0 * self.scale

    def log_density(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log density but for a constant."""
        return np.asarray(-0.75 * np.log1p(((change - self.usual) / self.scale) ** 4))


class Motion(NamedTuple):
    """Common motion of a tracklet: posterior mean (p,) of its parameters at an epoch, and a root (p, p) of their covariance."""

    mean: NDArray[np.float64]
    root: NDArray[np.float64]
    zero_s: float

    def at(self, t_s: float) -> tuple[float, float]:
        """Place and rate at an epoch."""
        t = t_s - self.zero_s
        change = float(self.mean[2]) if len(self.mean) > 2 else 0.0
        return float(time_powers(t, len(self.mean)) @ self.mean), float(self.mean[1]) + change * t

    def sigma(self, t_s: float) -> float:
        """Error of the place at an epoch."""
        return float(np.linalg.norm(time_powers(t_s - self.zero_s, len(self.mean)) @ self.root))

    def errors(self, frame: TrackletFrame) -> NDArray[np.float64]:
        """(2, 3) errors of both ends of a frame, in the unit of `along`: their covariance is this times its transpose."""
        n = len(self.mean)
        out = np.zeros((2, 3))
        out[:, :n] = time_powers(np.array([frame.t_open_s, frame.t_close_s]) - self.zero_s, n) @ self.root
        return out


def time_powers(t_s: NDArray[np.float64] | float, n_parameters: int) -> NDArray[np.float64]:
    """(1, t, t^2 / 2) truncated to the parameters of the motion, stacked on the last axis."""
    t = np.asarray(t_s, dtype=np.float64)
    return np.stack([np.ones_like(t), t, 0.5 * t * t][:n_parameters], axis=-1)


def linear_start(
    used: list[Evidence], zero_s: float, prior: AccelerationPrior | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Weighted least squares on the fitted ends: (parameters, covariance) of the motion."""
    n = 2 if prior is None else 3
    normal, right = np.zeros((n, n)), np.zeros(n)
    if prior is not None:
        normal[2, 2] = prior.wide**-2
        right[2] = normal[2, 2] * prior.usual
    for e in used:
        f = e.frame
        basis = time_powers(np.array([f.t_open_s - zero_s, f.t_close_s - zero_s]), n)
        spread = e.precision / f.along_per_px**2
        normal += basis.T @ spread @ basis
        right += basis.T @ spread @ np.array([f.along0, f.along1])
    if np.linalg.matrix_rank(normal) < n:
        return None
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return covariance @ right, covariance


def displacements(
    frame: TrackletFrame, rows_per_px: float, motion: NDArray[np.float64], zero_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacements (m,) of both ends by a motion (m, p), px along the trail from the fitted ones.

    An end that moves by x px lies ``x * rows_per_px`` rows further on and is exposed that many line times later:
    along + along_per_px x = a(t + c x), c = rows_per_px * line_time; linear in x but for the acceleration over c x.
    """
    n = motion.shape[1]
    delay = rows_per_px * frame.line_time_s
    out = []
    for along, t_s in ((frame.along0, frame.t_open_s - zero_s), (frame.along1, frame.t_close_s - zero_s)):
        rate = motion[:, 1] + (motion[:, 2] * t_s if n == 3 else 0.0)
        out.append((motion @ time_powers(t_s, n) - along) / (frame.along_per_px - rate * delay))
    return out[0], out[1]


def seen_displacements(
    e: Evidence, motion: NDArray[np.float64], zero_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`displacements` of what the image shows: a trail that the shutter would end beyond the image's edge ends on the edge.

    A motion too slow to have reached the edge ends the trail inside, where the pixels have light.
    """
    x0, x1 = displacements(e.frame, e.rows_per_px, motion, zero_s)
    edge0, edge1 = edges_of(e.frame.fit.flags)
    return np.maximum(x0, 0.0) if edge0 else x0, np.minimum(x1, 0.0) if edge1 else x1
