"""Moving objects: what each is, where it is, and how bright it is as seen from the camera."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.platform.earth import LIGHT_KM_S
from simulator.platform.kepler import Elements, state_of
from simulator.platform.orbit_motion import OrbitMotion
from simulator.scene.light import LightOptions
from simulator.scene.reflection import STEADY, LightCurve, in_sight, lambert_flux, sunlit_fraction

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """An object at n times. vector_km : (n, 3) published direction times range (GCRS axes, light time not removed).

    flux : (n,) in units of a V = 0 star, the Earth's shadow included, the light curve not.
    """

    vector_km: Array
    flux: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Identity:
    """What the truth says of an object; orbit elements are NaN where there is no orbit."""

    name: str
    kind: str
    size_m: float = np.nan
    albedo: float = np.nan
    weight: float = 1.0
    a_km: float = np.nan
    e: float = np.nan
    i_deg: float = np.nan


class SkyObject(Protocol):
    """An object with directions."""

    @property
    def identity(self) -> Identity:
        """Its truth."""
        ...

    @property
    def light_curve(self) -> LightCurve:
        """Its variation."""
        ...

    @property
    def from_s(self) -> float:
        """When it comes into being, seconds after the epoch of the run."""
        ...

    @property
    def to_s(self) -> float:
        """When it ceases to be."""
        ...

    def seen(self, time_s: Array, observer_km: Array, sun_km: Array, effects: LightOptions) -> Seen:
        """At times (n,) after the epoch of the run, from observer positions (n, 3)."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class OrbitingObject:
    """A sphere whose geocentric positions (n, 3) km a function of time gives.

    specular : share of its light that a mirror-like sphere would return, the rest is Lambert's. colour : electrons over those of
    sunlight of the same V. from_s, to_s : when it is there; positions are asked for at other times too.
    """

    identity: Identity
    positions_km: Callable[[Array], Array]
    light_curve: LightCurve = STEADY
    specular: float = 0.0
    colour: float = 1.0
    from_s: float = -np.inf
    to_s: float = np.inf

    def seen(self, time_s: Array, observer_km: Array, sun_km: Array, effects: LightOptions) -> Seen:
        """Light left the object ``range / c`` earlier; two rounds leave (v/c)^2 of the light time, below 1 mm."""
        position = self.positions_km(time_s)
        for _ in range(2 if effects.light_time else 0):
            delay_s = np.linalg.norm(position - observer_km, axis=-1) / LIGHT_KM_S
            position = self.positions_km(time_s - delay_s)
        size_m, albedo = self.identity.size_m, self.identity.albedo
        flux = self.colour * lambert_flux(
            size_m, albedo, position, observer_km, sun_km, phase_function=effects.phase_function, specular=self.specular
        )
        if effects.earth_shadow:
            flux = flux * sunlit_fraction(position, sun_km)
        return Seen(vector_km=position - observer_km, flux=flux * in_sight(position, observer_km))


@dataclass(frozen=True, kw_only=True, eq=False)
class SkyPathObject:
    """An object that follows a great circle at a constant rate, with a given magnitude and range."""

    identity: Identity
    start: Array
    """(3,) published direction at the epoch."""
    rate_rad_s: Array
    """(3,) velocity of the unit direction at the epoch, perpendicular to it."""
    range_km: float
    v_mag: float
    brightening_per_s: float = 0.0
    light_curve: LightCurve = STEADY
    from_s: float = -np.inf
    to_s: float = np.inf

    def seen(self, time_s: Array, observer_km: Array, sun_km: Array, effects: LightOptions) -> Seen:
        """Neither observer nor Sun nor the light's way matter: the path is given."""
        speed = float(np.linalg.norm(self.rate_rad_s))
        along = self.rate_rad_s / speed if speed > 0.0 else np.zeros(3)
        angle = speed * np.asarray(time_s)[:, None]
        direction = np.cos(angle) * self.start + np.sin(angle) * along
        return Seen(
            vector_km=self.range_km * direction,
            flux=10.0 ** (-0.4 * self.v_mag) * np.exp(self.brightening_per_s * np.asarray(time_s)),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelPathObject:
    """A point that moves over the detector as told, in delivered pixels.

    A bend is what a constant acceleration adds in the first second.

    restart : time counts from the opening of each frame's first row instead of from the epoch. from_middle_row : it counts from
    the opening of the middle row, so that a global and a rolling shutter see that row alike.
    """

    identity: Identity
    row_px: float
    col_px: float
    row_rate_px_s: float
    col_rate_px_s: float
    row_bend_px: float
    col_bend_px: float
    v_mag: float
    brightening_per_s: float
    restart: bool
    from_middle_row: bool = False
    light_curve: LightCurve = STEADY

    def place(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Row, col and flux (units of a V = 0 star) at times."""
        row = self.row_px + self.row_rate_px_s * time_s + self.row_bend_px * time_s**2
        col = self.col_px + self.col_rate_px_s * time_s + self.col_bend_px * time_s**2
        return row, col, 10.0 ** (-0.4 * self.v_mag) * np.exp(self.brightening_per_s * time_s)


def orbit_positions(elements: Elements) -> Callable[[Array], Array]:
    """Positions of the orbit whose osculating elements hold at time 0."""
    motion = OrbitMotion(*state_of(elements))
    return lambda time_s: motion.states(time_s)[0]
