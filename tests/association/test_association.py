"""Blind association of high orbits, against Vallado's Lambert example, closed orbits and a truth with other forces."""

import math

import numpy as np
import pytest

from ground.association.arc import arc_orbits, coordinates_of
from ground.association.associate import associate
from ground.association.clusters import AssociationOptions, Orbit, judged
from ground.association.correlate import correlate
from ground.association.lambert import lambert
from ground.determination.forces import ForceModel
from ground.determination.propagation import propagate
from sboc_e2e.icd.errors import UserError
from simulator.platform.all_forces import MU, between
from tests.association.list_simulator import Survey, kepler, survey
from tests.association.lists import directions, measured, verdict

ARCSEC = math.radians(1.0 / 3600.0)


@pytest.fixture(scope="module")
def few() -> Survey:
    return survey(3, objects=6, clutter=3)


def test_lambert_of_a_text_book() -> None:
    # Vallado 2013, example 7-5
    speed = np.empty(6)
    first, second = np.array([15945.34, 0.0, 0.0]), np.array([12214.83899, 10249.46731, 0.0])
    assert lambert(first, second, 76.0 * 60.0, 0, np.array([0.0, 0.0, 1.0]), False, speed)
    assert speed == pytest.approx([2.058913, 2.915965, 0.0, -3.451565, 0.910315, 0.0], abs=2e-6)


def test_lambert_finds_the_orbit_it_was_made_of() -> None:
    rng, speed = np.random.default_rng(5), np.empty(6)
    for _ in range(500):
        a, e, dt = rng.uniform(2e4, 4.5e4), rng.uniform(0.0, 0.5), rng.uniform(0.02, 5.0) * 86400.0
        angles, rate = rng.uniform(0.0, 3.1, 4), math.sqrt(MU / a**3)
        one, two = (kepler(a, e, *angles[:3], angles[3] + rate * t) for t in (0.0, dt))
        normal = np.cross(one[:3], one[3:])
        around = int(rate * dt / (2.0 * math.pi))
        nearest = math.inf
        for revolutions in range(max(around - 1, 0), around + 2):
            for late in (False, True):
                if lambert(one[:3], two[:3], dt, revolutions, normal, late, speed):
                    nearest = min(nearest, float(np.abs(speed - np.concatenate([one[3:], two[3:]])).max()))
        assert nearest < 1e-7  # km/s


def test_the_truth_and_the_propagator_agree_though_they_share_nothing(few: Survey) -> None:
    t = few.sky.t0_tai_ns + (np.array([1.0, 6.0]) * 86400e9).astype(np.int64)
    for k in range(3):
        arc = propagate(few.truth[k, 0], few.sky.t0_tai_ns, t, ForceModel(gravity_degree=8, radiation=few.area_m2_kg[k]))
        away = np.linalg.norm(arc.states[:, :3] - few.truth[k, [1440, 8640], :3], axis=1)
        # a sixth of the bound of four arcs
        assert away[0] < 0.01
        assert away[1] < 0.07


def test_an_arc_of_seven_minutes_knows_its_orbit(few: Survey) -> None:
    nees = []
    for seen, arc in zip(few.seen, arc_orbits(measured(few)), strict=True):
        if seen.owner >= 0 and arc is not None:
            q, _ = coordinates_of(between(few.truth[seen.owner], seen.t_s[7:8])[0], arc.observer_km, arc.observer_km_s, arc.axes)
            nees.append((q - arc.mean) @ np.linalg.solve(arc.covariance, q - arc.mean) / 6.0)
    n = len(nees)
    assert n > 15
    assert float(np.mean(nees)) == pytest.approx(1.0, abs=3.0 * math.sqrt(2.0 / (6.0 * n)))


@pytest.mark.slow
def test_tracklets_of_days_become_objects(few: Survey) -> None:
    found = associate(measured(few))
    result = verdict(few, found)
    assert result.right == result.linkable
    assert result.wrong == 0
    assert float(result.nees.mean()) == pytest.approx(1.0, abs=3.0 * math.sqrt(2.0 / (3.0 * len(result.nees))))


