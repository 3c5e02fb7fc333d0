"""What orbits are fitted to: positions, ranges and directions, each with its prediction from states and its partials.

A kind gives whitened residuals, observed minus computed over one sigma, and their derivatives with respect to the state at the
epoch of the measurement. Light time is a Taylor step from that epoch (second order: 4 mm of acceleration for a GPS range).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import LIGHT_KM_S, MU_KM3_S2
from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]


class Measurements(Protocol):
    """A set of measurements of one kind: epochs (n,) TAI ns, and residuals (n, m) with partials (n, m, 6) from states (n, 6)."""

    @property
    def t_tai_ns(self) -> NDArray[np.int64]: ...  # noqa: D102 - the class says it

    def residuals(self, states: Array) -> tuple[Array, Array]: ...  # noqa: D102 - the class says it


def _positive(name: str, sigma: Array) -> None:
    if not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
        raise UserError(f"{name}: sigma: expected finite numbers above 0")


@dataclass(frozen=True, kw_only=True, eq=False)
class Positions:
    """Places (n, 3) km, GCRS axes, with one sigma (n,) km for each axis."""

    t_tai_ns: NDArray[np.int64]
    position_km: Array
    sigma_km: Array

    def __post_init__(self) -> None:
        validate.finite_array("positions.position_km", self.position_km, (len(self.t_tai_ns), 3))
        _positive("positions", self.sigma_km)

    def residuals(self, states: Array) -> tuple[Array, Array]:
        """Residuals (n, 3) and partials (n, 3, 6)."""
        scale = 1.0 / self.sigma_km[:, None]
        partials = np.zeros((len(states), 3, 6))
        partials[:, :, :3] = -scale[:, :, None] * np.eye(3)
        return (self.position_km - states[:, :3]) * scale, partials


@dataclass(frozen=True, kw_only=True, eq=False)
class Ranges:
    """Distances (n,) km from places (n, 3) km, GCRS, at the epoch at which light met the object; one sigma (n,) km."""

    t_tai_ns: NDArray[np.int64]
    station_km: Array
    range_km: Array
    sigma_km: Array

    def __post_init__(self) -> None:
        validate.finite_array("ranges.station_km", self.station_km, (len(self.t_tai_ns), 3))
        validate.finite_array("ranges.range_km", self.range_km, (len(self.t_tai_ns),))
        _positive("ranges", self.sigma_km)

    def residuals(self, states: Array) -> tuple[Array, Array]:
        """Residuals (n, 1) and partials (n, 1, 6)."""
        line = states[:, :3] - self.station_km
        rho = np.linalg.norm(line, axis=1)
        partials = np.zeros((len(states), 1, 6))
        partials[:, 0, :3] = -line / (rho * self.sigma_km)[:, None]
        return ((self.range_km - rho) / self.sigma_km)[:, None], partials


@dataclass(frozen=True, kw_only=True, eq=False)
class Directions:
    """Directions (n, 3), unit vectors, GCRS axes, of light received at the epochs by observers at places (n, 3) km.

    As tracklets are published: aberration by the observer's geocentric velocity removed, light time not. covariance_rad2 :
    (n, 2, 2) in the tangent plane along `axes` (n, 2, 3).
    """

    t_tai_ns: NDArray[np.int64]
    observer_km: Array
    direction: Array
    axes: Array
    covariance_rad2: Array

    def __post_init__(self) -> None:
        n = len(self.t_tai_ns)
        for name, shape in (("observer_km", (n, 3)), ("direction", (n, 3)), ("axes", (n, 2, 3)), ("covariance_rad2", (n, 2, 2))):
            validate.finite_array(f"directions.{name}", getattr(self, name), shape)
        if n and float(np.linalg.eigvalsh(self.covariance_rad2).min()) <= 0.0:
            raise UserError("directions: covariance_rad2: not positive")

    def residuals(self, states: Array) -> tuple[Array, Array]:
        """Residuals (n, 2) and partials (n, 2, 6)."""
        line, rho, delay = retarded(states, self.observer_km)
        unit = line / rho[:, None]
        whiten = np.linalg.inv(np.linalg.cholesky(self.covariance_rad2))
        away = np.einsum("nij,nj->ni", self.axes, unit - self.direction)
        # d(unit) = (1 - u u') dr / rho; the state's velocity moves the place where light left by -delay
        across = (self.axes - np.einsum("nij,nj->ni", self.axes, unit)[:, :, None] * unit[:, None, :]) / rho[:, None, None]
        partials = np.concatenate([across, -delay[:, None, None] * across], axis=2)
        return -np.einsum("nij,nj->ni", whiten, away), -np.einsum("nij,njk->nik", whiten, partials)


@dataclass(frozen=True, kw_only=True, eq=False)
class Offset:
    """Measurements that all share unknown offsets, which are estimated with the orbit and eliminated.

    kind : the measurements. unit : (m,) one sigma of each of the m numbers of a measurement; each has an offset of its own. A fit
    of the orbit alone then gives the orbit and the covariance that a fit of both would (with equal weights).
    """

    kind: Measurements
    unit: tuple[float, ...]

    @property
    def t_tai_ns(self) -> NDArray[np.int64]:
        """Epochs (n,) TAI ns."""
        return self.kind.t_tai_ns

    def residuals(self, states: Array) -> tuple[Array, Array]:
        """Residuals (n, m) and partials (n, m, 6) without offsets."""
        return self.kind.residuals(states)

    def eliminated(self, value: Array, partials: Array) -> tuple[Array, Array]:
        """Residuals (n, m) and partials (n, m, k) by the unknowns of a fit, both with the best offsets."""
        return value - value.mean(axis=0), partials - partials.mean(axis=0)

    def offsets(self, states: Array) -> Array:
        """The offsets (m,), observed minus computed, in the measurements' own units."""
        value, _ = self.kind.residuals(states)
        return np.asarray(value.mean(axis=0) * np.array(self.unit))


def retarded(states: Array, observer_km: Array) -> tuple[Array, Array, Array]:
    """Lines (n, 3) km from observers to where light that arrives at the states' epochs had left, their lengths and delays s."""
    r, v = states[:, :3], states[:, 3:]
    gravity = -MU_KM3_S2 * r / np.linalg.norm(r, axis=1, keepdims=True) ** 3
    delay = np.linalg.norm(r - observer_km, axis=1) / LIGHT_KM_S
    for _ in range(3):
        line = r - v * delay[:, None] + 0.5 * gravity * (delay**2)[:, None] - observer_km
        delay = np.linalg.norm(line, axis=1) / LIGHT_KM_S
    return line, np.linalg.norm(line, axis=1), delay
