"""The forces under which an orbit of the store is carried on, those of its fit; and its covariance, carried with them."""

import numpy as np
from numpy.typing import NDArray

from ground.association.clusters import AssociationOptions
from ground.determination.forces import ForceModel, step_of
from ground.determination.propagation import propagate
from ground.store.store import StoredOrbit

Array = NDArray[np.float64]


def forces_of(orbit: StoredOrbit, association_degree: int = AssociationOptions.gravity_degree) -> ForceModel:
    """The forces that an orbit was fitted with.

    association_degree : gravity of fits to tracklets. These estimate radiation pressure, which tells them apart: fits to precise
    ephemerides have gravity to degree 20, and the light is in their empirical accelerations.
    """
    model = ForceModel(gravity_degree=association_degree) if "radiation" in orbit.parameters else ForceModel(gravity_degree=20)
    return model.with_values(tuple(orbit.parameters), list(orbit.parameters.values()))


def covariance_of(orbit: StoredOrbit, radiation_sigma_m2_kg: float = AssociationOptions.radiation_sigma_m2_kg) -> Array:
    """Covariance (6 + k, 6 + k) of state and estimated parameters.

    Where only the state has a covariance, radiation has a doubt of its own, the rest none.
    """
    if len(orbit.covariance) > 6 or not orbit.parameters:
        return orbit.covariance
    doubt = np.array([radiation_sigma_m2_kg if name == "radiation" else 1e-6 * step_of(name) for name in orbit.parameters]) ** 2
    return np.block([[orbit.covariance, np.zeros((6, len(doubt)))], [np.zeros((len(doubt), 6)), np.diag(doubt)]])


def carried(orbit: StoredOrbit, t_tai_ns: NDArray[np.int64], options: AssociationOptions | None = None) -> tuple[Array, Array]:
    """States (n, 6) at epochs (n,) and their covariances (n, 6, 6), which hold the doubt of the parameters and its correlation.

    UserError for an orbit that cannot be propagated there.
    """
    rules = options or AssociationOptions()
    arc = propagate(
        orbit.state, orbit.epoch_tai_ns, t_tai_ns, forces_of(orbit, rules.gravity_degree),
        parameters=tuple(orbit.parameters), partials=True,
    )  # fmt: skip
    covariance = covariance_of(orbit, rules.radiation_sigma_m2_kg)
    return arc.states, np.asarray(arc.partials @ covariance @ arc.partials.transpose(0, 2, 1))
