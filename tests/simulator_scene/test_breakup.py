"""NASA's standard break-up model against its published laws, mass against what broke; constellations; mean orbits."""

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from sgp4.api import WGS72, Satrec
from sgp4.exporter import export_tle

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from simulator.chain import Simulator
from simulator.options import SimulatorOptions, smoke_options
from simulator.platform.earth import LIGHT_KM_S, MU_KM3_S2, tai_ns_of_utc
from simulator.platform.kepler import elements_deg, elements_of, state_of
from simulator.platform.orbit_motion import OrbitMotion
from simulator.scene.breakup import BreakupOptions, draw_chi, draw_pieces, draw_speed_m_s, mixture_of, number_larger
from simulator.scene.encounters import PopulationOptions
from simulator.scene.fleet import Fleet, make_fleet
from simulator.scene.satellites import SatelliteOptions, gcrs_from_teme
from simulator.scene.sources import ObjectOptions, OrbitOptions, orbiting
from simulator.scene.walker import WalkerOptions, walker_elements

COLLISION = BreakupOptions(object="x", cause="collision", mass_kg=950.0, projectile_kg=10.0, impact_km_s=10.0, smallest_mm=10.0)
EXPLOSION = BreakupOptions(object="x", mass_kg=800.0, structure="rocket_body", smallest_mm=10.0)
CRATER = BreakupOptions(object="x", cause="collision", projectile_kg=0.1, impact_km_s=5.0, smallest_mm=5.0)


def test_numbers_are_those_of_johnson_2001() -> None:
    # equations 2 and 4: N(> Lc) = 6 S Lc^-1.6 and 0.1 M^0.75 Lc^-1.71
    assert number_larger(EXPLOSION, 0.1) == pytest.approx(238.9, abs=0.1)
    assert number_larger(replace(EXPLOSION, factor=0.5), 1.0) == pytest.approx(3.0)
    both = replace(COLLISION, projectile_kg=1e-6, impact_km_s=20.0, mass_kg=950.0)
    # 40 J/g divides: 200 J on 950 kg only makes a crater of m v^2 (Krisko 2011), 5e5 kJ breaks all 960 kg
    assert number_larger(both, 0.1) == pytest.approx(0.1 * (1e-6 * 400.0) ** 0.75 * 0.1**-1.71)
    assert number_larger(COLLISION, np.array([0.1, 0.01, 0.001])) == pytest.approx([884.5, 45_363.0, 2_326_500.0], rel=1e-3)


@pytest.mark.parametrize("options", [COLLISION, EXPLOSION, CRATER])
def test_mass_is_conserved_and_the_law_of_numbers_kept(options: BreakupOptions) -> None:
    broken = {"x": 0.0}
    for seed in range(4):
        pieces = draw_pieces(options, np.random.default_rng(seed))
        total = options.mass_kg if options is EXPLOSION else 960.0 if options is COLLISION else 0.1 * 25.0
        assert pieces.mass_kg.sum() + pieces.dust_kg == pytest.approx(total, rel=1e-9)
        assert (pieces.mass_kg > 0.0).all()
        smaller = pieces.length_m < 1.0
        for length in (0.02, 0.05, 0.2):
            expected = float(number_larger(options, length) - number_larger(options, 1.0))
            broken["x"] += (np.sum(smaller & (pieces.length_m > length)) - expected) / np.sqrt(max(expected, 1.0))
        assert pieces.kick_m_s.mean(axis=0) == pytest.approx(
            np.zeros(3), abs=5.0 * pieces.kick_m_s.std() / np.sqrt(smaller.sum())
        )
    # twelve differences in sigmas, correlated by three
    assert abs(broken["x"]) / 12.0 < 1.5


