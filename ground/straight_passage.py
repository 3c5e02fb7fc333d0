"""Straight passages: a place and a time in which the motion of an object along its great circle is uniform.

An object that moves uniformly relative to the camera is seen in the tangent plane of a fixed direction at
x(t) = (x0 + v t) / (1 + kappa t), with kappa the range rate over the range. In the time tau = t / (1 + kappa t) that is the
straight line x0 + (v - kappa x0) tau. An error d of kappa adds the parabola -(v - kappa x0) d tau^2 and a term of d^2, but no
cubic of first order. Three numbers therefore describe the whole passage, and frames need not be cut into stretches in which a
parabola of the angle is good enough.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.link.motion import kappa_sigma
from ground.sky.sphere import ARCSEC_RAD

Array = NDArray[np.float64]

ROBUST_ITERATIONS: Final = 12
"""Steps of Cauchy weights, after which these have settled; chosen, not measured."""
LEAST_ENDS: Final = 4
"""Three numbers are fitted; one more end shows something of them."""
MOST_GROWTH: Final = 0.7
"""Largest change of the range in half the passage, relative to its middle."""


class StraightPassage(NamedTuple):
    """Middle of the passage: epoch, s, and coordinate along the path, arcsec; kappa : range rate over range there, 1/s."""

    middle_s: float
    along_arcsec: float
    kappa_per_s: float

    def place(self, along_arcsec: float) -> float:
        """Coordinate in the tangent plane of the middle, arcsec."""
        return float(np.tan((along_arcsec - self.along_arcsec) * ARCSEC_RAD)) / ARCSEC_RAD

    def stretch(self, along_arcsec: float) -> float:
        """Change of the place with the coordinate along the path."""
        return 1.0 / float(np.cos((along_arcsec - self.along_arcsec) * ARCSEC_RAD)) ** 2

    def time(self, epoch_s: float) -> float:
        """Time in which the motion is uniform, s."""
        t = epoch_s - self.middle_s
        return t / (1.0 + self.kappa_per_s * t)

    def pace(self, epoch_s: float) -> float:
        """Change of that time with the epoch."""
        return (1.0 + self.kappa_per_s * (epoch_s - self.middle_s)) ** -2

    def epoch(self, time_s: float) -> float:
        """Inverse of `time`, s."""
        return self.middle_s + time_s / (1.0 - self.kappa_per_s * time_s)

    def ahead(self, epochs_s: tuple[float, float], along_arcsec: tuple[float, float]) -> float:
        """How far (arcsec) beyond the middle of two places the motion between them is at the middle of their epochs."""
        (place0, place1), (time0, time1) = map(self.place, along_arcsec), map(self.time, epochs_s)
        share = (self.time(0.5 * sum(epochs_s)) - time0) / (time1 - time0)
        middle = 0.5 * sum(along_arcsec)
        return (place0 + share * (place1 - place0) - self.place(middle)) / self.stretch(middle)


def straight_passage(t_s: Array, along_arcsec: Array, sigma_arcsec: Array) -> StraightPassage:
    """Passage that most ends (n,) lie on: least squares with Cauchy weights and the prior of linking; kappa 0 for few ends.

    Written as x0 + v t - kappa t x = x, the motion is linear in what is looked for.
    """
    middle_s, middle = (0.5 * float(np.min(a) + np.max(a)) if len(a) else 0.0 for a in (t_s, along_arcsec))
    if len(t_s) < LEAST_ENDS:
        return StraightPassage(middle_s, middle, 0.0)
    t, x = t_s - middle_s, np.tan((along_arcsec - middle) * ARCSEC_RAD)
    half_s = float(np.abs(t).max())
    speed = float(np.ptp(x)) / max(2.0 * half_s, 1e-6)
    design = np.stack((np.ones_like(t), t, -t * x), axis=1)
    prior = np.diag([0.0, 0.0, kappa_sigma(speed) ** -2])
    weight: Array = np.ones(len(t))
    found: Array = np.zeros(3)
    for _ in range(ROBUST_ITERATIONS):
        weighted = design * (weight / (sigma_arcsec * ARCSEC_RAD) ** 2)[:, None]
        found = np.asarray(np.linalg.solve(weighted.T @ design + prior, weighted.T @ x), dtype=np.float64)
        weight = np.asarray(1.0 / (1.0 + np.square((x - design @ found) / (2.0 * sigma_arcsec * ARCSEC_RAD))))
    limit = MOST_GROWTH / max(half_s, 1e-6)
    return StraightPassage(middle_s, middle, float(np.clip(found[2], -limit, limit)))
