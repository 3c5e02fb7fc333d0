"""A scenario flown at several hours, from pixels to a catalogue that is held against the truth; and its parts."""

from collections.abc import Sequence
from pathlib import Path

import erfa
import numpy as np
import pytest
from astropy.table import Table
from scipy.integrate import solve_ivp

from sboc_e2e import scenario
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.against_truth import CatalogueScore, Place, Scored, nees_of
from sboc_e2e.objects.direction_errors import errors_of
from sboc_e2e.objects.visits import visits_of
from sboc_e2e.registry import Registry
from simulator.platform import all_forces, earth
from simulator.platform.ephemeris import moon_position_km
from simulator.platform.observer import make_observer
from simulator.scene.sources import OrbitOptions, orbiting

EPOCH = "2027-01-29T00:00:00"
# a few pixels in the middle of the detector: quick to set up
MIDDLE = tuple(f"sensor.window.{key}={n}" for key, n in (("rows", 64), ("cols", 64), ("row0", 2016), ("col0", 2016)))


def test_all_forces_are_those_of_equations_written_anew() -> None:
    """Two days of a high orbit: oblateness and third bodies by formulas of the book; the rest is below 2 km."""
    t0 = earth.tai_ns_of_utc(EPOCH)
    state = np.array([42_164.0, 0.0, 0.0, 0.0, 3.0, 0.6])

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        now, r = t0 + round(t * 1e9), y[:3]
        size = np.linalg.norm(r)
        pull = -earth.MU_KM3_S2 * r / size**3
        z2 = 5.0 * (r[2] / size) ** 2
        oblate = -1.5 * earth.J2 * earth.MU_KM3_S2 * earth.EARTH_RADIUS_KM**2 / size**5
        pull += oblate * r * np.array([1.0 - z2, 1.0 - z2, 3.0 - z2])
        for mu, body in ((1.32712440018e11, earth.sun_position_km(now)), (4902.800066, moon_position_km(now))):
            away = body - r
            pull += mu * (away / np.linalg.norm(away) ** 3 - body / np.linalg.norm(body) ** 3)
        return np.concatenate([y[3:], pull])

    day = 86_400.0
    for end_s in (2.0 * day, -2.0 * day):
        found = solve_ivp(slope, (0.0, end_s), state, method="DOP853", rtol=1e-9, atol=1e-6).y[:3, -1]
        places = all_forces.motion(state, t0, 0.0)(np.array([end_s]))
        assert np.linalg.norm(places[0] - found) < 2.0
        # without Sun and Moon it is tens of kilometres off
        two = solve_ivp(lambda t, y: np.concatenate([y[3:], -earth.MU_KM3_S2 * y[:3] / np.linalg.norm(y[:3]) ** 3]), (0.0, end_s),
                        state, method="DOP853", rtol=1e-9, atol=1e-6).y[:3, -1]  # fmt: skip
        assert np.linalg.norm(two - found) > 20.0


def test_light_pushes_by_half_of_it_times_the_square_of_time() -> None:
    t0, t = earth.tai_ns_of_utc(EPOCH), np.array([7200.0])
    state = np.array([42_164.0, 0.0, 0.0, 0.0, 3.0747, 0.0])
    away = all_forces.motion(state, t0, 1.0)(t)[0] - all_forces.motion(state, t0, 0.0)(t)[0]
    sun = earth.sun_position_km(t0)
    distance_au = np.linalg.norm(sun) / 149_597_870.7
    expected_km = 0.5 * 4.56e-9 / distance_au**2 * 7200.0**2
    assert -away @ sun / np.linalg.norm(sun) == pytest.approx(expected_km, rel=0.1)


def test_an_orbit_with_an_epoch_of_its_own_is_the_same_in_every_run() -> None:
    epoch = earth.tai_ns_of_utc(EPOCH)
    orbit = OrbitOptions(name="x", semi_major_axis_km=42_164.0, inclination_deg=5.0, epoch_utc=EPOCH, forces="all")
    first, later = orbiting(orbit, epoch), orbiting(orbit, epoch + 86_400 * 10**9)
    t = np.array([-100.0, 0.0, 33.3])
    assert np.allclose(first.positions_km(t + 86_400.0), later.positions_km(t), atol=1e-6)
    with pytest.raises(UserError, match="epoch_utc: 100 days from the run; allowed are up to 60"):
        orbiting(orbit, epoch + 100 * 86_400 * 10**9)


def test_visits_fly_one_orbit_and_look_at_one_place_of_the_ring() -> None:
    found = scenario.load("geo_survey", registry=Registry(), overrides=MIDDLE)
    hours = [0.0, 0.5, 23.9345]
    visits, orbits = visits_of(found, hours, Registry())
    assert [o.name for o in orbits] == ["geo-1", "geo-2", "geo-3", "geo-4"]
    assert len({o.area_to_mass_m2_kg for o in orbits}) == 4
    first = visits[0].simulator
    assert (first.pointing.ra_deg, first.pointing.dec_deg) == pytest.approx((131.5, 2.5), abs=1e-9)
    epoch = earth.tai_ns_of_utc(first.epoch_utc)
    places = []
    for hour, visit in zip(hours, visits, strict=True):
        start = earth.tai_ns_of_utc(visit.simulator.epoch_utc)
        assert start == epoch + round(hour * 3.6e12)
        # the same revolution goes on
        expected = make_observer(found.simulator.platform, epoch).state(start)[0]
        observer = make_observer(visit.simulator.platform, start)
        assert np.allclose(observer.state(start)[0], expected, atol=1e-5)
        middle = start + 15 * 10**9
        ra, dec = np.radians([visit.simulator.pointing.ra_deg, visit.simulator.pointing.dec_deg])
        line = np.array(erfa.s2c(ra, dec))
        here = observer.state(middle)[0]
        along = -here @ line + np.sqrt((here @ line) ** 2 + 42_164.0**2 - here @ here)
        places.append(earth.itrs_from_gcrs(middle) @ (here + along * line))
    # in Earth-fixed axes the point rests but for the pole: that of 2027 is 0.15 deg, 110 km of the ring, from that of the axes
    assert np.allclose(places, places[0], atol=110.0)
    assert len({v.seed for v in visits}) == 3


