"""The range posterior against encounters of an independent generator, and its behaviour at the limits."""

from dataclasses import replace

import numpy as np
import pytest

from ground.orbit import RangeScan
from ground.orbit.attributable import attributable_of
from ground.orbit.range_scan import problem_of
from ground.orbit.scan import curve
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.steps import OrbitDeterminer
from tests.orbit.encounters import MU, T0_NS, Encounter, draw_encounters, observed, snr_of, sun_and_observer, trajectory


@pytest.mark.parametrize("population", ["catalogue", "breakup", "natural"])
@pytest.mark.slow
def test_intervals_cover_and_no_trivial_root(population: str) -> None:
    """40 encounters: 90 % intervals hold the truth in 76-100 % of cases (3 sigma of the binomial), none collapses."""
    rng = np.random.default_rng(21)
    shares = {"catalogue": (0.0, 0.0), "breakup": (1.0, 1.0), "natural": (0.8, 0.1)}[population]
    step = RangeScan(breakup_share_small=shares[0], breakup_share_large=shares[1], albedo_sigma_ln=0.0)
    assert isinstance(step, OrbitDeterminer)
    hits = np.zeros(4)
    for one in draw_encounters(40, rng, population=population, pool=150_000):
        tracklet, headers = observed(one, rng)
        got = step.estimate(tracklet, headers)
        assert got.converged
        assert got.range_km[1] > 0.1 * one.range_km
        truth = [
            (got.range_km, one.range_km),
            (got.a_km, one.elements[0]),
            (got.e, one.elements[1]),
            (got.i_deg, one.elements[2]),
        ]
        hits += [float(interval[0] <= value <= interval[2]) for interval, value in truth]
        assert np.trapezoid(got.range_posterior, got.range_grid_km) == pytest.approx(1.0, abs=0.1)
        assert got.modes[:, 1].sum() == pytest.approx(1.0, abs=1e-9)
    assert (hits / 40 >= 0.76).all()


def test_long_arc_of_a_geostationary_object_is_least_squares() -> None:
    """Ten minutes at 1 arcsec: the data carry the range to 1 % and the inclination to 0.1 deg, whatever the prior."""
    sun, _ = sun_and_observer()
    radial = -sun + np.array([0.0, 0.0, 0.1])
    radial[2] = 0.02
    radial /= np.linalg.norm(radial)
    along = np.cross([0.0, 0.0, 1.0], radial)
    along /= np.linalg.norm(along)
    state = np.concatenate([42164.0 * radial, np.sqrt(MU / 42164.0) * along])
    _, observer = sun_and_observer()
    relative = state - observer
    rho = float(np.linalg.norm(relative[:3]))
    line = relative[:3] / rho
    rate = float(np.degrees(np.linalg.norm(relative[3:] - (relative[3:] @ line) * line) / rho))
    one = Encounter(
        state=state, elements=np.array([42164.0, 0.0, 1.1]), range_km=rho, rate_deg_s=rate, size_m=1.0, mag=14.5,
        snr=float(snr_of(np.array(14.5), np.array(rate))),
    )  # fmt: skip
    tracklet, headers = observed(one, np.random.default_rng(3), cadence_s=20.0, longest_s=600.0, error_px=0.2)
    for share in (0.01, 0.3):
        got = RangeScan(ring_share=share).estimate(tracklet, headers)
        assert got.range_km[1] == pytest.approx(rho, rel=0.01)
        assert got.range_km[0] < rho < got.range_km[2]
        assert got.i_deg[1] == pytest.approx(
            np.degrees(np.arccos(np.cross(state[:3], state[3:])[2] / np.linalg.norm(np.cross(state[:3], state[3:])))), abs=0.1
        )
        assert got.a_km[1] == pytest.approx(42164.0, rel=0.02)


