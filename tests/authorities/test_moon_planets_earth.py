"""Moon, planets and Earth against JPL's DE440, published photometry, and closed forms."""

import datetime
import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import get_body
from astropy.time import Time

from simulator.optics.far_scatter import ARCSEC2_PER_SR, FarScatterOptions, veil_per_arcsec2
from simulator.platform import earth, ephemeris
from simulator.scene import bodies
from simulator.scene.aberration import aberrate
from simulator.scene.atmosphere import Atmosphere, AtmosphereOptions, clouds_of
from simulator.scene.earth_light import earth_light, earth_veil
from simulator.scene.reflection import SUN_V_MAG

EPOCHS = ("2024-03-10T06:00:00", "2026-08-28T04:13:00", "2027-01-29T00:00:00", "2027-07-18T18:30:00")
ARCSEC = math.pi / 648000.0
EARTH_OVER_MOON = 81.30056822
"""Masses of DE440 (Park et al. 2021, AJ 161, 105)."""


def angle(one, other) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), np.dot(one, other)))


@pytest.fixture(scope="module")
def jpl():
    """Barycentric places (km) of DE440 by name and seconds before an epoch."""
    data = find_spec("satkit_data")
    satkit = pytest.importorskip("satkit")
    if data is None or data.origin is None:
        pytest.skip("no satkit_data: no DE440")
    satkit.utils.set_offline(True)
    satkit.utils.add_search_dir(str(Path(data.origin).parent / "data"))

    def place(name: str, epoch: str, delay_s: float = 0.0) -> np.ndarray:
        moment = datetime.datetime.fromisoformat(epoch).replace(tzinfo=datetime.UTC) - datetime.timedelta(seconds=delay_s)
        when, bodies_of = satkit.time.from_datetime(moment), satkit.solarsystem
        if name in ("Earth", "Moon"):  # satkit gives the Moon as seen from the Earth
            moon = satkit.jplephem.geocentric_pos(bodies_of.Moon, when)
            home = satkit.jplephem.barycentric_pos(bodies_of.EMB, when) - moon / (1.0 + EARTH_OVER_MOON)
            return 1e-3 * np.asarray(home if name == "Earth" else home + moon)
        return 1e-3 * np.asarray(satkit.jplephem.barycentric_pos(getattr(bodies_of, name), when))

    return place


@pytest.mark.parametrize("epoch", EPOCHS)
def test_bodies_stand_where_the_jpl_ephemeris_has_them(jpl, epoch):
    """DE440, light time by iteration on its barycentric places: Moon 15 arcsec, planets 2 arcmin."""
    tai_ns, home = earth.tai_ns_of_utc(epoch), jpl("Earth", epoch)
    for name in ("Moon", *ephemeris.PLANETS):
        seen = jpl(name, epoch) - home
        for _ in range(4):
            seen = jpl(name, epoch, float(np.linalg.norm(seen)) / earth.LIGHT_KM_S) - home
        ours = ephemeris.moon_position_km(tai_ns) if name == "Moon" else ephemeris.planet_position_km(name, tai_ns)[0]
        assert angle(ours, seen) < (15.0 if name == "Moon" else 120.0) * ARCSEC
        assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(seen), rel=3e-4)


@pytest.mark.parametrize("epoch", EPOCHS)
def test_planets_are_astropys(epoch):
    """Astropy's own light time and aberration on the same theory (and ours undone to second order): 0.2 arcsec."""
    now, tai_ns = Time(epoch, scale="utc"), earth.tai_ns_of_utc(epoch)
    for name in ephemeris.PLANETS:
        apparent = get_body(name.lower(), now, ephemeris="builtin").cartesian.xyz.to_value("km")
        ours = ephemeris.planet_position_km(name, tai_ns)[0]
        seen = aberrate((ours / np.linalg.norm(ours))[None], earth.earth_velocity_km_s(tai_ns))[0]
        assert min(angle(apparent, seen), angle(apparent, ours)) < 0.2 * ARCSEC


