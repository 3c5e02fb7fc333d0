"""Orbits fitted to precise ephemerides and laser ranges: the propagator, the batch filter and the readers together."""

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation
from astropy.time import Time

from ground.determination.batch import FitOptions, fit
from ground.determination.forces import ForceModel
from ground.determination.laser import laser_ranges, zenith_delay_m
from ground.determination.measurements import Directions, Positions, retarded
from ground.determination.precise import (
    Ephemeris,
    NormalPoints,
    fitted,
    free_orbit,
    orbit_of,
    read_cpf,
    read_normal_points,
    read_sp3,
    uncompressed,
)
from ground.determination.propagation import itrs_to_gcrs, propagate
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from tests.conjunctions.reference import folder

pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

METRE = 1e-3
T0 = 1_800_000_000 * tai.NS_PER_S


@pytest.fixture(scope="module")
def navigation() -> dict[str, Ephemeris]:
    path = folder("sp3") / "gbm18432.sp3.Z"
    return read_sp3(path.read_bytes(), path.name)


def circle(radius_km: float = 26_560.0) -> np.ndarray:
    return np.array([radius_km, 0.0, 0.0, 0.0, np.sqrt(MU_KM3_S2 / radius_km) * 0.6, np.sqrt(MU_KM3_S2 / radius_km) * 0.8])


def test_the_compressed_file_is_read_as_published(navigation: dict[str, Ephemeris]) -> None:
    assert len(navigation) == 71
    one = navigation["G01"]
    assert len(one.t_tai_ns) == 288
    # 2015-05-05 00:00:00 GPS is 00:00:19 TAI
    assert Time(*tai.to_jd_parts(int(one.t_tai_ns[0])), format="jd", scale="tai").isot == "2015-05-05T00:00:19.000"
    assert navigation["C01"].itrs_km[0] == pytest.approx([-32323.399959, 27093.052654, -172.802215])


SP3_A = b"""#aP1994 12 17  0  0  0.00000000       3     d ITR92 FIT  NGS
##  779 518400.00000000   900.00000000 49703 0.0000000000000
+   25     1  2  4  5  6  7  9 12 14 15 16 17 18 19 20 21 22
++         7  6  5  5  5  5  5  5  5  6  5  5  5  5  6  5  5
%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
*  1994 12 17  0  0  0.00000000
P  1  16258.524750  -3529.015750 -20611.427050    -62.540600
P 28  13204.937750 -20485.533400  10794.787000     55.200800
*  1994 12 17  0 15  0.00000000
P  1  15716.820135  -1169.850490 -21281.578766    -62.542746
P 28  13416.746195 -22186.753441   6248.864499     55.385492
EOF
"""
"""Lines of the example of version a that NGS published, of 17 December 1994."""


def test_version_a_is_in_gps_time_and_numbers_its_satellites() -> None:
    every = read_sp3(SP3_A, "a.sp3")
    assert set(every) == {"G01", "G28"}
    assert every["G28"].itrs_km[1] == pytest.approx([13416.746195, -22186.753441, 6248.864499])
    # 19 s between GPS time and TAI
    assert Time(*tai.to_jd_parts(int(every["G01"].t_tai_ns[1])), format="jd", scale="tai").isot == "1994-12-17T00:15:19.000"
    with pytest.raises(UserError, match='time system "ccc" is not read'):
        read_sp3(SP3_A.replace(b"#aP", b"#cP"), "c.sp3")


@pytest.mark.parametrize("name", ["G01", "G09", "G23", "G32", "E11", "E14", "E19"])
@pytest.mark.slow
def test_a_day_of_navigation_satellites_fits_to_decimetres(navigation: dict[str, Ephemeris], name: str) -> None:
    solution = fitted(navigation[name], ForceModel(gravity_degree=12))
    assert solution.converged
    assert not solution.manoeuvre
    # whitened by 0.1 m for each axis
    assert np.sqrt(3.0) * 0.1 * solution.rms < 0.2