def test_new_tracklets_find_their_object_and_nothing_else(few: Survey) -> None:
    orbits = []
    for k in range(6):
        sigma = np.diag([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
        state = few.truth[k, 0] + np.random.default_rng(k).normal(size=6) * np.diag(sigma)
        orbits.append((Orbit(few.sky.t0_tai_ns, state, sigma**2), ForceModel(gravity_degree=8, radiation=0.02)))
    arcs = [a for a in arc_orbits(measured(few)) if a is not None]
    for seen, found in zip(few.seen, correlate(arcs, orbits), strict=True):
        if seen.owner < 0:
            assert not found
        else:
            assert found[0].known == seen.owner
            assert found[0].probability > 0.99


def test_two_objects_that_cannot_be_told_apart_stay_ambiguous(few: Survey) -> None:
    near = np.diag([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4]) ** 2
    model = ForceModel(gravity_degree=8, radiation=0.02)
    twin = few.truth[0, 0] + np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    orbits = [(Orbit(few.sky.t0_tai_ns, s, near), model) for s in (few.truth[0, 0], twin)]
    chosen = [k for k, s in enumerate(few.seen) if s.owner == 0][:1]
    arcs = [a for a in arc_orbits([measured(few)[k] for k in chosen]) if a is not None]
    (found,) = correlate(arcs, orbits)
    assert sorted(c.known for c in found) == [0, 1]
    assert all(0.1 < c.probability < 0.9 for c in found)


def test_too_few_directions_have_no_orbit(few: Survey) -> None:
    from ground.association.arc import arc_orbit
    from ground.determination.measurements import Directions

    d = measured(few)[0]
    two = Directions(
        t_tai_ns=d.t_tai_ns[:2], observer_km=d.observer_km[:2], direction=d.direction[:2], axes=d.axes[:2],
        covariance_rad2=d.covariance_rad2[:2],
    )  # fmt: skip
    with pytest.raises(UserError, match="three or more"):
        arc_orbit(two)
    assert arc_orbits([two]) == [None]


@pytest.mark.slow
def test_two_hundred_objects_of_five_days() -> None:
    one = survey(2)
    result = verdict(one, associate(measured(one)))
    n = len(result.nees)
    assert result.right >= 0.95 * result.linkable
    assert result.wrong <= 0.01 * result.linked
    assert math.sqrt(float(result.squared_ratio.mean())) <= 1.3
    # 0.9 to 1.1 is asked; 200 objects leave a standard error of 0.058
    assert float(result.nees.mean()) == pytest.approx(1.0, abs=0.1 + 2.0 * math.sqrt(2.0 / (3.0 * n)))


@pytest.mark.slow
def test_a_long_arc_is_an_orbit_of_its_last_tracklet_that_may_have_been_pushed() -> None:
    one = survey(61, objects=2, clutter=0, days=9.0, a_day=1.0)
    for owner in range(2):
        mine = sorted((s for s in one.seen if s.owner == owner), key=lambda s: s.t_s[0])
        every, t0 = [directions(one, s) for s in mine], one.sky.t0_tai_ns
        epochs = []
        # five days, and nine
        for few in (every[:5], every):
            cluster = judged(tuple(range(len(few))), few, one.truth[owner, 0], t0, AssociationOptions())
            assert cluster is not None
            s = cluster.solution
            truth = between(one.truth[owner], np.array([(s.t0_tai_ns - t0) * 1e-9]))[0]
            away = s.state - truth
            # six degrees of freedom: one in a million is beyond 38
            assert away @ np.linalg.solve(s.covariance[:6, :6], away) < 38.0
            epochs.append(s.t0_tai_ns)
        assert epochs == [t0, int(every[-1].t_tai_ns[len(every[-1].t_tai_ns) // 2])]