@pytest.mark.parametrize(
    ("name", "sun_au", "observer_au", "phase_deg", "latitudes", "expected"),
    [
        # Test cases of Mallama & Hilton 2018, supplement (Ap_Mag); phases that only other planets see are not modelled.
        ("Mercury", 0.310295423552, 1.32182643625754, 1.1677, (0.0, 0.0), -2.477),
        ("Mercury", 0.413629222334, 0.92644808718613, 90.1662, (0.0, 0.0), 0.181),
        ("Mercury", 0.448947624811, 0.56004973217883, 178.7284, (0.0, 0.0), 7.167),
        ("Venus", 0.722722540169, 1.71607489554051, 1.3232, (0.0, 0.0), -3.917),
        ("Venus", 0.721480714554, 0.37762511206278, 124.1348, (0.0, 0.0), -4.916),
        ("Venus", 0.726166592736, 0.28889582420642, 179.1845, (0.0, 0.0), -3.090),
        ("Jupiter", 5.446231815414, 6.44985867459088, 0.2446, (0.0, 0.0), -1.667),
        ("Jupiter", 4.957681473205, 3.95393078136013, 0.3431, (0.0, 0.0), -2.934),
        ("Uranus", 18.321003215845, 17.3229728525108, 0.0410, (-20.29, -20.28), 5.381),
        ("Uranus", 20.096361095266, 21.0888470145276, 0.0568, (1.02, 0.97), 6.025),
    ],
)
def test_planets_are_as_bright_as_published(name, sun_au, observer_au, phase_deg, latitudes, expected):
    """To the three decimals of the paper's table."""
    assert bodies.planet_magnitude(name, sun_au, observer_au, phase_deg, *latitudes) == pytest.approx(expected, abs=1.5e-3)


@pytest.mark.parametrize(
    ("epoch", "name", "expected", "tolerance"),
    [
        # Mallama & Hilton's formulas on DE421 as the test-suite of Skyfield has them, to 0.1 mag.
        ("2021-10-04T00:00:00", "Mercury", 2.4, 0.1),
        ("2021-10-04T00:00:00", "Venus", -4.3, 0.1),
        ("2021-10-04T00:00:00", "Mars", 1.6, 0.1),
        ("2021-10-04T00:00:00", "Jupiter", -2.7, 0.1),
        ("2021-10-04T00:00:00", "Uranus", 5.7, 0.1),
        ("2021-10-04T00:00:00", "Neptune", 7.7, 0.1),
    ],
)
def test_planets_of_a_date_are_as_bright_as_another_implementation_has_them(epoch, name, expected, tolerance):
    found = {b.name: b for b in bodies.planets(earth.tai_ns_of_utc(epoch))}
    assert -2.5 * math.log10(found[name].flux_v0) == pytest.approx(expected, abs=tolerance)


ROLO = {  # Kieffer & Stone 2005, AJ 129, 2887, table 4: a0 to a3, d1 to d3 of the two bands around V
    549.1: (-2.10782, -1.66736, 0.41697, -0.22026, 0.36814, -0.09815, -0.00000),
    553.8: (-2.12504, -1.65970, 0.38409, -0.20655, 0.37206, -0.10745, 0.00347),
}


def rolo_magnitude(phase_deg: float) -> float:
    """V of the Moon at mean distances by ROLO's disc reflectance, libration and the waning half's maria left out."""
    g = math.radians(phase_deg)
    reflectance = [
        math.exp(
            a0 + a1 * g + a2 * g**2 + a3 * g**3
            + d1 * math.exp(-phase_deg / 4.06054) + d2 * math.exp(-phase_deg / 12.8802)
            + d3 * math.cos((phase_deg + 30.5858) / 16.7498)
        )
        for a0, a1, a2, a3, d1, d2, d3 in ROLO.values()
    ]  # fmt: skip
    return SUN_V_MAG - 2.5 * math.log10(np.mean(reflectance) * 6.4177e-5 / math.pi)