@pytest.mark.parametrize("name", ["G01", "G19", "E11", "E19"])
def test_half_a_day_predicts_the_other_half(navigation: dict[str, Ephemeris], name: str) -> None:
    whole = navigation[name]
    half = Ephemeris(name=name, t_tai_ns=whole.t_tai_ns[:144], itrs_km=whole.itrs_km[:144])
    solution = fitted(half, ForceModel(gravity_degree=12))
    arc = propagate(solution.state, solution.t0_tai_ns, whole.t_tai_ns, solution.forces)
    away = np.linalg.norm(arc.states[:, :3] - whole.positions(1.0).position_km, axis=1)
    assert away.max() < 10.0 * METRE


def test_a_day_of_a_prediction_predicts_the_next() -> None:
    whole = read_cpf((folder("ilrs") / "galileo212_cpf_180613_6641.esa").read_text(), "cpf")
    day = whole.t_tai_ns - whole.t_tai_ns[0] <= tai.NS_PER_DAY
    first = Ephemeris(name=whole.name, t_tai_ns=whole.t_tai_ns[day], itrs_km=whole.itrs_km[day])
    solution = fitted(first, ForceModel(gravity_degree=12))
    next_day = whole.t_tai_ns - whole.t_tai_ns[0] <= 2 * tai.NS_PER_DAY
    arc = propagate(solution.state, solution.t0_tai_ns, whole.t_tai_ns[next_day], solution.forces)
    away = np.linalg.norm(arc.states[:, :3] - whole.positions(1.0).position_km[next_day], axis=1)
    assert np.count_nonzero(next_day) > 1.9 * np.count_nonzero(day)
    assert away.max() < 30.0 * METRE


def test_radiation_pressure_alone_fits_to_a_metre(navigation: dict[str, Ephemeris]) -> None:
    solution = fitted(navigation["G01"], ForceModel(gravity_degree=12), ("sun", "panel"))
    assert np.sqrt(3.0) * 0.1 * solution.rms < 1.0
    # pressure on 0.02 m^2/kg: about 1e-7 m/s^2, away from the Sun
    assert -1.3e-7 < solution.forces.sun < -0.7e-7


def test_earth_fixed_axes_are_those_of_astropy() -> None:
    t = np.array([T0, T0 + 5_000_000 * tai.NS_PER_S])
    turned = itrs_to_gcrs(t)
    for k, epoch in enumerate(t):
        when = Time(*tai.to_jd_parts(int(epoch)), format="jd", scale="tai")
        for axis in range(3):
            point = ITRS(CartesianRepresentation(*(np.eye(3)[axis] * 42_000 * u.km)), obstime=when)
            expected = point.transform_to(GCRS(obstime=when)).cartesian.xyz.to_value(u.km)
            np.testing.assert_allclose(turned[k, :, axis] * 42_000, expected, atol=0.1 * METRE)


def test_partials_are_those_of_differences() -> None:
    forces = ForceModel(gravity_degree=8, radiation=0.02)
    t = np.array([T0 - 30_000 * tai.NS_PER_S, T0 + 40_000 * tai.NS_PER_S])
    arc = propagate(circle(), T0, t, forces, parameters=("radiation",), partials=True)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 0.1 if k < 3 else 1e-5
        high, low = (propagate(circle() + sign * step, T0, t, forces).states for sign in (1.0, -1.0))
        difference = (high - low) / (2.0 * step[k])
        scale = np.abs(difference).max(axis=1, keepdims=True)
        assert (np.abs(arc.partials[:, :, k] - difference) / scale).max() < 1e-4
    assert arc.partials.shape == (2, 6, 7)


def test_two_body_motion_returns_after_a_period() -> None:
    start = np.array([300_00.0, 0.0, 0.0, 0.0, 2.0, 2.5])
    there = propagate(start, T0, np.array([T0 + 86_400 * tai.NS_PER_S]), ForceModel(gravity_degree=20))
    back = propagate(there.states[0], T0 + 86_400 * tai.NS_PER_S, np.array([T0]), ForceModel(gravity_degree=20))
    np.testing.assert_allclose(back.states[0], start, atol=0.1 * METRE)


