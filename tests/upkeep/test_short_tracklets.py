"""Objects whose tracklets last half a minute: two orbits may meet the first few of them, and pairs start from ranges 20 % off."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground.association.arc import arc_orbits
from ground.association.associate import associate
from ground.association.clusters import AssociationOptions
from ground.association.pairs import pairs_of
from ground.determination.measurements import Directions
from ground.store.store import ObjectStore, StoredOrbit
from ground.upkeep.joins import Provisional, join_of
from ground.upkeep.night import update
from ground.upkeep.view import UpkeepOptions, known_orbit
from sboc_e2e.icd import tai
from simulator.platform.all_forces import DAY_S
from tests.association.list_simulator import Survey
from tests.association.lists import measured
from tests.upkeep.short_lists import of_half_minutes
from tests.upkeep.test_division import true_error_chi2
from tests.upkeep.test_night import owners, put

HOURS = (0.0, 0.2, 23.9345, 24.1345, 47.869, 48.069)
"""Two visits in each of three nights, at the same sidereal times."""


@pytest.fixture(scope="module", params=(41, 42))
def short(request: pytest.FixtureRequest) -> Survey:
    """Three geostationary objects in six visits."""
    return of_half_minutes(request.param, HOURS)


@pytest.mark.slow
def test_orbits_of_half_minutes_are_right_after_three_nights(short: Survey, tmp_path: Path) -> None:
    """No object mixes tracklets of others, each has a right orbit of four or more, and no pair stays apart."""
    store, owner_of = ObjectStore(str(tmp_path / "store.db")), {}
    for hour in HOURS:
        day = hour * 3600.0 / DAY_S
        owner_of |= put(store, short, day, day + 0.005)
        update(store, short.sky.t0_tai_ns + round((day + 0.005) * tai.NS_PER_DAY))
    found = {number: mine for number, mine in owners(store, owner_of).items() if mine}
    assert all(len(set(mine)) == 1 for mine in found.values())
    assert sorted(mine[0] for mine in found.values()) == [0, 1, 2]
    assert min(len(mine) for mine in found.values()) >= 4
    for number, mine in found.items():
        (orbit,) = store.orbits(number)
        # six degrees of freedom: one in a million is beyond 38
        assert true_error_chi2(short, orbit, mine[0]) < 38.0
        assert math.sqrt(np.trace(orbit.state_covariance[:3, :3])) < 1.0
    store.close()


def test_right_pairs_of_weak_arcs_are_found(short: Survey) -> None:
    """Of one object: pairs of twelve minutes and of different sidereal times in two nights."""
    mine = [d for d, s in zip(measured(short), short.seen, strict=True) if s.owner == 0]
    arcs = [arc for arc in arc_orbits(mine) if arc is not None]
    assert len(arcs) == len(HOURS)
    assert all(arc.is_weak for arc in arcs)
    pairs = pairs_of(arcs, longest_days=5.0, chi2_limit=40.0, doubt_km_s=6e-4)
    found = {(int(a), int(b)) for a, b in zip(pairs.first, pairs.second, strict=True)}
    assert found >= {(0, 1), (2, 3), (4, 5), (1, 2), (0, 5)}


def provisional(tracklets: dict[int, Directions], number: int) -> Provisional:
    """An object of some tracklets, with the orbit that the night would give it."""
    s = associate(list(tracklets.values()))[0].solution
    orbit = StoredOrbit(
        object_id=number, epoch_tai_ns=s.t0_tai_ns, state=s.state, covariance=s.covariance, made_tai_ns=0, made_by="test",
        parameters={"radiation": s.forces.radiation}, chi2_nu=s.chi2_nu,
    )  # fmt: skip
    return Provisional(orbit=known_orbit(orbit, UpkeepOptions()), tracklets=tracklets, is_new=True)


@pytest.mark.slow
def test_a_pair_is_joined_to_its_object_and_not_to_a_neighbour() -> None:
    """The neighbour is 0.02 deg further east (15 km): near the object's way, and the fit of all alone can tell."""
    short = of_half_minutes(41, HOURS)
    mine = dict(enumerate(d for d, s in zip(measured(short), short.seen, strict=True) if s.owner == 0))
    host = provisional({k: mine[k] for k in (0, 1, 2, 3)}, 1)
    pair = provisional({k: mine[k] for k in (4, 5)}, 2)
    found = join_of({1: host}, {2: pair}, AssociationOptions())
    assert found is not None
    assert (found.host, found.pair) == (1, 2)
    angle = math.radians(0.02)
    turn = np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    moved = {k: replace(d, direction=d.direction @ turn.T) for k, d in pair.tracklets.items()}
    assert join_of({1: host}, {2: provisional(moved, 2)}, AssociationOptions()) is None
    # what was not touched tonight is not tried again
    assert join_of({1: replace(host, is_new=False)}, {2: replace(pair, is_new=False)}, AssociationOptions()) is None