@pytest.mark.parametrize("phase_deg", [1.6, 3.0, 5.0, 7.0, 10.0, 20.0, 40.0, 60.0, 80.0, 95.0])
def test_the_moon_is_as_bright_as_rolo_has_it(phase_deg):
    """0.15 mag; ROLO's own absolute scale is good to 0.05 to 0.1."""
    assert bodies.moon_magnitude(phase_deg, 384400.0, 1.0) == pytest.approx(rolo_magnitude(phase_deg), abs=0.15)


def test_the_moon_stands_a_degree_aside_from_low_orbit():
    tai_ns = earth.tai_ns_of_utc(EPOCHS[2])
    centre = bodies.moon(tai_ns, np.zeros(3))
    aside = np.cross(centre.direction, [0.0, 0.0, 1.0])
    moved = bodies.moon(tai_ns, 7078.0 * aside / np.linalg.norm(aside))
    assert math.degrees(angle(centre.direction, moved.direction)) == pytest.approx(
        math.degrees(7078.0 / np.linalg.norm(ephemeris.moon_position_km(tai_ns))), rel=1e-3
    )
    assert centre.radius_rad == pytest.approx(math.radians(0.2591), rel=0.08)


@pytest.mark.parametrize("phase_deg", [0.0, 60.0, 90.0, 150.0])
def test_the_lit_share_of_a_disc_is_its_phase(phase_deg):
    """(1 + cos alpha) / 2 of the disc's area is lit."""
    alpha = math.radians(phase_deg)
    body = bodies.Body(
        name="x", direction=np.array([0.0, 1.0, 0.0]), flux_v0=1.0, b_v=0.9, radius_rad=4.5e-3,
        to_sun=np.array([math.sin(alpha), -math.cos(alpha), 0.0]),
    )  # fmt: skip
    points, share = bodies.disc_points(body, 4e-5)
    assert (share > 0.0).mean() == pytest.approx(0.5 * (1.0 + math.cos(alpha)), abs=0.01)
    assert share.sum() == pytest.approx(1.0)
    assert max(angle(p, body.direction) for p in points[::50]) < 4.51e-3
    if phase_deg == 0.0:
        assert share.max() == pytest.approx(share.min(), rel=1e-3)


def test_moonlit_air_is_krisciunas_and_schaefers():
    """An independent implementation (specsim): 20 and 70 deg from the zenith, 50 deg apart, phase 45 deg, k = 0.15: 19.855."""
    up = np.array([0.0, 0.0, 1.0])
    field = np.array([[math.sin(math.radians(20.0)), 0.0, math.cos(math.radians(20.0))]])
    moon = np.array([math.sin(math.radians(70.0)), 0.0, math.cos(math.radians(70.0))])
    air = Atmosphere(
        options=AtmosphereOptions(extinction_mag=0.15), up=up, height_m=0.0, clouds=clouds_of(AtmosphereOptions(), 1), time_s=0.0
    )
    light = air.moonlight(field, moon, 10.0 ** (-0.4 * bodies.moon_magnitude(45.0, 384400.0, 1.0)))
    assert -2.5 * math.log10(light[0]) == pytest.approx(19.855, abs=0.005)