@pytest.mark.parametrize(
    ("overrides", "hours", "words"),
    [
        (("pointing.law=anti_sun",), [0.0, 1.0], 'pointing.law: visits need "inertial", not "anti_sun"'),
        ((), [1.0, 0.5], "--visit: expected rising hours from 0 to 720, got 1, 0.5"),
        (("objects.passing=[]",), [0.0, 1.0], "objects: visits need objects.passing or objects.orbit"),
    ],
)
def test_what_cannot_be_flown_is_refused(overrides: Sequence[str], hours: list[float], words: str) -> None:
    found = scenario.load("geo_survey", registry=Registry(), overrides=(*MIDDLE, *overrides))
    with pytest.raises(UserError, match=words.replace("[", r"\[").replace(".", r"\.")):
        visits_of(found, hours, Registry())


def test_rows_of_one_fit_hold_no_more_than_the_fit(tmp_path: Path) -> None:
    """Twenty points of a fitted parabola, stated as the projection does, give back the error of the points behind it."""
    n, sigma = 20, 0.7
    t = np.linspace(-1.0, 1.0, n)
    design = np.linalg.qr(np.vander(t, 3))[0]
    shared = sigma * design
    table = Table({
        "tracklet_id": np.zeros(n, dtype=int), "epoch_tai_ns": np.arange(n), "sigma_along_arcsec": np.linalg.norm(shared, axis=1),
        "sigma_cross_arcsec": np.full(n, 0.3), "motion_angle_deg": np.full(n, 90.0), "shared_group": np.zeros(n, dtype=int),
        **{f"shared_{k + 1}_arcsec": shared[:, k] for k in range(3)},
    })  # fmt: skip
    table.write(tmp_path / "tdm_angles.ecsv", format="ascii.ecsv")
    errors = errors_of(tmp_path / "tdm_angles.ecsv")[0]
    assert np.allclose(errors, np.column_stack([np.full(n, sigma), np.full(n, 0.3), np.full(n, np.pi / 2.0)]))
    # members of one line: three numbers across as well, of all rows whatever their group
    for k in range(3):
        table[f"shared_cross_{k + 1}_arcsec"] = shared[:, k] * (0.3 / np.linalg.norm(shared, axis=1))
    table.write(tmp_path / "tdm_angles.ecsv", format="ascii.ecsv", overwrite=True)
    on_line = errors_of(tmp_path / "tdm_angles.ecsv")[0]
    assert np.allclose(on_line[:, 1], np.sqrt(n * 0.3**2 / 3.0))
    assert np.allclose(on_line[:, [0, 2]], errors[:, [0, 2]])
    table.remove_column("shared_group")
    table.write(tmp_path / "tdm_angles.ecsv", format="ascii.ecsv", overwrite=True)
    with pytest.raises(UserError, match="without the columns shared_group"):
        errors_of(tmp_path / "tdm_angles.ecsv")
    assert errors_of(tmp_path / "none.ecsv") == {}


def test_figures_of_a_catalogue_count_objects_tracklets_and_errors() -> None:
    good = Place(error_km=1.0, sigma_km=1.0, nees=1.0)
    rows = tuple(
        Scored(name=name, expected=expected, tracklets=tracklets, catalogued=entry, right=right, wrong=wrong, at_epoch=place,
               a_day_on=place)
        for name, expected, tracklets, entry, right, wrong, place in (
            ("a", 4, 4, "U1", 4, 0, good), ("b", 4, 3, "U2", 3, 1, good),
            ("c", 2, 2, "", 0, 0, None), ("d", 1, 1, "", 0, 0, None),
        )
    )  # fmt: skip
    figures = CatalogueScore(objects=rows, false_tracklets=1, false_objects=0, accepted=8, accepted_right=7).as_json()
    assert (figures["tracklets"]["value"], figures["tracklets"]["n"]) == (10 / 11, 11)
    # the object that was in the field only once cannot be catalogued
    assert (figures["objects"]["value"], figures["objects"]["n"]) == (2 / 3, 3)
    assert figures["purity"]["value"] == 7 / 8
    assert figures["at_epoch"]["nees"] == 1.0
    # chi2 of six degrees of freedom: 1.237 and 14.449 (tables)
    assert nees_of([1.0, 1.0])["honest_low"] == pytest.approx(1.237 / 6.0, rel=1e-3)
    assert nees_of([1.0, 1.0])["honest_high"] == pytest.approx(14.449 / 6.0, rel=1e-3)
