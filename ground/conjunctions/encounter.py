"""Two objects at closest approach, seen along their relative velocity: in that plane a collision is a matter of two numbers."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_SMALLEST_AXIS: Final = 1e-4
"""Of the hard-body radius: a position known better than this is as good as exact, and a covariance of rank one stays usable."""
_ROUNDED: Final = 1e-6
"""Tolerance for negative eigenvalues, relative to the largest one: messages round their figures."""


_POLE: Final = -0.7
"""Smallest cosine of an inclination at which equinoctial elements are used as they are."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StateEstimate:
    """A state (6,) km, km/s and its covariance (6, 6), inertial axes. name : who it is, for messages to users."""

    name: str
    state: Array
    covariance: Array

    def __post_init__(self) -> None:
        for field, shape in (("state", (6,)), ("covariance", (6, 6))):
            object.__setattr__(self, field, validate.finite_array(f"{self.name}: {field}", getattr(self, field), shape))
        refuse_unless_positive(self.covariance[:3, :3], f"{self.name}: covariance of the position")


def refuse_unless_positive(covariance: Array, what: str) -> None:
    """UserError where a covariance (k, k) is not symmetric or has a negative eigenvalue that is no rounding."""
    scale = np.sqrt(np.abs(np.diag(covariance)))
    scale = np.where(scale > 0.0, scale, 1.0)
    correlation = covariance / np.outer(scale, scale)
    if np.abs(correlation - correlation.T).max() > _ROUNDED:
        raise UserError(f"{what}: not symmetric")
    value = np.linalg.eigvalsh(0.5 * (correlation + correlation.T))
    if value[0] < -_ROUNDED * max(value[-1], 1.0):
        raise UserError(f"{what}: not positive, smallest eigenvalue {value[0]:.2g} of the scaled matrix; expected 0 or more")


@dataclass(frozen=True, kw_only=True, eq=False)
class Encounter:
    """The second object as the first sees it at closest approach.

    tca_s : closest approach after the epoch of the states, on straight lines. relative : (6,) second minus first there.
    axes : (3, 3) rows: along the miss, across it in the plane, along the relative velocity. miss_km : (2,) in the plane.
    covariance_km2 : (2, 2) of both positions together in the plane, the objects taken as independent.
    """

    tca_s: float
    relative: Array
    axes: Array
    miss_km: Array
    covariance_km2: Array
    hard_body_km: float

    @property
    def speed_km_s(self) -> float:
        """Of the second object relative to the first."""
        return float(np.linalg.norm(self.relative[3:]))


def encounter_of(first: StateEstimate, second: StateEstimate, hard_body_km: float) -> Encounter:
    """The encounter plane of two states at one epoch near their closest approach. UserError without a relative motion."""
    if not (np.isfinite(hard_body_km) and hard_body_km > 0.0):
        raise UserError(f"hard-body radius: expected more than 0 km, got {hard_body_km:g}")
    relative = second.state - first.state
    speed = float(np.linalg.norm(relative[3:]))
    if speed == 0.0:
        raise UserError(f"{first.name} and {second.name}: no relative velocity, hence no closest approach")
    tca_s = -float(relative[:3] @ relative[3:]) / speed**2
    relative = np.concatenate([relative[:3] + tca_s * relative[3:], relative[3:]])
    along = relative[3:] / speed
    distance = float(np.linalg.norm(relative[:3]))
    towards = relative[:3] / distance if distance > 1e-9 else np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    towards = towards - (towards @ along) * along
    towards /= np.linalg.norm(towards)
    axes = np.array([towards, np.cross(along, towards), along])
    plane = axes[:2]
    together = plane @ (first.covariance[:3, :3] + second.covariance[:3, :3]) @ plane.T
    value, vector = np.linalg.eigh(together)
    value = np.maximum(value, (_SMALLEST_AXIS * hard_body_km) ** 2)
    return Encounter(
        tca_s=tca_s,
        relative=relative,
        axes=axes,
        miss_km=plane @ relative[:3],
        covariance_km2=(vector * value) @ vector.T,
        hard_body_km=float(hard_body_km),
    )


def regular(first: StateEstimate, second: StateEstimate) -> tuple[StateEstimate, StateEstimate]:
    """The same two estimates in axes, turned for both if need be, in which neither orbit is near an inclination of 180 deg."""
    momenta = [np.cross(e.state[:3], e.state[3:]) for e in (first, second)]
    poles = np.array([m / max(float(np.linalg.norm(m)), 1e-12) for m in momenta])
    cycle = np.roll(np.eye(3), 1, axis=0)
    flip = np.diag([1.0, -1.0, -1.0])
    turns = [np.eye(3), flip, cycle, flip @ cycle, cycle @ cycle, flip @ cycle @ cycle]
    best = next((t for t in turns if (poles @ t[2]).min() > _POLE), max(turns, key=lambda t: float((poles @ t[2]).min())))
    if np.array_equal(best, np.eye(3)):
        return first, second
    both = np.kron(np.eye(2), best)
    one, two = (
        StateEstimate(name=e.name, state=both @ e.state, covariance=both @ e.covariance @ both.T) for e in (first, second)
    )
    return one, two
