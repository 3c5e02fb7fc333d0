"""A Kalman step from an orbit's covariance against the batch fit of all directions; which tracklets an orbit is held against."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from ground.association.clusters import AssociationOptions, Cluster, judged
from ground.determination.measurements import Directions
from ground.store.store import StoredOrbit
from ground.upkeep import sequential
from ground.upkeep.sightings import KnownOrbit, sightings
from ground.upkeep.view import UpkeepOptions, known_orbit
from simulator.platform.all_forces import STEP_S
from tests.association.list_simulator import Survey, survey
from tests.association.lists import directions


@pytest.fixture(scope="module")
def one() -> Survey:
    return survey(12, objects=3, clutter=1, days=4.0, a_day=1.0)


def of_owner(one: Survey, owner: int) -> list[Directions]:
    """An object's tracklets in order of time."""
    mine = sorted((s for s in one.seen if s.owner == owner), key=lambda s: float(s.t_s[0]))
    return [directions(one, s) for s in mine]


def fitted(one: Survey, owner: int, data: list[Directions]) -> Cluster:
    """Batch fit at the middle of the last tracklet, from the truth."""
    epoch = int(data[-1].t_tai_ns[7])
    start = one.truth[owner][round((epoch - one.sky.t0_tai_ns) * 1e-9 / STEP_S)]
    found = judged(tuple(range(len(data))), data, start, epoch, AssociationOptions())
    assert found is not None
    return found


def known_of(cluster: Cluster) -> KnownOrbit:
    s = cluster.solution
    orbit = StoredOrbit(
        object_id=1, epoch_tai_ns=s.t0_tai_ns, state=s.state, covariance=s.covariance, made_tai_ns=0, made_by="fit",
        parameters={p: s.forces.value_of(p) for p in s.parameters}, chi2_nu=s.chi2_nu, n_used=len(s.weights),
    )  # fmt: skip
    return known_orbit(orbit, UpkeepOptions())


@pytest.mark.parametrize("owner", [0, 1, 2])
def test_a_renewed_orbit_is_the_fit_of_all_directions(one: Survey, owner: int) -> None:
    data = of_owner(one, owner)
    before = fitted(one, owner, data[:-1])
    known = known_of(before)
    assert known.forces == before.solution.forces
    (seen,) = sightings({5: data[-1]}, [known])
    assert (seen.object_id, seen.tracklet_id) == (1, 5)
    new = sequential.renewed(known, [seen], "test", 0)
    assert new is not None
    every = fitted(one, owner, data).solution
    left = (np.append(new.state, new.parameters["radiation"]) - np.append(every.state, every.forces.radiation)) / np.sqrt(
        np.diag(every.covariance)
    )
    # what differs is the step's square, robust weights, and the noise of what forces leave out, 51 m along the way in a day
    assert np.abs(left).max() < 0.3
    bare = sequential.renewed(known, [replace(seen, noise=np.zeros_like(seen.noise))], "test", 0)
    assert bare is not None
    sigma = np.sqrt(np.diag(every.covariance))
    assert np.sqrt(np.diag(bare.covariance)) == pytest.approx(sigma, rel=0.15)
    # which the fit of all directions does not have
    assert (np.diag(new.covariance) >= np.diag(bare.covariance)).all()
    assert np.sqrt(np.diag(new.covariance)) == pytest.approx(sigma, rel=0.3)
    assert new.n_used == len(every.weights)


def test_a_step_that_is_too_surprising_is_left_to_the_batch_fit(one: Survey) -> None:
    data = of_owner(one, 0)
    known = known_of(fitted(one, 0, data[:-1]))
    (seen,) = sightings({5: data[-1]}, [known])
    spoilt = seen.residual.copy()
    spoilt[4] += 12.0
    assert sequential.renewed(known, [replace(seen, residual=spoilt)], "test", 0) is None
    wide = replace(known, covariance=known.covariance * 1e12)
    assert sequential.renewed(wide, [replace(seen, residual=seen.residual + 1e5)], "test", 0) is None


@pytest.mark.parametrize(("kick", "linear"), [(1.0, False), (0.001, True)])
def test_a_step_in_velocity_that_bends_the_way_is_left_to_the_batch_fit(one: Survey, kick: float, linear: bool) -> None:
    """An orbit 10 m/s off that says so: its way bends by kilometres within days, and tracklets see a tenth of one."""
    data = of_owner(one, 0)
    known = known_of(fitted(one, 0, data[:2]))
    off = kick * np.array([0.0, 0.0, 0.0, 6.5e-3, -7.2e-3, -0.3e-3, 0.0])
    moved = replace(known.orbit, state=known.orbit.state + off[:6])
    wide = replace(known, orbit=moved, covariance=known.covariance + np.outer(off, off))
    seen = sightings({5: data[2], 6: data[3]}, [wide])
    assert [s.tracklet_id for s in seen] == [5, 6]
    assert (sequential.renewed(wide, seen, "test", 0) is not None) == linear


