"""Objects seen for half a minute a night, always at one sidereal time: pairs a whole turn apart, and orbits grown from them."""

import math

import numpy as np
import pytest

from ground.association.arc import ArcOrbit, arc_orbit
from ground.association.associate import associate
from ground.association.returns import of_shape, returns_of
from ground.determination.propagation import propagate
from simulator.platform.all_forces import MU, between
from tests.association.list_simulator import Seen, Survey, kepler, light, observer_states, survey
from tests.association.lists import directions, measured
from tests.upkeep.short_lists import of_half_minutes

DAY_S = 86_164.1
GEO_KM = 42_164.0


@pytest.fixture(scope="module")
def empty() -> Survey:
    return survey(1, objects=1, clutter=0, days=1.0)


def noiseless(one: Survey, elements: tuple[float, ...], at_s: float) -> tuple[ArcOrbit, np.ndarray]:
    """The arc of a two-body orbit in half a minute, with stated errors of 0.75 arcsec; and the true state at its middle."""
    t = at_s + np.linspace(0.0, 30.0, 25)
    rate = math.sqrt(MU / elements[0] ** 3)
    states = np.array([kepler(*elements[:5], elements[5] + rate * s) for s in t])
    observer = observer_states(t, one.sky.sun[0])
    data = directions(one, Seen(owner=0, t_s=t, observer=observer, direction=light(states, observer)))
    return arc_orbit(data), states[12]


@pytest.mark.parametrize("elements", [(GEO_KM, 0.0, 0.1, 1.0, 0.5, 0.3), (GEO_KM, 0.04, 0.2, 2.0, 0.5, 2.0)])
def test_the_size_of_an_orbit_gives_an_arc_its_place(empty: Survey, elements: tuple[float, ...]) -> None:
    arc, truth = noiseless(empty, elements, 100.0)
    assert arc.is_weak
    found = of_shape(arc, GEO_KM)
    assert found is not None
    # one part in ten of the place, from an arc whose own range is a fifth wrong: as far as the eccentricity lets it
    assert np.linalg.norm(found.state[:3] - truth[:3]) < 0.1 * GEO_KM
    away = found.momentum - np.cross(truth[:3], truth[3:]) / math.sqrt(MU * GEO_KM)
    # three degrees of freedom: one in a million is beyond 31
    assert away @ np.linalg.solve(found.of_momentum, away) < 31.0
    # no orbit of half a day has these directions
    assert of_shape(arc, 26_560.0) is None


def test_arcs_a_turn_apart_are_pairs_if_their_planes_agree(empty: Survey) -> None:
    one = (GEO_KM, 0.02, 0.1, 1.0, 0.5, 0.3)
    other = (GEO_KM, 0.02, 0.2, 1.5, 0.0, 0.3)
    arcs = [noiseless(empty, elements, at)[0] for elements in (one, other) for at in (100.0, 100.0 + DAY_S, 100.0 + 2.0 * DAY_S)]
    found = returns_of(arcs, 5.0)
    pairs = set(zip(found.first.tolist(), found.second.tolist(), strict=True))
    assert pairs == {(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5)}
    # an hour more than a turn is no return to the same place: Lambert's problem has a plane there
    assert len(returns_of(arcs[:2], 0.5).first) == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [42, 44, 45, 46])
def test_objects_of_one_sidereal_time_get_their_orbits(seed: int) -> None:
    one = of_half_minutes(seed, (0.0, 23.9345, 47.869))
    owner = [s.owner for s in one.seen]
    found = associate(measured(one))
    assert sorted([owner[m] for m in cluster.members] for cluster in found) == [[k] * 3 for k in range(3)]
    last_s = max(s.t_s[12] for s in one.seen)
    at = np.array([one.sky.t0_tai_ns + round(last_s * 1e9)], dtype=np.int64)
    for cluster in found:
        s = cluster.solution
        arc = propagate(s.state, s.t0_tai_ns, at, s.forces, parameters=("radiation",), partials=True)
        covariance = (arc.partials[0] @ s.covariance @ arc.partials[0].T)[:3, :3]
        away = arc.states[0, :3] - between(one.truth[owner[cluster.members[0]]], np.array([last_s]))[0, :3]
        assert np.linalg.norm(away) < 10.0
        # the covariance is that of a straight line, the orbits lie along a bent one: up to three times its size was found
        assert away @ np.linalg.solve(covariance, away) < 9.0 * 16.3
