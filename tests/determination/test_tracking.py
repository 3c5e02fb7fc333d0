"""Real tracking of Eutelsat W3B in its transfer orbit against the solution that Orekit publishes; station axes and air delays."""

import re
from pathlib import Path

import erfa
import numpy as np
import pytest
from astropy.time import Time

from ground.determination.batch import FitOptions, Solution, fit
from ground.determination.forces import LEAK_RATES, LEAKS, ForceModel
from ground.determination.measurements import Offset, Positions
from ground.determination.propagation import itrs_to_gcrs, propagate
from ground.determination.tracking import Station, directions_of, radio_delay_km, refraction_rad, two_way_ranges
from sboc_e2e.icd import tai
from tests.conjunctions.reference import folder

pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

SIGMA_RAD, SIGMA_KM = np.radians(0.02), 0.02
TRANSPONDER_KM = 5.969
AREA_KG = 13.12 / 1000.0
"""The line of the set-up that states 5,370 kg is a comment; Orekit then takes 1,000 kg."""
# Orekit's NumericalOrbitDeterminationTest.testW3B: EME2000, m and m/s; azimuth, elevation (deg) and range (m) of each station
POSITION_M, VELOCITY_M_S = np.array([-40541446.236, -9905357.943, 206777.082]), np.array([759.0685, -1476.5156, 54.7931])
BIASES = {
    "CastleRock": (0.062701342, -0.003613508, 11274.4195),
    "Fucino": (-0.053526137, 0.075483886, 13467.8361),
    "Kumsan": (-0.023574208, -0.054520756, 13512.4898),
    "Pretoria": (0.030201539, 0.009747877, 13594.1758),
    "Uralla": (0.167814449, -0.12305252, 13450.2320),
}
SPREAD = {"azimuth_deg": 0.010063041, "elevation_deg": 0.011604931, "range_m": 4.374712716}
LEAK, LEAK_RATE = 8.005e-6, 3.060e-10


def epoch(text: str) -> int:
    when = Time(text, scale="utc").tai
    whole = round((when.jd1 - tai.EPOCH_JD) * 86400.0)
    return whole * tai.NS_PER_S + round(when.jd2 * 86400.0 * tai.NS_PER_S)


def stations(text: str) -> dict[str, tuple[Station, float]]:
    """Stations and the ranges (km) that their equipment adds, of Orekit's set-up."""
    rows: dict[str, dict[str, str]] = {}
    for key, number, value in re.findall(r"^ground\.station\.(\S+)\s*\[(\d)\]\s*=\s*(\S+)", text, re.MULTILINE):
        rows.setdefault(number, {})[key] = value
    return {
        row["name"]: (
            Station(
                latitude_rad=np.radians(float(row["latitude"])),
                longitude_rad=np.radians(float(row["longitude"])),
                height_km=1e-3 * float(row["altitude"]),
            ),
            1e-3 * float(row["range.bias"]),
        )
        for row in rows.values()
    }


def tracking(path: Path) -> dict[str, dict[str, list[list[str]]]]:
    """Lines of the file by station and kind."""
    out: dict[str, dict[str, list[list[str]]]] = {}
    for line in path.read_text().splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            out.setdefault(words[2], {}).setdefault(words[1], []).append(words)
    return out


