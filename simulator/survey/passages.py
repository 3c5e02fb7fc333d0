"""Objects that pass the field, each at an instant in it: how long they stay, how bright they are, their orbits."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simulator.platform.kepler import elements_of
from simulator.scene.encounters import expected_snr, in_field
from simulator.scene.reflection import in_sight, lambert_flux, sunlit_fraction
from simulator.scene.surface import Surfaces
from simulator.survey.flight import Flight, Instants

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LONGEST_STAY_S: Final = 1e5
"""Longest stay that is counted, for objects that stand still in the field."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Passages:
    """n objects that pass the field, each at an instant (n,) in it: positions and velocities (n, 3), GCRS.

    natural (n,) : passages of nature that each stands for. enter_s, leave_s : of the field, from the instant on.
    rate_deg_s : against the stars. snr : of the best exposure, with the trail that the camera's own turn leaves.
    """

    instant: Indices
    size_m: Array
    surfaces: Surfaces
    position_km: Array
    velocity_km_s: Array
    range_km: Array
    rate_deg_s: Array
    enter_s: Array
    leave_s: Array
    snr: Array
    natural: Array

    def taken(self, which: Indices) -> "Passages":
        """Some of them."""
        return Passages(
            **{name: getattr(self, name)[which] for name in self.__dataclass_fields__ if name != "surfaces"},
            surfaces=self.surfaces.taken(which),
        )


def make_passages(
    flight: Flight,
    at: Instants,
    instant: Indices,
    size_m: Array,
    surfaces: Surfaces,
    position_km: Array,
    velocity_km_s: Array,
    in_sight_now: Array | float = 1.0,
) -> Passages:
    """Passages of objects in the field at their instants; in_sight_now (n,) : times their stay, of nature's passages."""
    window = flight.window
    line = position_km - at.position_km[instant]
    camera, moves = at.in_camera(instant, position_km, velocity_km_s)
    range_km = np.linalg.norm(line, axis=1)
    rate_rad_s = _turn_of_line(line, velocity_km_s - at.velocity_km_s[instant])
    enter, leave = in_field(camera, moves, window)
    enter, leave = np.maximum(enter, -LONGEST_STAY_S), np.minimum(leave, LONGEST_STAY_S)
    stay = np.maximum(leave - enter, 0.0)
    flux = light_of(flight, at, instant, size_m, surfaces, position_km)
    at_noise = replace(window, noise_variance_e2=at.noise_e2[instant])  # type: ignore[arg-type]  # one for each passage
    snr = expected_snr(flux * window.flux_e_s, _turn_of_line(camera, moves), stay, range_km, at_noise)
    seen = (stay > 0.0) & (np.degrees(rate_rad_s) >= flight.options.population.slowest_deg_s)
    return Passages(
        instant=instant,
        size_m=size_m,
        surfaces=surfaces,
        position_km=position_km,
        velocity_km_s=velocity_km_s,
        range_km=range_km,
        rate_deg_s=np.degrees(rate_rad_s),
        enter_s=enter,
        leave_s=leave,
        snr=np.where(seen, snr, 0.0),
        natural=np.where(seen, in_sight_now / np.maximum(stay, 1e-9), 0.0),
    )  # fmt: skip - one line for what, one for where, one for how


def _turn_of_line(line_km: Array, moves_km_s: Array) -> Array:
    """Rates (n,), rad/s, at which the directions of lines (n, 3) turn that change by (n, 3)."""
    range_km = np.linalg.norm(line_km, axis=1)
    across = moves_km_s - np.sum(moves_km_s * line_km, axis=1, keepdims=True) * line_km / range_km[:, None] ** 2
    return np.asarray(np.linalg.norm(across, axis=1) / range_km)


def light_of(flight: Flight, at: Instants, instant: Indices, size_m: Array, surfaces: Surfaces, position_km: Array) -> Array:
    """Mean light (n,) of objects at positions, in units of a V = 0 star with the Sun's colour."""
    effects, observer, sun = flight.options.light, at.position_km[instant], at.sun_km[instant]
    flux = surfaces.albedo * surfaces.colour * size_m**2
    flux = flux * lambert_flux(
        1.0, 1.0, position_km, observer, sun, phase_function=effects.phase_function, specular=surfaces.specular
    )
    if effects.earth_shadow:
        flux = flux * sunlit_fraction(position_km, sun)
    return np.asarray(flux * in_sight(position_km, observer))


def joined(parts: list[Passages]) -> Passages:
    """Passages one after the other."""
    names = [name for name in Passages.__dataclass_fields__ if name != "surfaces"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    surfaces = {name: np.concatenate([getattr(p.surfaces, name) for p in parts]) for name in ("albedo", "specular", "colour")}
    return Passages(**columns, surfaces=Surfaces(**surfaces))


def none_of(flight: Flight, at: Instants) -> Passages:
    """No passages."""
    no, where = np.zeros(0), np.zeros((0, 3))
    surfaces = Surfaces(albedo=no, specular=no, colour=no)
    return make_passages(flight, at, np.zeros(0, np.int64), no, surfaces, where, where)


def orbits_of(p: Passages) -> tuple[Array, Array, Array]:
    """Semi-major axis (km), eccentricity and inclination (deg) of passages (n,)."""
    found = elements_of(p.position_km, p.velocity_km_s)
    return found.a_km, found.e, np.degrees(found.i_rad)