STATIONS_2010 = {
    7090: ((-2389007.53398, 5043329.44750, -3078524.22323), (-0.0468389, 0.0083946, 0.0509472), (3.1827, -0.0064, 0.0194)),
    7119: ((-5466065.55340, -2404338.02404, 2242108.39031), (-0.0136478, 0.0621139, 0.0324286), (2.6304, 0.0029, 0.0032)),
    7825: ((-4467064.77777, 2683034.88652, -3667007.31862), (-0.0362991, 0.0006658, 0.0455042), (0.0, 0.0, 0.0)),
    7941: ((4641978.61714, 1393067.72310, 4133249.62267), (-0.0188103, 0.0190426, 0.0144918), (0.0, 0.0, 0.0)),
}
"""SLRF2014 of the ILRS (200428): marker at 2010.0 (m), m per year; up, north, east of the optics over it (m, ILRS 200420)."""


def stations() -> dict[int, tuple[float, float, float]]:
    """Optics of the stations on 2016-02-14, km, Earth-fixed."""
    out = {}
    for pad, (place, rate, (up, north, east)) in STATIONS_2010.items():
        marker = np.array(place) + 6.12 * np.array(rate)
        radial = marker / np.linalg.norm(marker)
        # the vertical to a tenth of a degree is enough for three metres
        sideways = np.cross([0.0, 0.0, 1.0], radial)
        sideways /= np.linalg.norm(sideways)
        out[pad] = tuple(1e-3 * (marker + up * radial + north * np.cross(radial, sideways) + east * sideways))
    return out


def test_laser_ranges_of_lageos_fit_to_half_a_metre() -> None:
    root = folder("ilrs")
    prediction = read_cpf((root / "lageos2_cpf_160213_5441.sgf").read_text(), "cpf")
    start = fitted(prediction, ForceModel(), ())
    assert np.sqrt(3.0) * 0.1 * start.rms < 0.5
    points = read_normal_points((root / "lageos2_20160214.npt").read_text(), "npt")
    assert len(points.range_km) == 95
    there = propagate(start.state, start.t0_tai_ns, points.t_tai_ns, start.forces).states
    ranges = laser_ranges(points, stations(), there[:, :3], centre_km=0.251 * METRE, sigma_km=0.1 * METRE)
    # area over mass 0.2827 m^2 / 405.38 kg, coefficient 1.13
    forces = ForceModel(gravity_degree=30, radiation=1.13 * 0.2827 / 405.38)
    solution = fit(start.state, start.t0_tai_ns, [ranges], forces, (), FitOptions(reject_sigma=1e3))
    assert solution.converged
    # no tides of the ground, no ocean loading: these are left
    assert 0.1 * solution.rms < 0.2


CRD_HEAD = "h2 Station 7090 5 13 3\nh4 1 {start} 2016 2 15 0 20 0 0 0 0 0 1 0 2 0\nc0 0 532.000 std"
WEATHER = ["20 86000.0 983.7 301.4 24 0", "20 600.0 982.0 300.0 25 0"]
RANGES = [f"11 {second:.1f} 0.04 std 2 120.0 94 57.0 0 0 -1 15 0" for second in (86_100.0, 86_350.0, 30.0, 500.0)]


def pass_of(flags: str) -> NormalPoints:
    """A pass with these flags: troposphere, centre of mass, amplitude, delays of station and spacecraft; type of range."""
    head = CRD_HEAD.format(start="2016 2 14 23 50 0").replace("0 0 0 1 0 2 0", f"{flags} 0")
    return read_normal_points("\n".join([head, *WEATHER, *RANGES]), "a.npt")


