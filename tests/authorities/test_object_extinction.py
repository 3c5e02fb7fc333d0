"""Objects over a ground site lose what the air of their own direction takes: elevations by astropy, Bouguer's law."""

from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time

from sboc_e2e.catalogue import StarCatalogue
from simulator.chain import Simulator
from simulator.optics.vignetting import VignettingOptions
from simulator.options import smoke_options
from simulator.platform.observer import PlatformOptions, SiteOptions
from simulator.platform.pointing import PointingOptions
from simulator.scene.atmosphere import AtmosphereOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.sources import ObjectOptions, SkyPathOptions
from simulator.scene.stars import StarOptions

EPOCH = "2027-01-29T23:00:00"
EXTINCTION = 0.6


def air_mass_of(altitude_deg: float) -> float:
    """Rozenberg (1966, Twilight): another law than the simulator's, within 0.2 % above 20 deg."""
    c = np.sin(np.radians(altitude_deg))
    return 1.0 / (c + 0.025 * np.exp(-11.0 * c))


def test_extinction_is_that_of_the_objects_own_direction():
    """Two objects 4 deg apart at 25 deg elevation: 0.17 mag between them, to 0.005 mag."""
    site = EarthLocation(lon=-6.631 * u.deg, lat=38.216 * u.deg, height=565.0 * u.m)
    frame = AltAz(obstime=Time(EPOCH), location=site)
    places = [SkyCoord(az=140.0 * u.deg, alt=alt * u.deg, frame=frame).icrs for alt in (23.0, 25.0, 27.0)]
    low, middle, high = ((p.ra.deg, p.dec.deg) for p in places)
    things = tuple(
        SkyPathOptions(name=name, v_mag=6.0, ra_deg=p[0], dec_deg=p[1], east_arcsec_s=0.0, range_km=1e9)
        for name, p in (("low", low), ("high", high))
    )
    base = smoke_options()
    options = replace(
        base,
        epoch_utc=EPOCH,
        frames=1,
        platform=PlatformOptions(kind="site", site=SiteOptions()),
        pointing=PointingOptions(law="sidereal", ra_deg=middle[0], dec_deg=middle[1]),
        objects=ObjectOptions(passing=(), sky_path=things),
        population=PopulationOptions(classes=()),
        stars=StarOptions(enabled=False),
        vignetting=VignettingOptions(corner_loss=0.0, cosine_fourth=False),
        atmosphere=AtmosphereOptions(extinction_mag=EXTINCTION, scintillation=False, image_motion=False, seeing_arcsec=20.0),
    )
    truth = Simulator(options, seed=1, catalogue=StarCatalogue.embedded()).frame(0)[1]
    flux_e = {int(s["object_id"]): float(s["flux_e"]) for s in truth.streaks}
    seen_mag = -2.5 * np.log10(flux_e[0] / flux_e[1])
    wanted_mag = EXTINCTION * (air_mass_of(23.0) - air_mass_of(27.0))
    assert wanted_mag > 0.15
    assert seen_mag == pytest.approx(wanted_mag, abs=0.005)
