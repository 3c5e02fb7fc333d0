"""The forces under which an orbit of the store is carried on, those of its fit; and its covariance, carried with them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.clusters import AssociationOptions
from ground.determination.forces import ForceModel, step_of
from ground.determination.impulses import PUSH_KM2_S3
from ground.determination.perigee import piece_ns
from ground.determination.propagation import Flight
from ground.store.store import StoredOrbit

Array = NDArray[np.float64]

PIECES_PER_ORBIT: Final = 8
"""Of the integral of process noise, counted at perigee: its sigmas err by 1e-4 in circular orbits, by 1e-3 at an eccentricity of
0.73."""
PRECISE_PUSH_KM2_S3: Final = 5e-21
"""Power density of what five empirical accelerations leave out. Half a day of 40 GPS and Galileo orbits was fitted (GFZ's day):
in the other half squared errors are 0.9 to 1.2 of their variance with it, 7 to 10 without, 0.007 with `PUSH_KM2_S3`."""


def forces_of(orbit: StoredOrbit, association_degree: int = AssociationOptions.gravity_degree) -> ForceModel:
    """The forces that an orbit was fitted with.

    association_degree : gravity of fits to tracklets. These estimate radiation pressure, which tells them apart: fits to precise
    ephemerides have gravity to degree 20, and the light is in their empirical accelerations.
    """
    model = ForceModel(gravity_degree=association_degree) if "radiation" in orbit.parameters else ForceModel(gravity_degree=20)
    return model.with_values(tuple(orbit.parameters), list(orbit.parameters.values()))


def push_of(orbit: StoredOrbit) -> float:
    """Power density, km^2/s^3 along each axis, of the accelerations that the forces of an orbit's fit leave out."""
    return PRECISE_PUSH_KM2_S3 if "sun" in orbit.parameters else PUSH_KM2_S3


def noise_of(orbit: StoredOrbit, flight: Flight, t_tai_ns: NDArray[np.int64]) -> Array:
    """Covariances (n, 6, 6) that these accelerations add from the orbit's epoch to epochs (n,) of its flight."""
    return flight.noise(t_tai_ns, push_of(orbit), piece_ns(orbit.state, PIECES_PER_ORBIT))


def covariance_of(orbit: StoredOrbit, radiation_sigma_m2_kg: float = AssociationOptions.radiation_sigma_m2_kg) -> Array:
    """Covariance (6 + k, 6 + k) of state and estimated parameters.

    Where only the state has a covariance, radiation has a doubt of its own, the rest none.
    """
    if len(orbit.covariance) > 6 or not orbit.parameters:
        return orbit.covariance
    doubt = np.array([radiation_sigma_m2_kg if name == "radiation" else 1e-6 * step_of(name) for name in orbit.parameters]) ** 2
    return np.block([[orbit.covariance, np.zeros((6, len(doubt)))], [np.zeros((len(doubt), 6)), np.diag(doubt)]])


def carried(orbit: StoredOrbit, t_tai_ns: NDArray[np.int64], options: AssociationOptions | None = None) -> tuple[Array, Array]:
    """States (n, 6) at epochs (n,) and their covariances (n, 6, 6).

    They hold the doubt of the parameters with its correlation, and the noise of what the forces leave out. UserError for an orbit
    that cannot be propagated there.
    """
    rules = options or AssociationOptions()
    t = np.asarray(t_tai_ns, dtype=np.int64)
    span = min(int(t.min()), orbit.epoch_tai_ns), max(int(t.max()), orbit.epoch_tai_ns)
    forces = forces_of(orbit, rules.gravity_degree)
    flight = Flight(orbit.state, orbit.epoch_tai_ns, *span, forces, tuple(orbit.parameters))
    arc = flight.at(t)
    covariance = covariance_of(orbit, rules.radiation_sigma_m2_kg)
    return arc.states, arc.partials @ covariance @ arc.partials.transpose(0, 2, 1) + noise_of(orbit, flight, t)