@pytest.mark.parametrize(
    "records",
    [
        [*WEATHER, *RANGES],
        [*RANGES, *WEATHER],
        [WEATHER[0], *RANGES[:2], WEATHER[1], *RANGES[2:]],
        [RANGES[0], WEATHER[1], RANGES[1], RANGES[2], WEATHER[0], RANGES[3]],
    ],
    ids=["weather first", "ranges first", "in order", "mixed"],
)
def test_a_pass_over_midnight_has_its_days_in_any_order_of_records(records: list[str]) -> None:
    head = CRD_HEAD.format(start="2016 2 14 23 50 0")
    points = read_normal_points("\n".join([head, *records]), "a.npt")
    # transmission, and half of 0.04 s later the light is at the object
    utc = ["2016-02-14T23:55:00.020", "2016-02-14T23:59:10.020", "2016-02-15T00:00:30.020", "2016-02-15T00:08:20.020"]
    assert [Time(*tai.to_jd_parts(int(t)), format="jd", scale="tai").utc.isot for t in points.t_tai_ns] == utc
    # at 00:00:30 the record of 23:53:20 is nearer than that of 00:10:00
    assert points.pressure_hpa.tolist() == [983.7, 983.7, 983.7, 982.0]


def test_weather_before_midnight_belongs_to_a_pass_that_starts_after_it() -> None:
    head = CRD_HEAD.format(start="2016 2 15 0 0 10")
    points = read_normal_points("\n".join([head, WEATHER[0], *RANGES[2:], "20 43200.0 982.0 300.0 25 0"]), "a.npt")
    assert points.pressure_hpa.tolist() == [983.7, 983.7]
    assert Time(*tai.to_jd_parts(int(points.t_tai_ns[0])), format="jd", scale="tai").utc.isot == "2016-02-15T00:00:30.020"


def test_zenith_delay_is_that_of_the_conventions() -> None:
    # IERS Conventions (2010), the test case of FCULZD_HPA: McDonald, 798.4188 hPa, 14.322 hPa of vapour, 0.532 um
    found = zenith_delay_m(
        np.array([798.4188]), np.array([14.322]), np.array([0.532]), np.radians(np.array([30.67166667])), np.array([2010.344])
    )
    assert found[0] == pytest.approx(1.935225, abs=1e-4)


def test_directions_see_where_light_had_left() -> None:
    state = circle()[None]
    observer = np.array([[0.0, 7000.0, 0.0]])
    line, rho, delay = retarded(state, observer)
    earlier = propagate(state[0], T0, np.array([T0 - round(delay[0] * 1e9)]), ForceModel()).states[0, :3]
    np.testing.assert_allclose(line[0] + observer[0], earlier, atol=0.01 * METRE)
    assert rho[0] == pytest.approx(delay[0] * 299_792.458)


def observed(rng: np.random.Generator, truth: np.ndarray, forces: ForceModel, hours: float, sigma_arcsec: float) -> Directions:
    """Directions every ten minutes from a low circular orbit."""
    t = T0 + (np.arange(0.0, hours * 3600.0, 600.0) * 1e9).astype(np.int64)
    angle = (t - T0) * 1e-9 * 1.06e-3
    observer = 7078.0 * np.column_stack([np.cos(angle), np.zeros(len(t)), np.sin(angle)])
    line, rho, _ = retarded(propagate(truth, T0, t, forces).states, observer)
    unit = line / rho[:, None]
    first = np.cross(unit, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(unit, first)], axis=1)
    sigma = np.radians(sigma_arcsec / 3600.0)
    noise = sigma * rng.standard_normal((len(t), 2))
    seen = unit + np.einsum("nij,ni->nj", axes, noise)
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    covariance = np.tile(sigma**2 * np.eye(2), (len(t), 1, 1))
    return Directions(t_tai_ns=t, observer_km=observer, direction=seen, axes=axes, covariance_rad2=covariance)