@pytest.mark.parametrize("mass_kg", [800.0, 1e4, 1e5, 1e6])
@pytest.mark.parametrize("cause", ["explosion", "collision"])
@pytest.mark.parametrize("structure", ["spacecraft", "rocket_body"])
def test_no_piece_of_a_heavy_parent_is_longer_than_the_parent(mass_kg: float, cause: str, structure: str) -> None:
    """What 400 pieces left over became one piece of up to 750 m."""
    options = BreakupOptions(object="x", mass_kg=mass_kg, cause=cause, structure=structure, projectile_kg=0.02 * mass_kg)
    pieces = draw_pieces(options, np.random.default_rng(3))
    # a cube of 100 kg/m^3
    assert pieces.length_m.max() <= (mass_kg / 100.0) ** (1.0 / 3.0)
    broken_kg = mass_kg * (1.0 if cause == "explosion" else 1.02)
    assert pieces.mass_kg.sum() + pieces.dust_kg == pytest.approx(broken_kg, rel=1e-9)
    assert pieces.mass_kg.max() < 0.5 * broken_kg
    if cause == "collision" and mass_kg > 1e4:
        # equation 4 of Johnson 2001 beyond its end: 0.1 M^0.75 pieces above 1 m, which the mass that is left bears out
        assert 0.3 < np.sum(pieces.length_m > 1.0) / float(number_larger(options, 1.0)) < 6.0


def test_area_over_mass_and_speed_have_the_published_medians() -> None:
    rng = np.random.default_rng(5)
    # equation 7 at 1 cm and 3 mm, the plateau of small objects: chi = -0.65 at Lc = 10^-1.5 m
    for length, mean, sigma in ((0.003, -0.3, 0.2 + 0.1333 * 0.9771), (10.0**-1.5, -0.65, 0.2 + 0.1333 * 2.0)):
        chi = draw_chi(rng, np.full(40_000, length), "spacecraft")
        assert chi.mean() == pytest.approx(mean, abs=4.0 * sigma / 200.0 + 1e-3)
        assert chi.std() == pytest.approx(sigma, rel=0.02)
    chi = np.full(40_000, -1.0)
    assert np.median(draw_speed_m_s(rng, chi, "collision")) == pytest.approx(100.0, rel=0.02)
    assert np.median(draw_speed_m_s(rng, chi, "explosion")) == pytest.approx(10.0**1.65, rel=0.02)


@pytest.mark.parametrize("structure", ["spacecraft", "rocket_body"])
def test_large_pieces_are_a_mixture_and_no_weighted_sum(structure: str) -> None:
    lam = np.log10(0.4)
    alpha, m1, s1, m2, s2 = (float(v) for v in mixture_of(np.array(lam), structure))
    chi = draw_chi(np.random.default_rng(2), np.full(60_000, 0.4), structure)
    mean = alpha * m1 + (1.0 - alpha) * m2
    variance = alpha * (s1**2 + m1**2) + (1.0 - alpha) * (s2**2 + m2**2) - mean**2
    assert chi.mean() == pytest.approx(mean, abs=4.0 * np.sqrt(variance / 60_000.0))
    assert chi.var() == pytest.approx(variance, rel=0.03)


def test_branches_meet_at_the_edges_of_the_published_tables() -> None:
    for structure in ("spacecraft", "rocket_body"):
        lam = np.linspace(-2.5, 1.0, 35_001)
        for values in mixture_of(lam, structure):
            assert np.abs(np.diff(values)).max() < 1e-3
    # Johnson et al. 2001, equations 5 and 6, at two lengths by hand
    assert [float(v) for v in mixture_of(np.array(-0.4), "spacecraft")] == pytest.approx([0.62, -0.8226, 0.28, -1.5999, 0.4])
    assert [float(v) for v in mixture_of(np.array(-0.4), "rocket_body")] == pytest.approx([0.6429, -0.54, 0.55, -0.9, 0.18184])


def test_too_many_pieces_and_unknown_objects_are_one_line() -> None:
    with pytest.raises(UserError, match=r"pieces above 1 mm; allowed are .* raise `smallest`"):
        draw_pieces(replace(COLLISION, smallest_mm=1.0), np.random.default_rng(1))
    with pytest.raises(UserError, match="no object 'x'; allowed are names"):
        make_fleet(ObjectOptions(passing=(), breakup=(COLLISION,)), PopulationOptions(), 0, 1, None)
    with pytest.raises(UserError, match="7 satellites do not fill 2 planes"):
        WalkerOptions(satellites=7, planes=2, phasing=1)


