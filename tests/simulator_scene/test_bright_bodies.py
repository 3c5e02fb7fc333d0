"""Frames with the Moon, a planet or the Earth in them: light where it should be, and a chain that lives on."""

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import document
from simulator.chain import Simulator
from simulator.platform import earth
from simulator.scene import bodies

MOON = 'epoch_utc="2027-01-22T12:00:00"'
JUPITER = 'epoch_utc="2027-02-10T23:00:00"'


def simulator(*settings: str) -> Simulator:
    scenario = document.load("smoke", registry=Registry(), overrides=["frames=1", "population.classes=[]", *settings])
    return Simulator(scenario.simulator, seed=3, catalogue=StarCatalogue.embedded())


def test_a_planet_is_in_image_and_truth_at_its_magnitude():
    """Jupiter at opposition, V -2.6: one row of truth, its light within 1 % of the zero point's, most of it on its own place."""
    made = simulator(JUPITER, "sky.planets=true", "vignetting.corner_loss=0.0")
    image_e = made.mean_electrons(0).astype(np.float64)
    _, truth = made.frame(0)
    star = truth.stars[truth.stars["star_id"] == np.iinfo(np.int64).min // 2 + 3]
    assert len(star) == 1
    assert star["v_mag"][0] == pytest.approx(-2.57, abs=0.05)
    without = simulator(JUPITER, "vignetting.corner_loss=0.0").mean_electrons(0)
    row, col = round(float(star["row"][0])), round(float(star["col"][0]))
    light = (image_e - without)[row - 12 : row + 13, col - 12 : col + 13].sum()
    assert light == pytest.approx(float(star["flux_e"][0]), rel=0.01)


def test_the_moon_fills_its_disc():
    """Its light on the image is that of its magnitude, within the share of vignetting; half of it within 0.71 radii."""
    made = simulator(MOON, "sky.moon=true")
    light = made.mean_electrons(0).astype(np.float64) - simulator(MOON).mean_electrons(0)
    moon = bodies.moon(made._epoch, made._carrier.observer.state(made._epoch)[0])
    camera = made._camera
    colour = float(camera.instrument.colour_factor(np.array([moon.b_v]))[0])
    assert light.sum() == pytest.approx(camera.zero_point_e_s * 0.2 * moon.flux_v0 * colour, rel=0.1)
    row, col = (np.array(x, dtype=float) for x in np.nonzero(light > 0.1 * light.max()))
    radius_px = moon.radius_rad * camera.projection.focal_px
    assert np.hypot(row - row.mean(), col - col.mean()).max() == pytest.approx(radius_px, abs=2.0)
    assert (light > 0.1 * light.max()).sum() == pytest.approx(np.pi * radius_px**2, rel=0.03)


def test_the_sunlit_earth_saturates_and_hides_the_stars():
    made = simulator('pointing.law="nadir"', 'pointing.tilt="30 deg"', "objects.passing=[]")
    shot, truth = made.frame(0)
    assert (shot.pixels > 32000).mean() > 0.99
    assert len(truth.stars) == 0


def test_moonlight_brightens_the_sky_of_a_site():
    """At a site the veil is that of Krisciunas & Schaefer, and only while the Moon is up."""
    site = ('platform.kind="site"', 'pointing.law="sidereal"', 'pointing.ra="131 deg"', 'pointing.dec="18 deg"')
    for epoch, up in (("2027-01-23T00:00:00", True), ("2027-01-29T00:00:00", False)):
        settings = (*site, f'epoch_utc="{epoch}"', "stars.enabled=false", 'radiation.environment="ground"')
        made = simulator(*settings, "sky.moon=true")
        brighter = float(np.median(made.mean_electrons(0)) / np.median(simulator(*settings).mean_electrons(0)))
        observer = made._carrier.observer
        moon = bodies.moon(made._epoch, observer.state(made._epoch)[0])
        assert bool(moon.direction @ observer.up(made._epoch) > 0.0) == up
        assert brighter > 3.0 if up else brighter == 1.0
    assert earth.jyear(made._epoch) > 2027.0