def test_orbits_from_angles_have_the_errors_they_state() -> None:
    rng = np.random.default_rng(7)
    forces = ForceModel(gravity_degree=4, tides=False, relativity=False)
    nees = []
    for _ in range(40):
        data = observed(rng, circle(), forces, 8.0, 1.0)
        found = fit(circle() + np.array([5.0, -3.0, 2.0, 1e-3, 0.0, -1e-3]), T0, [data], forces)
        away = found.state - circle()
        nees.append(away @ np.linalg.solve(found.covariance, away) / 6.0)
        assert found.converged
    # 40 draws of six: one sigma of the mean is 0.09
    assert np.mean(nees) == pytest.approx(1.0, abs=0.27)


def test_outliers_lose_their_weight_and_a_manoeuvre_is_flagged() -> None:
    rng = np.random.default_rng(8)
    forces = ForceModel(gravity_degree=4, tides=False, relativity=False)
    data = observed(rng, circle(), forces, 10.0, 1.0)
    wrong = data.direction.copy()
    wrong[[7, 30]] += 3e-4 * data.axes[[7, 30], 0]
    spoiled = Directions(
        t_tai_ns=data.t_tai_ns, observer_km=data.observer_km, direction=wrong, axes=data.axes,
        covariance_rad2=data.covariance_rad2,
    )  # fmt: skip
    found = fit(circle(), T0, [spoiled], forces)
    assert not found.manoeuvre
    assert (found.weights == 0.0).sum() == 2
    assert np.linalg.norm((found.state - circle())[:3]) < 5.0 * np.sqrt(np.trace(found.covariance[:3, :3]))
    # after five hours another orbit: 1 m/s
    later = circle()
    half = propagate(later, T0, data.t_tai_ns[30:31], forces).states[0] + np.array([0, 0, 0, 0, 1e-3, 0])
    second = propagate(half, int(data.t_tai_ns[30]), data.t_tai_ns[30:], forces).states
    places = np.vstack([propagate(later, T0, data.t_tai_ns[:30], forces).states, second])[:, :3]
    burnt = Positions(t_tai_ns=data.t_tai_ns, position_km=places, sigma_km=np.full(len(places), 0.05))
    assert fit(circle(), T0, [burnt], forces).manoeuvre