def test_nothing_breaks_up_twice_or_before_it_exists() -> None:
    first = BreakupOptions(object="x", when_h=2.0, smallest_mm=300.0)

    def fleet_of(second: BreakupOptions) -> Fleet:
        given = ObjectOptions(passing=(), orbit=(OrbitOptions(name="x"),), breakup=(first, second))
        return make_fleet(given, PopulationOptions(), 0, 1, None)

    for when_h in (1.0, 2.0, 5.0):
        with pytest.raises(UserError, match=r"objects\.breakup\[1\]\.object: 'x' breaks up in objects\.breakup\[0\] already"):
            fleet_of(replace(first, when_h=when_h))
    for when_h in (1.0, 2.0):
        with pytest.raises(
            UserError, match=rf"objects\.breakup\[1\]\.when: {when_h:g} h; 'x piece 1' comes from objects\.breakup\[0\] at 2 h"
        ):
            fleet_of(replace(first, object="x piece 1", when_h=when_h))
    later = fleet_of(replace(first, object="x piece 1", when_h=2.5))
    piece = later.names.index("x piece 1")
    assert (later.from_s[piece], later.to_s[piece]) == (7_200.0, 9_000.0)
    assert later.from_s[later.names.index("x piece 1 piece 1")] == 9_000.0


@pytest.mark.parametrize("eccentricity", [0.001, 0.1])
def test_mean_orbits_stay_with_integrated_ones(eccentricity: float) -> None:
    given = OrbitOptions(
        name="x", semi_major_axis_km=7500.0, eccentricity=eccentricity, inclination_deg=70.0, node_deg=10.0, perigee_deg=20.0,
        mean_anomaly_deg=30.0,
    )  # fmt: skip
    fleet = make_fleet(ObjectOptions(passing=(), orbit=(given,)), PopulationOptions(), 0, 1, None)
    time_s = np.array([0.0, 3_600.0, 86_400.0, 5 * 86_400.0, 20 * 86_400.0])
    motion = OrbitMotion(*state_of(elements_deg(7500.0, eccentricity, 70.0, 10.0, 20.0, 30.0)))
    apart = np.linalg.norm(fleet.states(np.array([0]), time_s)[0][0] - motion.states(time_s)[0], axis=1)
    # with the osculating axis instead of the mean one: 176 km after a day
    assert (apart < 30.0).all()


def test_an_orbit_of_another_epoch_is_where_the_pixel_chain_has_it() -> None:
    run = tai_ns_of_utc("2027-01-29T00:00:00")
    walker = WalkerOptions(satellites=2, planes=1, phasing=0)
    given = OrbitOptions(name="x", semi_major_axis_km=7_500.0, epoch_utc="2027-01-28T05:00:00")
    fleet = make_fleet(ObjectOptions(passing=(), walker=(walker,), orbit=(given,)), PopulationOptions(), run, 1, None)
    time_s = np.array([0.0, 3_600.0])
    apart = fleet.states(np.array([2]), time_s)[0][0] - orbiting(given, run).positions_km(time_s)
    # mean elements stay within 30 km of integrated ones; in 19 hours of another epoch the object is on another side of the Earth
    assert (np.linalg.norm(apart, axis=1) < 30.0).all()
    far = replace(given, epoch_utc="2026-01-01T00:00:00")
    with pytest.raises(UserError, match=r"objects\.orbit 'x': epoch_utc: 393 days from the run; allowed are up to 60"):
        make_fleet(ObjectOptions(passing=(), orbit=(far,)), PopulationOptions(), run, 1, None)


def test_a_walker_constellation_is_evenly_spaced() -> None:
    # Galileo's 56 deg: 24/3/1
    found = walker_elements(WalkerOptions(satellites=24, planes=3, phasing=1, altitude_km=23_222.0, inclination_deg=56.0))
    node, phase = np.degrees(found.node_rad).reshape(3, 8), np.degrees(found.mean_anomaly_rad).reshape(3, 8)
    assert np.ptp(node, axis=1) == pytest.approx(np.zeros(3))
    assert node[:, 0] == pytest.approx([0.0, 120.0, 240.0])
    assert np.diff(phase, axis=1) == pytest.approx(np.full((3, 7), 45.0))
    assert phase[:, 0] == pytest.approx([0.0, 15.0, 30.0])


