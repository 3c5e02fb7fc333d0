"""Rendered light, truth labels and a FITS header say the same place, to 0.001 px (DESIGN: indices from 0, CRPIX = index + 1).

The header is made by ground's exporter from the true attitude and the camera as it was built, and read by astropy; between
the true apparent directions and the header's ICRS stands astropy too.
"""

from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import GCRS, ICRS, CartesianRepresentation, SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS

from ground.astrometry.camera import Camera
from ground.astrometry.wcs_export import pixel_icrs, sip_header
from ground.sky.apparent import mid_frame_tai_ns
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files import frame_fits
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import ObserverState
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.tai import to_jd_parts
from simulator.chain import Simulator
from simulator.optics.instrument import AsBuiltOptions
from simulator.optics.psf import PsfOptions
from simulator.optics.vignetting import VignettingOptions
from simulator.options import smoke_options
from simulator.platform.jitter import JitterOptions
from simulator.platform.shutter import ShutterOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.sky import SkyOptions
from simulator.scene.sources import ObjectOptions
from simulator.scene.stars import StarOptions
from tests.star_light import check_places

LIMIT_PX = 1e-3
STILL = JitterOptions(
    cross_rms_arcsec=0.0, roll_rms_arcsec=0.0, lines=(), drift_x_arcsec_s=0.0, drift_y_arcsec_s=0.0, drift_roll_arcsec_s=0.0
)
NOMINAL = AsBuiltOptions(
    focal_length_ppm=0.0, center_row_px=0.0, center_col_px=0.0, distortion=0.0, zero_point_mag=0.0, psf_width=0.0
)


def test_light_truth_and_header_agree(tmp_path: Path) -> None:
    base = smoke_options()
    simulator = Simulator(
        replace(
            base, instrument=replace(base.instrument, as_built=NOMINAL), jitter=STILL, shutter=ShutterOptions(line_time_us=0.0),
            population=PopulationOptions(classes=()), objects=ObjectOptions(passing=()), psf=PsfOptions(corner_growth=0.0),
            sky=SkyOptions(zodiacal=0.0, unresolved=0.0), stars=StarOptions(faint_limit_mag=0.0),
            vignetting=VignettingOptions(corner_loss=0.0, cosine_fourth=False),
        ),
        seed=2,
        catalogue=StarCatalogue.embedded(),
    )  # fmt: skip
    frame, truth = simulator.frame(0)

    # Light against truth labels, both through the file: FITS pixel = index + 1.
    frame_fits.write(tmp_path / "0.fits", replace(frame, pixels=simulator.mean_electrons(0)))
    image = fits.getdata(tmp_path / "0.fits").astype(np.float64)
    assert check_places(image, truth.stars, LIMIT_PX) >= 5

    # Truth labels against the header.
    camera, told = simulator.calibration().camera, truth.frame
    nothing = np.zeros(0)
    solution = FrameSolution(
        frame=0, flags=FrameFlag(0), quaternion=told["q_true"].reshape(4), rate_rad_s=np.zeros(3),
        covariance_rad2=np.zeros((3, 3)),
        camera=Camera.nominal(camera), n_stars=0, rms_px=0.0,
        star_index=nothing.astype(np.int32), star_v_mag=nothing.astype(np.float32), star_b_v=nothing.astype(np.float32),
        star_residual_px=np.zeros((0, 2), np.float32),
    )  # fmt: skip
    middle = mid_frame_tai_ns(frame.header)
    position, velocity = told["position_m"].reshape(3), told["velocity_m_s"].reshape(3)
    observer = ObserverState(
        tai_ns=middle, position_m=position, velocity_m_s=velocity, sigma_position_m=1.0, sigma_velocity_m_s=1.0
    )
    header = replace(frame.header, observer=observer)
    wcs = WCS(sip_header(pixel_icrs(header, solution), header.rows, header.cols))
    seen = GCRS(
        obstime=Time(*to_jd_parts(middle), format="jd", scale="tai"),
        obsgeoloc=CartesianRepresentation(position * u.m), obsgeovel=CartesianRepresentation(velocity * u.m / u.s),
    )  # fmt: skip
    grid = SkyCoord(told["grid_ra_app_deg"].ravel() * u.deg, told["grid_dec_app_deg"].ravel() * u.deg, frame=seen)
    catalogued = grid.transform_to(ICRS())
    col, row = wcs.all_world2pix(catalogued.ra.deg, catalogued.dec.deg, 1)
    assert np.abs(row - 1.0 - told["grid_row"].ravel()).max() < LIMIT_PX
    assert np.abs(col - 1.0 - told["grid_col"].ravel()).max() < LIMIT_PX
