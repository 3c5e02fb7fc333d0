"""The planner's camera and station against what the simulator renders, and against motion that SciPy integrates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ground.planning.constraints import air_mass
from ground.planning.light import snr_of
from ground.planning.schedule import Schedule, Visit
from ground.planning.sky import Orbit
from sboc_e2e import scenario
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.planning.instrument import optical_axes, planned_camera, station_of
from sboc_e2e.registry import Registry
from simulator.chain import Simulator
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.observer import SiteObserver
from simulator.scene.sources import ObjectOptions, SkyPathOptions

SKY_MAG = 20.0
QUIET = (
    "stars.enabled=false", "radiation.enabled=false", "instrument.rows=256", "instrument.cols=256", "psf.corner_growth=0",
    "vignetting.corner_loss=0", "instrument.as_built.zero_point=0 mag", "instrument.as_built.psf_width=0", "frames=1",
    "sky.zodiacal=0", "sky.unresolved=0", "sky.earth=false", "atmosphere.glow=30 mag/arcsec2", "atmosphere.scintillation=false",
    "atmosphere.image_motion=false",
)  # fmt: skip
SUMS = ("sensor.type=ccd", "sensor.binning.rows=4", "sensor.binning.cols=4", "sensor.binning.method=sum",
        "sensor.readout.read_noise=15 e-", "sensor.ccd.row_transfer=0 us")  # fmt: skip


def options(name: str, *overrides: str) -> SimulatorOptions:
    return scenario.load(name, registry=Registry(), overrides=[*QUIET, *overrides]).simulator


def seen_from(found: SimulatorOptions, zenith_deg: float, v_mag: float, rate_arcsec_s: float) -> SimulatorOptions:
    """The camera on an even sky of `SKY_MAG`, its boresight so far from the zenith of a site, with one object there."""
    built, epoch = found.instrument, earth.tai_ns_of_utc(found.epoch_utc)
    scale_arcsec = np.degrees(built.pixel_um * 1e-3 / built.focal_length_mm) * 3600.0
    light = built.zero_point_e_s * 10.0 ** (-0.4 * SKY_MAG) * scale_arcsec**2
    up = SiteObserver(site=found.platform.site).up(epoch)
    aside = np.cross(up, [0.0, 0.0, 1.0])
    zenith = np.radians(zenith_deg)
    line = np.cos(zenith) * up + np.sin(zenith) * aside / np.linalg.norm(aside)
    ra, dec = np.degrees(np.arctan2(line[1], line[0])), np.degrees(np.arcsin(line[2]))
    path = SkyPathOptions(v_mag=v_mag, ra_deg=ra, dec_deg=dec, east_arcsec_s=rate_arcsec_s, range_km=1e5)
    return replace(
        found,
        instrument=replace(built, stray_light_e_px_s=float(light)),
        pointing=replace(found.pointing, law="inertial", ra_deg=ra, dec_deg=dec),
        objects=ObjectOptions(passing=(), sky_path=(path,)),
    )


@pytest.mark.parametrize(
    ("name", "overrides", "zenith_deg", "rate_arcsec_s"),
    [
        ("geo_survey", (), 0.0, 0.0),
        ("geo_survey", ("sensor.dark.median=2 e-/s", "sensor.temperature=293.15 K"), 0.0, 15.0),
        ("geo_survey", SUMS, 0.0, 60.0),
        ("geo_survey", ("sensor.binning.rows=2", "sensor.binning.cols=2"), 0.0, 60.0),
        ("ground_site_tracking", ("atmosphere.extinction=0.3 mag", "atmosphere.seeing=4 arcsec"), 0.0, 0.0),
        ("ground_site_tracking", ("atmosphere.extinction=0.3 mag", "atmosphere.seeing=4 arcsec"), 65.0, 20.0),
        ("ground_site_tracking", ("atmosphere.cloud_transmission=0.6",), 40.0, 20.0),
    ],
    ids=["as it is", "30 K warmer", "summed on the chip", "binned", "air at the zenith", "air at 25 deg", "clouds"],
)
def test_the_planner_expects_what_the_simulator_renders(
    name: str, overrides: tuple[str, ...], zenith_deg: float, rate_arcsec_s: float
) -> None:
    """The truth's S/N is that of a known trail on its background; the planner's has the photons of the trail besides."""
    asked = options(name, *overrides)
    flown = seen_from(asked, zenith_deg, 14.5, rate_arcsec_s)
    _, truth = Simulator(flown, seed=3, catalogue=StarCatalogue.embedded()).frame(0)
    (trail,) = truth.streaks
    rendered = trail["flux_e"] / np.sqrt((trail["flux_e"] / trail["snr"]) ** 2 + trail["flux_e"])
    mass = float(air_mass(np.array(90.0 - zenith_deg))) if flown.platform.kind == "site" else 0.0
    rate = np.array(np.radians(trail["rate_deg_s"]))
    planned = snr_of(np.array(14.5), rate, planned_camera(asked, SKY_MAG), mass)
    assert planned == pytest.approx(rendered, rel=0.04)


@pytest.mark.parametrize("start_s", [-5_000.0, 40_000.0])
def test_a_plan_meets_the_platform_where_its_orbit_brings_it(start_s: float) -> None:
    """From the perigee of the epoch on, under the point mass and J2 (Vallado, eq. 8-30), to 10 m."""
    found = options("geo_survey", "platform.kind=kepler", "platform.semi_major_axis=9000 km", "platform.eccentricity=0.2")
    mu, j2, radius, p = 398600.4418, 1.08262668e-3, 6378.137, found.platform
    i, a, e = np.radians(p.inclination_deg), p.semi_major_axis_km, p.eccentricity
    speed = np.sqrt(mu / a * (1.0 + e) / (1.0 - e))
    # node, perigee and mean anomaly are 0: the perigee lies on the x axis
    at_epoch = np.array([a * (1.0 - e), 0.0, 0.0, 0.0, speed * np.cos(i), speed * np.sin(i)])

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        r2 = y[:3] @ y[:3]
        flat = 1.5 * j2 * radius**2 / r2 * (np.array([1.0, 1.0, 3.0]) - 5.0 * y[2] ** 2 / r2)
        return np.concatenate([y[3:], -mu / r2**1.5 * y[:3] * (1.0 + flat)])

    want = solve_ivp(slope, (0.0, start_s), at_epoch, method="DOP853", rtol=1e-12, atol=1e-9).y[:, -1]
    start = earth.tai_ns_of_utc(found.epoch_utc) + round(start_s * 1e9)
    station = station_of(found, start)
    assert isinstance(station, Orbit)
    assert station.epoch_tai_ns == start
    assert np.linalg.norm(station.state[:3] - want[:3]) < 0.01


def schedule_of(ra_deg: float, dec_deg: float) -> Schedule:
    """One visit."""
    ra, dec = np.radians([ra_deg, dec_deg])
    there = (float(np.cos(dec) * np.cos(ra)), float(np.cos(dec) * np.sin(ra)), float(np.sin(dec)))
    visit = Visit(start_tai_ns=0, end_tai_ns=10**9, boresight=there, targets=(), gain=0.0)
    return Schedule(visits=(visit,), gain_nats=np.zeros(0), forbidden={}, n_slots=1, notes=())


STEADY = (
    "light.annual_aberration=false", "light.orbital_aberration=false", "jitter.bias_x=0 arcsec", "jitter.bias_y=0 arcsec",
    "jitter.bias_roll=0 arcsec", "jitter.cross_rms=0 arcsec", "jitter.roll_rms=0 arcsec", "instrument.as_built.center_row=0 px",
    "instrument.as_built.center_col=0 px",
)  # fmt: skip
WINDOW = ("sensor.window.row0=160", "sensor.window.rows=64", "sensor.window.col0=24", "sensor.window.cols=96")


@pytest.mark.parametrize(
    ("cut", "roll_deg", "dec_deg"),
    [
        ((), 0.0, 2.5),
        (WINDOW, 0.0, 2.5),
        (WINDOW, 130.0, -50.0),
        (WINDOW, -20.0, 84.0),
        (("sensor.window.row0=200",), 180.0, 30.0),
    ],
)
def test_a_visit_lays_the_middle_of_the_readout_window_on_its_field(
    cut: tuple[str, ...], roll_deg: float, dec_deg: float
) -> None:
    """An object at rest in the middle of the field, on frames that are cut, to a pixel."""
    found = options("geo_survey", *STEADY, f"pointing.roll={roll_deg} deg", *cut)
    (visit,) = optical_axes(schedule_of(77.0, dec_deg), found).visits
    x, y, z = visit.boresight
    axis = {"law": "inertial", "ra_deg": np.degrees(np.arctan2(y, x)), "dec_deg": np.degrees(np.arcsin(z))}
    path = SkyPathOptions(v_mag=12.0, ra_deg=77.0, dec_deg=dec_deg, east_arcsec_s=0.0, range_km=1e5)
    flown = replace(
        found, pointing=replace(found.pointing, **axis), objects=ObjectOptions(passing=(), sky_path=(path,))
    )  # fmt: skip
    frame, truth = Simulator(flown, seed=3, catalogue=StarCatalogue.embedded()).frame(0)
    (trail,) = truth.streaks
    shape = np.array(frame.pixels.shape)
    middle = [0.5 * (trail["row0"] + trail["row1"]), 0.5 * (trail["col0"] + trail["col1"])]
    assert middle == pytest.approx(0.5 * (shape - 1.0), abs=1.0)


def test_the_field_of_a_plan_is_what_is_read_out() -> None:
    """4,096 px at 4.6 arcsec; rows 3,000 to 4,095 are 1,096, whose half is 0.71 deg and whose middle is 1.9 deg off the axis."""
    whole = scenario.load("geo_survey", registry=Registry()).simulator
    cut = scenario.load("geo_survey", registry=Registry(), overrides=["sensor.window.row0=3000"]).simulator
    field, part = (planned_camera(found, SKY_MAG).half_field_rad for found in (whole, cut))
    assert part == pytest.approx(field * 1096.0 / 4096.0, rel=2e-3)


def test_a_plan_refuses_windows_that_no_attitude_lays_on_the_field() -> None:
    turning = options("geo_survey", "pointing.roll_rate=1 deg/s", *WINDOW)
    with pytest.raises(UserError, match=r"pointing\.roll_rate: 1 deg/s .* allowed for a plan is 0"):
        optical_axes(schedule_of(77.0, 2.5), turning)
    aside = options("geo_survey", *WINDOW)
    with pytest.raises(UserError, match=r"sensor\.window: .* declination 90\.00 deg at pointing\.roll 0 deg; allowed"):
        optical_axes(schedule_of(77.0, 90.0), aside)
    outside = options("geo_survey", "sensor.window.row0=256")
    with pytest.raises(UserError, match=r"sensor\.window: rows 256 to 256"):
        planned_camera(outside, SKY_MAG)