def in_the_field(kind: str, folder: Path) -> tuple[SimulatorOptions, str]:
    """A run of six frames with an object, of an orbit or a catalogue, that crosses the middle of the field; its name."""
    options = replace(smoke_options(), population=PopulationOptions(classes=()), objects=ObjectOptions(passing=()))
    carrier = Simulator(options, seed=2, catalogue=StarCatalogue.embedded())._carrier
    middle = carrier.tai_ns(0.75)
    place, speed = carrier.observer.state(middle)
    place = place + 900.0 * carrier.attitude(middle)[2]
    sideways = np.cross(np.cross(place, speed + carrier.attitude(middle)[0]), place)
    speed = sideways / np.linalg.norm(sideways) * np.sqrt(MU_KM3_S2 / np.linalg.norm(place))
    turn = np.eye(3) if kind == "orbit" else gcrs_from_teme(middle)
    found = elements_of(place @ turn, speed @ turn)
    degrees = [float(np.degrees(v)) for v in (found.i_rad, found.node_rad, found.argp_rad)]
    e, motion = float(found.e), float(np.sqrt(MU_KM3_S2 / found.a_km**3))
    phase = float(found.mean_anomaly_rad - 0.75 * motion) % (2.0 * np.pi)
    if kind == "orbit":
        given = OrbitOptions(
            name="x", semi_major_axis_km=float(found.a_km), eccentricity=e, inclination_deg=degrees[0], node_deg=degrees[1],
            perigee_deg=degrees[2], mean_anomaly_deg=float(np.degrees(phase)), size_m=3.0,
        )  # fmt: skip
        return replace(options, objects=ObjectOptions(passing=(), orbit=(given,))), "x"
    record = Satrec()
    days = (datetime.fromisoformat(options.epoch_utc) - datetime(1949, 12, 31)) / timedelta(days=1)
    angles = [np.radians(v) for v in (degrees[2], degrees[0])]
    record.sgp4init(WGS72, "i", 90_001, days, 0.0, 0.0, 0.0, e, *angles, phase, motion * 60.0, np.radians(degrees[1]))
    record.classification, record.intldesg, record.elnum, record.revnum, record.ephtype = "U", "20001A", 1, 1, 0
    (folder / "x.3le").write_text("0 x\n" + "\n".join(export_tle(record)) + "\n")
    satellites = SatelliteOptions(file=str(folder / "x.3le"), farthest_km=5_000.0)
    return replace(options, objects=ObjectOptions(passing=(), satellites=satellites)), "x"


@pytest.mark.parametrize("kind", ["orbit", "satellite"])
def test_a_break_up_within_a_run_ends_the_parent_and_begins_the_pieces(kind: str, tmp_path: Path) -> None:
    """Pieces were drawn from the first frame on or not at all, and the parent to the last."""
    options, name = in_the_field(kind, tmp_path)
    catalogue = StarCatalogue.embedded()
    whole = [Simulator(options, seed=2, catalogue=catalogue).frame(k)[1].streaks for k in range(6)]
    assert [len(rows) for rows in whole] == [1] * 6
    unbroken = whole[3][0]
    middle_tai_ns = (unbroken["t0_tai_ns"] + unbroken["t1_tai_ns"]) / 2
    delay_s = float(unbroken["range_km"]) / LIGHT_KM_S
    when_s = (middle_tai_ns - tai_ns_of_utc(options.epoch_utc)) * 1e-9 - delay_s
    breakup = BreakupOptions(object=name, when_h=when_s / 3600.0, smallest_mm=300.0)
    run = Simulator(replace(options, objects=replace(options.objects, breakup=(breakup,))), seed=2, catalogue=catalogue)
    names = [thing.identity.name for thing in run._cast.objects]
    assert names.count(name) == 1
    pieces = 0
    for k in range(6):
        streaks = run.frame(k)[1].streaks
        parents = streaks[streaks["object_id"] == names.index(name)]
        others = streaks[streaks["object_id"] != names.index(name)]
        assert len(parents) == (1 if k <= 3 else 0)
        assert (len(others) > 20) == (k >= 3)
        assert k >= 3 or len(others) == 0
        if k == 3:
            (parent,) = parents
            # the news travels with the light; whole nanoseconds of 1.8e18 are 256 in a double
            assert parent["t0_tai_ns"] == unbroken["t0_tai_ns"]
            assert parent["t1_tai_ns"] == pytest.approx(middle_tai_ns, rel=0.0, abs=2_000)
            assert others["t0_tai_ns"] - parent["t1_tai_ns"] == pytest.approx(np.zeros(len(others)), abs=2_000)
            assert parent["flux_e"] == pytest.approx(0.5 * unbroken["flux_e"], rel=0.01)
            assert others["row0"] == pytest.approx(np.full(len(others), parent["row1"]), abs=0.01)
            assert others["col0"] == pytest.approx(np.full(len(others), parent["col1"]), abs=0.01)
        pieces = max(pieces, len(others))
    assert pieces == len(names) - 1
