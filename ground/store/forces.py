"""The forces under which an orbit of the store is carried on: those of its fit."""

from ground.association.clusters import AssociationOptions
from ground.determination.forces import ForceModel
from ground.store.store import StoredOrbit


def forces_of(orbit: StoredOrbit, association_degree: int = AssociationOptions.gravity_degree) -> ForceModel:
    """The forces that an orbit was fitted with.

    association_degree : gravity of fits to tracklets. These estimate radiation pressure, which tells them apart: fits to precise
    ephemerides have gravity to degree 20, and the light is in their empirical accelerations.
    """
    model = ForceModel(gravity_degree=association_degree) if "radiation" in orbit.parameters else ForceModel(gravity_degree=20)
    return model.with_values(tuple(orbit.parameters), list(orbit.parameters.values()))
