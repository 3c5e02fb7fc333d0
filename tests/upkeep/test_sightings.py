"""Tracklets of an orbit itself are candidates, wherever on the orbit they were taken."""

import math

import numpy as np
import pytest

pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

from ground.determination.forces import ForceModel
from ground.determination.measurements import Directions, retarded
from ground.determination.propagation import propagate
from ground.orbit.dynamics import MU_KM3_S2
from ground.store.store import StoredOrbit
from ground.upkeep.sightings import KnownOrbit, sightings

T0 = 2_150_000_000_000_000_000
EARTH_KM = 6378.0


def seen_from_below(t: np.ndarray, states: np.ndarray) -> dict[int, Directions]:
    """Exact directions of states (n, 6) at epochs (n,), a tracklet each, from the nearest place on the Earth."""
    here = EARTH_KM * states[:, :3] / np.linalg.norm(states[:, :3], axis=1, keepdims=True)
    line, rho, _ = retarded(states, here)
    return {
        k: Directions(
            t_tai_ns=t[k : k + 1],
            observer_km=here[k : k + 1],
            direction=line[k : k + 1] / rho[k],
            axes=np.eye(3)[None, :2],
            covariance_rad2=1e-12 * np.eye(2)[None],
        )
        for k in range(len(t))
    }


def known(state: np.ndarray) -> KnownOrbit:
    """An orbit of a state (6,) at T0 that is good to a metre and 0.1 mm/s."""
    orbit = StoredOrbit(
        object_id=1, epoch_tai_ns=T0, state=state, covariance=np.diag([1e-6] * 3 + [1e-14] * 3), made_tai_ns=0, made_by="t",
        chi2_nu=1.0,
    )  # fmt: skip
    return KnownOrbit(orbit=orbit, forces=ForceModel(), covariance=orbit.covariance)


@pytest.mark.parametrize(("perigee_km", "e"), [(6878.0, 0.0), (6878.0, 0.3), (6628.0, 0.73), (6878.0, 0.85), (42164.0, 0.0)])
def test_exact_directions_of_an_orbit_are_all_candidates(perigee_km: float, e: float) -> None:
    """Random epochs of a day, observers below the object: the nearest there are, for which the sieve is narrowest."""
    speed, inclination = math.sqrt(MU_KM3_S2 * (1.0 + e) / perigee_km), math.radians(7.0)
    state = np.array([perigee_km, 0.0, 0.0, 0.0, speed * math.cos(inclination), speed * math.sin(inclination)])
    t = np.sort(T0 + np.random.default_rng(4).integers(0, 86_400 * 10**9, 400))
    states = propagate(state, T0, t, ForceModel()).states
    data = seen_from_below(t, states)
    found = sightings(data, [known(state)])
    assert {s.tracklet_id for s in found} == set(data)


def test_what_forces_leave_out_moves_an_old_orbit_along_its_way() -> None:
    """After ten geostationary days: Clohessy and Wiltshire's equations, 32.5, 1395 and 9.0 m; free motion has 464 m each."""
    state = np.array([42_164.0, 0.0, 0.0, 0.0, math.sqrt(MU_KM3_S2 / 42_164.0), 0.0])
    t = np.array([T0 + 864_000 * 10**9])
    there = propagate(state, T0, t, ForceModel()).states
    (seen,) = sightings(seen_from_below(t, there), [known(state)])
    radial, along = (there[0, part] / np.linalg.norm(there[0, part]) for part in (slice(3), slice(3, 6)))
    axes = np.array([radial, along, np.cross(radial, along)])
    sigma_m = 1e3 * np.sqrt(np.diag(axes @ seen.noise[:3, :3] @ axes.T))
    assert sigma_m == pytest.approx([32.5, 1395.0, 9.0], rel=0.02)