def test_what_is_considered_widens_the_covariance() -> None:
    rng = np.random.default_rng(9)
    forces = ForceModel(gravity_degree=4, tides=False, relativity=False, radiation=0.02)
    data = observed(rng, circle(), forces, 30.0, 1.0)
    plain = fit(circle(), T0, [data], forces)
    doubted = fit(circle(), T0, [data], forces, (), FitOptions(considered=(("radiation", 0.02),)))
    estimated = fit(circle(), T0, [data], forces, ("radiation",))
    ratio = np.diag(doubted.covariance) / np.diag(plain.covariance)
    assert (ratio > 1.0).all()
    assert ratio.max() > 1.5
    assert estimated.covariance.shape == (7, 7)
    assert estimated.forces.radiation == pytest.approx(0.02, abs=4.0 * np.sqrt(estimated.covariance[6, 6]))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: read_sp3(b"nothing", "a.sp3"), "a.sp3: not an SP3 file"),
        (lambda: read_sp3(b"\x1f\x9d\xff123", "a.Z"), "codes of 31 bits"),
        (lambda: read_sp3(b"#cP2015\n%c M  cc UTC ccc\n", "a.sp3"), 'time system "UTC" is not read'),
        (lambda: read_sp3(b"#cP2015\n%c M  cc GPS ccc\n*  2015  5 xx\n", "a.sp3"), "line 3: expected an epoch"),
        (lambda: read_sp3(b"#cP2015\n%c M  cc GPS ccc\n", "a.sp3"), "no places"),
        (lambda: read_cpf("H1 CRD", "a.cpf"), "not a CPF file"),
        (
            lambda: read_cpf("H1 CPF 1 X 2016 2 13 2 1 one\n10 0 57431 0.0 0 7049498.1", "a.cpf"),
            "line 2: expected a record",
        ),
        (lambda: read_normal_points("h1 CRD", "a.npt"), "no normal points"),
        (lambda: read_normal_points(RANGES[0], "a.npt"), r"a.npt, line 1: record 11 before the start of a pass \(h4\)"),
        (lambda: read_normal_points(f"h1 CRD\n{WEATHER[0]}", "a.npt"), "line 2: record 20 before the start"),
        (
            lambda: read_normal_points(f"h4 1 2016 2 14 23 50 0 2016 2 15 0 20 0 0 0 0 0 1 0 2 0\n{RANGES[0]}", "a.npt"),
            r"line 2: record 11 before the wavelength \(c0\)",
        ),
        (lambda: pass_of("1 0 0 1 0 2"), r"a.npt, line 2: ranges without a correction for the troposphere's delay .* got 1"),
        (lambda: pass_of("0 1 0 1 0 2"), r"a.npt, line 2: ranges without a correction for the centre of mass .* got 1"),
        (lambda: pass_of("0 0 0 1 0 1"), r"a.npt, line 2: two-way ranges are read \(type 2\), got type 1"),
        (lambda: fit(circle(), T0, [], ForceModel()), "no measurements"),
        (lambda: fit(circle(), T0, [], ForceModel(), ("colour",)), 'parameter "colour" is not known'),
        (lambda: ForceModel(gravity_degree=100), "gravity_degree: expected 2 to 70"),
        (lambda: propagate(circle(), T0, np.array([T0 + 500 * tai.NS_PER_DAY]), ForceModel()), "more than 400 days"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(call, words: str) -> None:
    with pytest.raises(UserError, match=words):
        call()


def test_few_directions_do_not_determine_an_orbit() -> None:
    data = observed(np.random.default_rng(1), circle(), ForceModel(), 0.3, 1.0)
    with pytest.raises(UserError, match="do not determine the orbit"):
        fit(circle(), T0, [data], ForceModel(gravity_degree=4))


def test_a_fine_grid_through_an_ephemeris(navigation: dict[str, Ephemeris]) -> None:
    orbit = orbit_of(navigation["G05"])
    steps = np.searchsorted(orbit.t_tai_ns, navigation["G05"].t_tai_ns)
    expected = navigation["G05"].positions(1.0).position_km
    assert np.abs(orbit.position_km[steps] - expected).max() < 0.5 * METRE


def table_of(states: np.ndarray, t: np.ndarray) -> Ephemeris:
    """States (n, 6) in GCRS axes as an Earth-fixed table."""
    return Ephemeris(name="G77", t_tai_ns=t, itrs_km=np.einsum("nji,nj->ni", itrs_to_gcrs(t), states[:, :3]))


@pytest.mark.parametrize(("share", "burn_km_s"), [(0.9, 1e-2), (0.9, 1e-4), (0.985, 1e-2)])
def test_a_burn_near_the_end_of_a_table_is_refused(share: float, burn_km_s: float) -> None:
    t = T0 + 300 * tai.NS_PER_S * np.arange(288)
    states = propagate(circle(), T0, t, ForceModel()).states
    k = round(share * len(t))
    push = np.concatenate([np.zeros(3), burn_km_s * states[k, 3:] / np.linalg.norm(states[k, 3:])])
    states[k:] = propagate(states[k] + push, int(t[k]), t[k:], ForceModel()).states
    with pytest.raises(UserError, match=r"G77: no free orbit fits the places: .* a manoeuvre, or too large errors"):
        orbit_of(table_of(states, t))


def test_a_lone_bad_epoch_does_not_cost_the_orbit() -> None:
    t = T0 + 300 * tai.NS_PER_S * np.arange(288)
    truth = propagate(circle(), T0, t, ForceModel()).states
    spoiled = truth.copy()
    spoiled[100, 0] += 100.0 * METRE
    solution = free_orbit(table_of(spoiled, t), ForceModel())
    assert np.linalg.norm(solution.state - truth[0]) < 0.1 * METRE


def test_uncompressed_data_pass_as_they_are(tmp_path: Path) -> None:
    assert uncompressed(b"plain", "x") == b"plain"