def test_nothing_to_work_with_is_said() -> None:
    """Without observer states or without sky positions there is no estimate, and it says so."""
    rng = np.random.default_rng(1)
    one = draw_encounters(1, rng, population="catalogue", pool=50_000)[0]
    tracklet, headers = observed(one, rng)
    blind = tuple(replace(h, observer=None) for h in headers)
    for case in (
        RangeScan().estimate(tracklet, blind),
        RangeScan().estimate(replace(tracklet, ra_deg=np.full(len(tracklet.ra_deg), np.nan)), headers),
    ):
        assert not case.converged
        assert np.isnan(case.range_km).all()
        assert case.modes.shape == (0, 5)
    assert "catalogued" in RangeScan().estimate(tracklet, headers).prior


def test_same_input_gives_same_bytes() -> None:
    """No hidden randomness."""
    rng = np.random.default_rng(2)
    tracklet, headers = observed(draw_encounters(1, rng, population="catalogue", pool=50_000)[0], rng)
    one, other = RangeScan().estimate(tracklet, headers), RangeScan().estimate(tracklet, headers)
    assert one.range_km.tobytes() == other.range_km.tobytes()
    assert one.range_posterior.tobytes() == other.range_posterior.tobytes()


def test_light_time_is_the_orbit_s_business() -> None:
    """A target whose light left rho/c earlier: ignoring it would shift the state by v rho/c, 0.1 km at 4,000 km."""
    rng = np.random.default_rng(5)
    one = next(e for e in draw_encounters(60, rng, population="catalogue", pool=100_000) if e.range_km > 1500.0)
    tracklet, _ = observed(one, rng, error_px=0.0)
    data = attributable_of(tracklet, 0.01)
    assert data is not None
    _, observer = sun_and_observer()
    at_reference = trajectory(observer, np.array([(data.t_ref_tai_ns - T0_NS) * 1e-9]))[0]
    relative = one.state[:3] - at_reference[:3]
    rho = np.linalg.norm(relative)
    line = relative / rho
    rate = float((one.state[3:] - at_reference[3:]) @ line)
    out = np.empty(2 * len(data.form.node_s))
    at_node_km = trajectory(at_reference, data.form.node_s)[:, :3]
    curve(problem_of(data, at_reference, at_node_km), float(rho), rate, np.empty(6), out)
    chi2 = data.form.constant - 2.0 * data.form.linear @ out + out @ data.form.quadratic @ out
    # errors of 0.01 arcsec: an arc curve wrong by that much would show
    assert chi2 < 2.0 * len(tracklet.t_tai_ns)


@pytest.mark.parametrize(
    "options",
    [
        {"tail_share": 1.0, "ring_share": 0.0},
        {"tail_share": 0.5, "ring_share": 0.5},
        {"nearest_km": 100.0, "farthest_km": 100.1},
        {"nearest_km": 9000.0, "farthest_km": 1e6},
        {"nearest_km": 0.001, "farthest_km": 1.0},
    ],
)
def test_options_at_their_limits_give_an_estimate_or_say_that_there_is_none(options: dict[str, float]) -> None:
    """No low orbits, hardly a range to scan, only ranges where nothing is."""
    rng = np.random.default_rng(2)
    tracklet, headers = observed(draw_encounters(1, rng, population="catalogue", pool=50_000)[0], rng)
    estimate = RangeScan(**options).estimate(tracklet, headers)
    assert estimate.converged == bool(np.isfinite(estimate.range_km).all())
    if estimate.converged:
        low, high = RangeScan(**options).nearest_km, RangeScan(**options).farthest_km
        assert ((estimate.range_km >= 0.99 * low) & (estimate.range_km <= 1.01 * high)).all()


@pytest.mark.parametrize("options", [{"nearest_km": 100.0, "farthest_km": 100.0}, {"tail_share": 0.7, "ring_share": 0.4}])
def test_options_that_contradict_each_other_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(UserError, match="allowed is"):
        RangeScan(**options)