class Fit:
    """The orbit of W3B with the stations' biases, by fits of ever more parameters."""

    def __init__(self, root: Path) -> None:
        self.seen = tracking(root / "W3B.aer")
        self.stations = stations((root / "od_test_W3.in").read_text())
        bias_matrix, _, _ = erfa.bp06(2451545.0, 0.0)
        self.to_eme = np.asarray(bias_matrix)
        start = np.array([[-40517.5229, -10003.0799, 166.7928], [0.762559, -1.474468, 0.055430]])
        self.state = (start @ self.to_eme).reshape(-1)
        self.t0 = epoch("2010-11-02T02:56:15.690")
        self.forces = ForceModel(gravity_degree=20, tides=False, relativity=False, radiation=2.0 * AREA_KG)
        self.angle_bias = {name: np.zeros(2) for name in self.stations}
        self.range_bias_m: dict[str, float] = {}
        for parameters in (None, (), LEAKS, (*LEAKS, *LEAK_RATES), ("drag", *LEAKS, *LEAK_RATES)):
            self.solution = self._step(parameters)

    def _step(self, parameters: tuple[str, ...] | None) -> Solution:
        """One fit; None: of the state alone, the ranges' biases as set up."""
        angles, ranges = {}, {}
        for name, (station, added_km) in self.stations.items():
            t, one, two = self._columns(name, "AZ_EL")
            azimuth, elevation = np.radians(one) - self.angle_bias[name][0], np.radians(two) - self.angle_bias[name][1]
            angles[name] = directions_of(t, azimuth, elevation, (SIGMA_RAD, SIGMA_RAD), station)
            t, distance, _ = self._columns(name, "RANGE")
            places = propagate(self.state, self.t0, t, self.forces).states[:, :3]
            known = TRANSPONDER_KM + added_km
            ranges[name] = two_way_ranges(t, distance, known, SIGMA_KM, places, station)
        if parameters is None:
            parameters = ()
            data = [*angles.values(), *ranges.values()]
        else:
            data = [Offset(kind=d, unit=(SIGMA_RAD, SIGMA_RAD)) for d in angles.values()]
            data += [Offset(kind=d, unit=(SIGMA_KM,)) for d in ranges.values()]
        choice = FitOptions(huber_sigma=1e6, reject_sigma=1e7, prior=(("drag", 3.0 * AREA_KG),))
        solution = fit(self.state, self.t0, data, self.forces, parameters, choice)
        self.state, self.forces = solution.state, solution.forces
        self.left: dict[str, list[np.ndarray]] = {"azimuth_deg": [], "elevation_deg": [], "range_m": []}
        for name in self.stations:
            shift = self._offset(angles[name], (SIGMA_RAD, SIGMA_RAD))
            self.angle_bias[name] += shift
            self.range_bias_m[name] = 1e3 * float(self._offset(ranges[name], (SIGMA_KM,))[0] - TRANSPONDER_KM)
        return solution

    def _columns(self, name: str, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = self.seen[name][kind]
        t = np.array([epoch(row[0]) for row in rows], dtype=np.int64)
        return t, np.array([float(row[3]) for row in rows]), np.array([float(row[-1]) for row in rows])

    def _offset(self, kind: object, unit: tuple[float, ...]) -> np.ndarray:
        """Offsets of one station; the residuals about them are kept."""
        whole = Offset(kind=kind, unit=unit)
        states = propagate(self.state, self.t0, whole.t_tai_ns, self.forces).states
        value, slope = whole.residuals(states)
        left = whole.eliminated(value, slope)[0] * np.array(unit)
        for column, (key, scale) in enumerate(
            (("azimuth_deg", np.degrees(1.0)), ("elevation_deg", np.degrees(1.0))) if len(unit) == 2 else (("range_m", 1e3),)
        ):
            self.left[key].append(scale * left[:, column])
        return whole.offsets(states)


@pytest.fixture(scope="module")
def w3b() -> Fit:
    return Fit(folder("w3b"))


def test_residuals_of_real_tracking_are_those_of_the_published_solution(w3b: Fit) -> None:
    assert w3b.solution.converged
    assert w3b.solution.chi2_nu < 1.0
    assert {key: sum(map(len, parts)) for key, parts in w3b.left.items()} == {
        "azimuth_deg": 339, "elevation_deg": 339, "range_m": 182,
    }  # fmt: skip
    for key, expected in SPREAD.items():
        assert np.concatenate(w3b.left[key]).std(ddof=1) == pytest.approx(expected, rel=0.02)


def test_biases_and_leak_of_real_tracking_are_near_the_published_ones(w3b: Fit) -> None:
    """Another model of refraction, drag and air delay: Orekit's own tolerances are 1e-5 deg and 0.1 m."""
    for name, (azimuth, elevation, distance_m) in BIASES.items():
        found = np.degrees(w3b.angle_bias[name])
        assert found[0] == pytest.approx(azimuth, abs=3e-4)
        assert found[1] == pytest.approx(elevation, abs=2e-3)
        assert w3b.range_bias_m[name] == pytest.approx(distance_m, abs=25.0)
    # formal errors along the worst axes: as large as the leak itself
    for names, expected in ((LEAKS, LEAK), (LEAK_RATES, LEAK_RATE)):
        size = np.linalg.norm([w3b.forces.value_of(name) for name in names])
        assert size == pytest.approx(expected, rel=0.1)
    state = w3b.state.reshape(2, 3) @ w3b.to_eme.T * 1e3
    away = np.concatenate([state[0] - POSITION_M, state[1] - VELOCITY_M_S])
    assert np.linalg.norm(away[:3]) < 100.0
    assert np.linalg.norm(away[3:]) < 0.03
    # within what the data say of it: half a sigma of each number
    assert (np.abs(away) < 0.5e3 * np.sqrt(np.diag(w3b.solution.covariance)[:6])).all()


def test_azimuth_and_elevation_point_where_the_object_is() -> None:
    t = np.array([1_700_000_000 * tai.NS_PER_S], dtype=np.int64)
    station = Station(latitude_rad=0.7, longitude_rad=0.2, height_km=0.5)
    place, (axes,) = station.frame(t)
    fixed = itrs_to_gcrs(t)[0].T @ place[0]
    assert 1e-3 * np.array(erfa.gd2gc(1, 0.2, 0.7, 500.0)) == pytest.approx(fixed, abs=1e-9)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    azimuth, elevation = 1.0, 0.6
    given = np.array([elevation + refraction_rad(np.array([elevation]), 0.5)[0]])
    found = directions_of(t, np.array([azimuth]), given, (1e-4, 1e-4), station)
    east, north, up = axes @ found.direction[0]
    assert np.arctan2(east, north) == pytest.approx(azimuth, abs=1e-9)
    assert np.arcsin(up) == pytest.approx(elevation, abs=1e-9)


def test_air_delays_are_of_the_known_size() -> None:
    # at zenith 2.3 to 2.5 m at sea level, and about ten times as much at 5 deg
    zenith, low = 1e3 * radio_delay_km(np.radians(np.array([90.0, 5.0])), 0.0)
    assert 2.3 < zenith < 2.5
    assert low / zenith == pytest.approx(10.2, abs=0.2)
    # half a degree at the horizon (Rec. ITU-R P.834: 0.5 to 0.8)
    assert 0.5 < np.degrees(refraction_rad(np.array([0.0]), 0.0)[0]) < 0.8


def test_offsets_are_eliminated_as_if_they_had_been_estimated() -> None:
    rng = np.random.default_rng(6)
    t0 = 1_700_000_000 * tai.NS_PER_S
    t = t0 + np.arange(40, dtype=np.int64) * 600 * tai.NS_PER_S
    truth = np.array([26_560.0, 0.0, 0.0, 0.0, 2.3, 3.0])
    forces = ForceModel(gravity_degree=4, tides=False, relativity=False)
    places = propagate(truth, t0, t, forces).states[:, :3]
    sigma = np.full(40, 0.01)
    near = Positions(t_tai_ns=t[:10], position_km=places[:10] + 0.01 * rng.normal(size=(10, 3)), sigma_km=sigma[:10])
    shifted = places + np.array([0.5, -0.3, 0.2]) + 0.01 * rng.normal(size=(40, 3))
    biased = Offset(kind=Positions(t_tai_ns=t, position_km=shifted, sigma_km=sigma), unit=(0.01, 0.01, 0.01))
    found = fit(truth + 0.1, t0, [near, biased], forces)
    away = found.state - truth
    # six numbers: one in a million is beyond 38
    assert away @ np.linalg.solve(found.covariance, away) < 38.0
    offsets = biased.offsets(propagate(found.state, t0, t, forces).states)
    assert offsets == pytest.approx([0.5, -0.3, 0.2], abs=0.05)


def test_a_leak_moves_an_orbit_by_half_of_it_times_the_square_of_time() -> None:
    t0, t = 1_700_000_000 * tai.NS_PER_S, np.array([1_700_003_600 * tai.NS_PER_S], dtype=np.int64)
    state = np.array([42_164.0, 0.0, 0.0, 0.0, 3.0747, 0.0])
    still = propagate(state, t0, t, ForceModel()).states[0]
    for name, moved_km in (("leak_z", 0.5 * 1e-8 * 3600.0**2), ("leak_z_rate", 1e-11 * 3600.0**3 / 6.0)):
        value = 1e-5 if name == "leak_z" else 1e-8
        away = propagate(state, t0, t, ForceModel().with_values((name,), (value,))).states[0] - still
        # gravity turns 1 percent of it back within the hour
        assert away[2] == pytest.approx(moved_km, rel=0.02)
        assert np.linalg.norm(away[:2]) < 1e-3 * moved_km