def test_each_tracklet_has_the_noise_up_to_it(one: Survey) -> None:
    """Least squares with what is left out up to each tracklet as unknowns of its own: state and covariance are the same."""
    data = of_owner(one, 0)
    known = known_of(fitted(one, 0, data[:2]))
    # a hundred times as much as is assumed: then it matters
    seen = [replace(s, noise=100.0 * s.noise) for s in sightings({5: data[2], 6: data[3]}, [known])]
    first, last = sorted(seen, key=lambda s: s.t_tai_ns)
    new = sequential.renewed(known, seen, "test", 0)
    assert new is not None
    onward = last.numbers @ np.linalg.inv(first.numbers)
    # unknowns: numbers at the orbit's epoch, what is added up to the first tracklet, and from there to the last
    between = last.noise - onward @ first.noise @ onward.T
    priors = (known.covariance, first.noise[:6, :6], between[:6, :6])
    roots = [np.linalg.cholesky(p) for p in priors]
    added = np.eye(7, 6)
    at_first = np.hstack([first.numbers @ roots[0], added @ roots[1], np.zeros((7, 6))])
    at_last = np.hstack([onward @ at_first[:, :13], added @ roots[2]])
    rows = [s.slope @ np.linalg.solve(s.numbers, at) for s, at in ((first, at_first), (last, at_last))]
    slope, value = np.vstack([np.eye(19), *rows]), np.concatenate([np.zeros(19), first.residual, last.residual])
    step, *_ = np.linalg.lstsq(slope, -value, rcond=None)
    root = at_last @ np.linalg.inv(np.linalg.qr(slope, mode="r"))
    sigma = np.sqrt((root**2).sum(axis=1))
    assert np.sqrt(np.diag(new.covariance)) == pytest.approx(sigma, rel=1e-4)
    assert (new.state - last.state) / sigma[:6] == pytest.approx((at_last @ step)[:6] / sigma[:6], abs=1e-3)


def test_a_tracklet_that_comes_late_is_left_to_the_batch_fit(one: Survey) -> None:
    """Alone, and beside one of tonight."""
    data = of_owner(one, 0)
    known = known_of(fitted(one, 0, [data[0], data[2]]))
    late, fresh = sightings({5: data[1], 6: data[3]}, [known])
    assert late.t_tai_ns < known.orbit.epoch_tai_ns < fresh.t_tai_ns
    assert sequential.renewed(known, [late], "test", 0) is None
    assert sequential.renewed(known, [late, fresh], "test", 0) is None
    assert sequential.renewed(known, [fresh], "test", 0) is not None


def test_a_step_that_cannot_be_followed_is_not_linear(one: Survey) -> None:
    """Over more days than propagation goes; a step onto a way that meets the Earth ends alike, after a minute's work."""
    data = of_owner(one, 0)
    known = known_of(fitted(one, 0, data[:2]))
    (seen,) = sightings({6: data[2]}, [known])
    far = replace(seen, t_tai_ns=known.orbit.epoch_tai_ns + 401 * 86_400 * 10**9)
    step = seen.numbers @ np.concatenate([np.zeros(3), -0.1 * known.orbit.state[3:], [0.0]])
    assert not sequential._is_linear(known, far, step, known.covariance, known.orbit.parameters)


def test_only_tracklets_near_its_way_are_an_orbits(one: Survey) -> None:
    """Alone and by several workers; with tracklets before and after the orbit's epoch."""
    cut = [fitted(one, owner, of_owner(one, owner)[:2]) for owner in range(3)]
    known = [replace(k, orbit=replace(k.orbit, object_id=n)) for n, k in enumerate(map(known_of, cut))]
    data = {k: directions(one, s) for k, s in enumerate(one.seen)}
    found = sightings(data, known)
    assert {(s.object_id, s.tracklet_id) for s in found} >= {(s.owner, k) for k, s in enumerate(one.seen) if s.owner >= 0}
    assert len(found) <= len(one.seen) + 2
    with ThreadPoolExecutor(2) as pool:
        again = sightings(data, known, pool)
    assert [(s.object_id, s.tracklet_id) for s in again] == [(s.object_id, s.tracklet_id) for s in found]
    assert all(np.array_equal(a.state, b.state) for a, b in zip(again, found, strict=True))
