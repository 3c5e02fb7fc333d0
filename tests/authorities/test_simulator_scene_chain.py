"""Whole frames against astropy: where stars and a satellite stand, by a path that shares no code with the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, ICRS, TEME, CartesianRepresentation, SkyCoord
from astropy.time import Time
from scipy.spatial.transform import Rotation
from sgp4.api import WGS72, Satrec
from sgp4.exporter import export_tle

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd import tai
from simulator.chain import Simulator
from simulator.optics.instrument import AsBuiltOptions, DistortionOptions
from simulator.options import smoke_options
from simulator.platform.jitter import JitterOptions
from simulator.platform.pointing import PointingOptions
from simulator.platform.shutter import ShutterOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.satellites import SatelliteOptions
from simulator.scene.sources import ObjectOptions
from simulator.scene.stars import StarOptions, angles_deg

STILL = JitterOptions(cross_rms_arcsec=0.0, roll_rms_arcsec=0.0, lines=(), drift_x_arcsec_s=0.0, drift_y_arcsec_s=0.0)
NOBODY = PopulationOptions(classes=())


def invented_satellite():
    """Lines of a made-up satellite at 1300 km, with right checksums."""
    record = Satrec()
    days = 2459601.5 - 2433281.5  # 2022-01-22 after 1949-12-31
    angles = np.radians([40.0, 87.6, 280.0, 15.0])
    motion = 12.9 * 2 * np.pi / 1440.0
    record.sgp4init(WGS72, "i", 99999, days, 1e-5, 0.0, 0.0, 0.006, angles[0], angles[1], angles[2], motion, angles[3])
    return export_tle(record)


def astropy_time(tai_ns):
    return Time(*tai.to_jd_parts(int(tai_ns)), format="jd", scale="tai")


def test_stars_stand_where_astropy_puts_them():
    """ICRS -> GCRS with the observer's state -> quaternion of the truth -> plain tangent plane: within 0.002 px of 37 arcsec."""
    base = smoke_options()
    options = replace(
        base,
        frames=1,
        population=NOBODY,
        objects=ObjectOptions(passing=()),
        jitter=STILL,
        stars=StarOptions(catalogue_errors=0.0, faint_limit_mag=0.0),
        shutter=ShutterOptions(line_time_us=0.0),
        instrument=replace(
            base.instrument, pixel_um=9.0, distortion=DistortionOptions(k1=0.0, p1=0.0, p2=0.0), as_built=AsBuiltOptions(
                focal_length_ppm=0.0, center_row_px=0.0, center_col_px=0.0, distortion=0.0, zero_point_mag=0.0, psf_width=0.0
            ), aperture_m=0.2,
        ),
    )  # fmt: skip
    made = Simulator(options, seed=1, catalogue=StarCatalogue.embedded()).frame(0)[1]
    frame, stars = made.frame[0], made.stars
    middle = frame["t_start_true_tai_ns"] + frame["exposure_ns"] // 2
    grid_ra, grid_dec = frame["grid_ra_app_deg"][40], frame["grid_dec_app_deg"][40]
    around = StarCatalogue.embedded().cone(grid_ra, grid_dec, 1.0, epoch_jyear=astropy_time(middle).jyear)
    index = {int(k): n for n, k in enumerate(around.source_id)}
    rows = np.array([index[int(k)] for k in stars["star_id"]])
    seen = SkyCoord(ICRS(around.ra_deg[rows] * u.deg, around.dec_deg[rows] * u.deg)).transform_to(
        GCRS(
            obstime=astropy_time(middle),
            obsgeoloc=CartesianRepresentation(frame["position_m"] * u.m),
            obsgeovel=CartesianRepresentation(frame["velocity_m_s"] * u.m / u.s),
        )
    )
    camera = Rotation.from_quat(frame["q_true"]).apply(seen.cartesian.xyz.value.T)
    focal_px = 400e3 / 9.0
    assert len(stars) > 8
    assert np.abs(255.5 + focal_px * camera[:, 0] / camera[:, 2] - stars["col"]).max() < 2e-3  # 9 mas
    assert np.abs(255.5 + focal_px * camera[:, 1] / camera[:, 2] - stars["row"]).max() < 2e-3


def test_published_direction_of_a_satellite(tmp_path):
    """SGP4, TEME -> GCRS by astropy, light time by iteration, geometric direction: within 20 mas at 1000 km."""
    file = tmp_path / "one.tle"
    lines = invented_satellite()
    file.write_text("INVENTED\n" + "\n".join(lines) + "\n")
    options = replace(
        smoke_options(),
        epoch_utc="2022-01-22T06:00:00",
        frames=2,
        population=NOBODY,
        jitter=STILL,
        stars=StarOptions(enabled=False),
        pointing=PointingOptions(law="object", target="INVENTED"),
        objects=ObjectOptions(passing=(), satellites=SatelliteOptions(file=str(file), names=("INVENTED",), size_m=5.0)),
    )
    record = Satrec.twoline2rv(*lines)

    def geocentric_km(tai_ns):
        time = astropy_time(tai_ns)
        _, position, _ = record.sgp4(time.utc.jd1, time.utc.jd2)
        teme = TEME(CartesianRepresentation(np.array(position) * u.km), obstime=time)
        return teme.transform_to(GCRS(obstime=time)).cartesian.xyz.to_value("km")

    made = Simulator(options, seed=1, catalogue=StarCatalogue.embedded()).frame(0)[1]
    (streak,), frame = made.streaks, made.frame[0]
    middle_ns = int(frame["t_start_true_tai_ns"] + frame["exposure_ns"] // 2 + frame["line_time_ns"] * 511 // 2)
    for k in (0, 16, 32):
        t = int(streak["path_t_tai_ns"][k])
        observer = (frame["position_m"] + frame["velocity_m_s"] * (t - middle_ns) * 1e-9) / 1e3
        delay_ns = 0
        for _ in range(4):
            vector = geocentric_km(t - delay_ns) - observer
            delay_ns = round(np.linalg.norm(vector) / 299792.458 * 1e9)
        ra, dec = angles_deg(vector)
        assert (streak["path_ra_deg"][k] - ra) * np.cos(np.radians(dec)) * 3.6e6 == pytest.approx(0.0, abs=20.0)
        assert (streak["path_dec_deg"][k] - dec) * 3.6e6 == pytest.approx(0.0, abs=20.0)
        if k == 16:
            assert streak["range_km"] == pytest.approx(np.linalg.norm(vector), rel=1e-6)