@pytest.mark.parametrize("phase_deg", [60.0, 90.0, 120.0])
def test_the_whole_earth_has_its_published_magnitude(phase_deg):
    """Mallama & Hilton 2018, V = -3.99 - 1.060e-3 a + 2.054e-4 a^2 at 1 au: 0.25 mag between the phases that low orbits see."""
    alpha, far_km = math.radians(phase_deg), 4e5
    observer = np.array([far_km, 0.0, 0.0])
    sun = earth.AU_KM * np.array([math.cos(alpha), math.sin(alpha), 0.0])
    side = np.linspace(-1.0, 1.0, 301) * 6600.0 / far_km
    y, z = (a.ravel() for a in np.meshgrid(side, side))
    directions = np.stack([-np.ones_like(y), y, z], axis=-1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    light, _ = earth_light(directions, observer, sun)
    total = float(light.sum()) * (side[1] - side[0]) ** 2 * ARCSEC2_PER_SR
    magnitude = -2.5 * math.log10(total) + 5.0 * math.log10(earth.AU_KM / far_km)
    expected = -3.99 - 1.060e-3 * phase_deg + 2.054e-4 * phase_deg**2
    assert magnitude == pytest.approx(expected, abs=0.25)


def test_the_limb_hides_stars_and_glows():
    """Ground is opaque; 60 km up all light passes; airglow at the limb is its zenith's times the path through 10 km of layer."""
    observer = np.array([7078.137, 0.0, 0.0])
    sun = earth.AU_KM * np.array([1.0, 0.0, 0.0])  # below the field: night is at -x

    def ray(tangent_km: float) -> np.ndarray:
        sine = (earth.EARTH_RADIUS_KM + tangent_km) / 7078.137
        return np.array([[-math.sqrt(1.0 - sine * sine), sine, 0.0]])

    _, through = earth_light(np.concatenate([ray(-5.0), ray(10.0), ray(60.0), ray(120.0)]), observer, sun)
    assert through[0] == 0.0
    assert 0.0 < through[1] < 0.3
    assert through[2] > 0.99
    assert through[3] == pytest.approx(1.0, abs=1e-5)
    night = -sun
    glow, _ = earth_light(ray(85.0), observer, night)
    inner, outer, closest = 6463.137, 6473.137, 6463.137
    path_km = 2.0 * (math.sqrt(outer**2 - closest**2) - math.sqrt(max(inner**2 - closest**2, 0.0)))
    assert -2.5 * math.log10(glow[0]) == pytest.approx(22.3 - 2.5 * math.log10(path_km / 10.0), abs=0.02)


def test_the_veil_is_the_integral_over_the_earth():
    """A uniform share of scatter: the veil is that share of all light on the aperture, by an independent sum."""
    options = FarScatterOptions(strength=1e-3, slope=0.0, baffle_deg=180.0)
    observer, sun = np.array([0.0, 7078.0, 0.0]), earth.AU_KM * np.array([0.6, 0.8, 0.0])
    veil = earth_veil(options, np.array([[0.0, 0.0, 1.0]]), observer, sun)[0]
    cosine = np.linspace(-1.0, 1.0, 401)
    turn = np.arange(360) * math.pi / 180.0
    z, phi = (a.ravel() for a in np.meshgrid(0.5 * (cosine[1:] + cosine[:-1]), turn))
    s = np.sqrt(1.0 - z * z)
    directions = np.stack([s * np.cos(phi), -z, s * np.sin(phi)], axis=-1)
    light, _ = earth_light(directions, observer, sun)
    nadir_cosine = directions @ [0.0, -1.0, 0.0]
    seen = nadir_cosine > math.sqrt(1.0 - (6528.137 / 7078.0) ** 2)
    total = float(light[seen].sum()) * (cosine[1] - cosine[0]) * (math.pi / 180.0)
    assert veil == pytest.approx(1e-3 * total, rel=0.03)


def test_scatter_falls_with_its_slope_until_the_baffle_shades():
    options = FarScatterOptions(strength=1e-3, slope=2.0, baffle_deg=25.0, baffle_leak=1e-5)
    share = veil_per_arcsec2(options, np.radians([10.0, 20.0, 40.0])) * ARCSEC2_PER_SR
    assert share[:2] == pytest.approx([1e-3, 2.5e-4])
    assert share[2] == pytest.approx(1e-3 / 16.0 * 1e-5)
