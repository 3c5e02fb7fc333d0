"""The ground chain on frames made without it: star list and trail in, tracklet with sky positions and magnitudes out."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from astropy.wcs import WCS
from scipy.special import erf

from ground.astrometry.astrometer import CameraFit
from ground.astrometry.wcs_export import pixel_icrs, sip_header
from ground.chain import GroundChain, GroundSteps
from ground.ingest.codecs import PlanesDecoder
from ground.link import MotionLinker
from ground.options import GroundOptions, ProductOptions
from ground.orbit import RangeScan
from ground.photometry.zero_point import ZeroPoint
from ground.products.tables import streaks_tables
from ground.products.tdm import tdm_text
from ground.sky.published import LIGHT_M_S
from ground.streaks import TrailedPsfFitter
from ground.vetting import LikelihoodVetter
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StarFlag, StreakFlag
from sboc_e2e.icd.signals import BackgroundModel, Detection, RoiGroup, StarList, Strip
from tests.astrometry.star_fields import ARCSEC, EXPOSURE_NS, LINE_TIME_NS, VELOCITY_M_S, Field, FieldOptions, make_field

PSF_PX = 0.85
SKY_SIGMA_E = 2.8
N_FRAMES = 4
FLUX_E = 8000.0
START, RATE_PX_S = np.array([1500.3, 900.7]), np.array([180.0, 620.0])


def _ends(k: int) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Pixel ends (row, col) of frame k, opened and closed by the rolling shutter, and their times after frame 0."""
    zero = 0.25 * k
    opened = (zero + LINE_TIME_NS * 1e-9 * START[0]) / (1.0 - LINE_TIME_NS * 1e-9 * RATE_PX_S[0])
    closed = (zero + EXPOSURE_NS * 1e-9 + LINE_TIME_NS * 1e-9 * START[0]) / (1.0 - LINE_TIME_NS * 1e-9 * RATE_PX_S[0])
    return START + RATE_PX_S * opened, START + RATE_PX_S * closed, opened, closed


def _roi(k: int, rng: np.random.Generator) -> RoiGroup:
    """A noisy uniform trail, integrated over pixels in fine time steps, in one strip along the columns."""
    first, last, *_ = _ends(k)
    slope = (last[0] - first[0]) / (last[1] - first[1])
    major0, major1 = int(first[1]) - 12, int(last[1]) + 13
    minor0 = first[0] + slope * (major0 - first[1]) - 9.0
    strip = Strip(
        axis=1,
        major0=major0,
        minor0_fp=int(minor0 * 65536),
        slope_fp=int(slope * 65536),
        level_adu=0,
        values_adu=np.zeros((major1 - major0, 19), dtype=np.int32),
    )
    row, col, _ = strip.pixel_coordinates(4096, 4096)
    light = np.zeros(row.shape)
    for share in (np.arange(600) + 0.5) / 600:
        here = first + share * (last - first)
        by_row = erf((row + 0.5 - here[0]) / (np.sqrt(2) * PSF_PX)) - erf((row - 0.5 - here[0]) / (np.sqrt(2) * PSF_PX))
        by_col = erf((col + 0.5 - here[1]) / (np.sqrt(2) * PSF_PX)) - erf((col - 0.5 - here[1]) / (np.sqrt(2) * PSF_PX))
        light += 0.25 * by_row * by_col / 600
    mean = FLUX_E * light
    values = np.rint(rng.normal(100.0 + mean, np.sqrt(SKY_SIGMA_E**2 + mean))).astype(np.int32)
    detection = Detection(row0=first[0] + 0.5, col0=first[1] - 1.0, row1=last[0] + 0.3, col1=last[1] + 1.0, snr=FLUX_E / 60.0)
    return RoiGroup(roi_id=0, detection=detection, strips=(replace(strip, values_adu=values),), n_strips=1)


@pytest.fixture(scope="module")
def fields() -> list[Field]:
    catalogue = StarCatalogue.embedded()
    rng = np.random.default_rng(11)
    made = []
    for k in range(N_FRAMES):
        # a camera at rest: its trail runs over pixels of one pointing
        field = make_field(catalogue, k, FieldOptions(roll_deg=25.0, rate_rad_s=(0.0, 0.0, 0.0)))
        background = BackgroundModel(tile_px=128, level_adu=np.full((32, 32), 100.0), sigma_adu=np.full((32, 32), SKY_SIGMA_E))
        frame = replace(field.frame, rois=(_roi(k, rng),), background=background)
        made.append(replace(field, frame=frame))
    return made


def chain_of(
    field: Field, *, steps_of: Callable[[GroundSteps], GroundSteps] = lambda steps: steps, orbits: bool = False, **options: Any
) -> GroundChain:
    """The default chain over a field; `steps_of` may exchange steps."""
    steps = GroundSteps(
        decoders=(PlanesDecoder(),),
        streak_fitter=TrailedPsfFitter(),
        vetter=LikelihoodVetter(),
        astrometry=CameraFit(),
        photometry=ZeroPoint(),
        linker=MotionLinker(),
        orbit=RangeScan(),
    )
    return GroundChain(
        GroundOptions(orbits=orbits, **options),
        steps_of(steps),
        calibration=field.calibration,
        camera=field.calibration.camera,
        catalogue=StarCatalogue.embedded(),
    )


def _run(fields: list[Field], frames: list[DownlinkFrame], **options):
    chain = chain_of(fields[0], **options)
    state, products = chain.initial_state(), []
    for frame in frames:
        state, product = chain.process_frame(state, frame)
        products.append(product)
    return products, chain.finish(frames, products)


def _true_published(field: Field, row: float, col: float) -> np.ndarray:
    """Apparent direction of a pixel at mid-exposure of its row, less the aberration of the orbital velocity (first order)."""
    apparent = field.true_directions(np.array([row]), np.array([col]))[0]
    beta = VELOCITY_M_S / LIGHT_M_S
    published = apparent - (beta - apparent * (apparent @ beta))
    return published / np.linalg.norm(published)


def test_single_frames_give_sky_positions_and_magnitudes_with_honest_errors(fields):
    products, _ = _run(fields[:1], [fields[0].frame])
    (streak,) = products[0].streaks
    assert not streak.flags & (StreakFlag.NO_SKY | StreakFlag.VETOED | StreakFlag.FIT_FAILED)
    first, last, *_ = _ends(0)
    middle = 0.5 * (first + last)
    want = _true_published(fields[0], *middle)
    ra, dec = np.radians(streak.ra_deg[1]), np.radians(streak.dec_deg[1])
    got = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    error_arcsec = np.linalg.norm(got - want) / ARCSEC
    assert error_arcsec < 4.0 * np.hypot(streak.sigma_along_arcsec, streak.sigma_cross_arcsec)
    assert streak.sigma_cross_arcsec < streak.sigma_along_arcsec < 1.0


def test_a_mover_becomes_one_tracklet_with_its_direction_and_exposed_time(fields):
    _, result = _run(fields, [field.frame for field in fields])
    (tracklet,) = result.tracklets
    assert len(tracklet.frames) == N_FRAMES
    exposed_s = EXPOSURE_NS * 1e-9 / (1.0 - LINE_TIME_NS * 1e-9 * RATE_PX_S[0])
    true_mag = 21.68 - 2.5 * np.log10(FLUX_E / exposed_s)
    t0_ns = fields[0].frame.header.t_start_tai_ns
    for k, streak in enumerate(result.streaks):
        first, last, opened, closed = _ends(k)
        assert streak.flags & StreakFlag.DIRECTION_RESOLVED
        assert streak.flags & StreakFlag.REFIT
        assert np.hypot(streak.fit.row0 - first[0], streak.fit.col0 - first[1]) < 1.0
        assert np.hypot(streak.fit.row1 - last[0], streak.fit.col1 - last[1]) < 1.0
        np.testing.assert_allclose((streak.t_tai_ns - t0_ns) * 1e-9, [opened, 0.5 * (opened + closed), closed], atol=5e-5)
        assert abs(streak.mag - true_mag) < 4.0 * streak.mag_err
    assert abs(tracklet.mag - true_mag) < 0.02
    # what is published of the tracklet are its members' final ends
    by_id = {streak.streak_id: streak for streak in result.streaks}
    assert len(tracklet.ra_deg) == 2 * N_FRAMES
    for row, (streak_id, point) in enumerate(zip(tracklet.row_streak_ids, tracklet.row_points, strict=True)):
        streak = by_id[int(streak_id)]
        assert (tracklet.ra_deg[row], tracklet.dec_deg[row]) == (streak.ra_deg[point], streak.dec_deg[point])
        assert tracklet.t_tai_ns[row] == streak.t_tai_ns[point]
    assert (tracklet.shared_group == 0).all()
    message = tdm_text(result.tracklets, result.members, result.headers, ProductOptions(), oem_name=None)
    assert message.count("META_START") == 1
    assert message.count("MAG =") == N_FRAMES
    (table,) = streaks_tables(result)
    assert (table["tracklet_id"] == 0).all()


def test_frames_without_attitude_and_stars_keep_their_pixel_products(fields):
    frames = [
        replace(field.frame, header=replace(field.frame.header, attitude=None, observer=None), stars=StarList.empty())
        for field in fields
    ]
    products, result = _run(fields, frames)
    assert all(product.solution.flags & FrameFlag.NO_SOLUTION for product in products)
    assert len(result.streaks) == N_FRAMES
    assert all(streak.flags & StreakFlag.NO_SKY for streak in result.streaks)
    assert all(np.isfinite(streak.fit.row0) for streak in result.streaks)
    assert len(next(streaks_tables(result))) == N_FRAMES


def test_a_wcs_from_outside_gives_the_same_sky(fields):
    chain = chain_of(fields[0])
    state, solved = chain.process_frame(chain.initial_state(), fields[0].frame)
    wcs = WCS(sip_header(pixel_icrs(fields[0].frame.header, solved.solution), 4096, 4096))
    bare = replace(fields[0].frame, header=replace(fields[0].frame.header, attitude=None))
    _, outside = chain.process_frame(state, bare, wcs=wcs)
    assert outside.solution.n_stars > 200  # named through the header, so that there is a zero point
    assert abs(outside.photometry.zero_point_mag - 21.68) < 0.01
    one, other = solved.streaks[0], outside.streaks[0]
    # a header holds no rate: 2e-4 rad/s over the 6 ms between the trail's rows and the frame's middle
    assert np.abs(one.dec_deg - other.dec_deg).max() * 3600.0 < 0.5
    assert np.abs(one.ra_deg - other.ra_deg).max() * 3600.0 < 0.5


def test_frames_without_calibration_flow_through(fields):
    chain = GroundChain(
        GroundOptions(orbits=False),
        chain_of(fields[0])._steps,
        calibration=None,
        camera=fields[0].calibration.camera,
        catalogue=StarCatalogue.embedded(),
    )
    _, product = chain.process_frame(chain.initial_state(), fields[0].frame)
    assert len(product.streaks) == 1
    assert not product.solution.flags & FrameFlag.NO_SOLUTION


def test_remembered_stars_leave_the_trail_and_never_enter_the_camera_fit(fields):
    """A star of 3000 e- under the trail pulls it less when it is remembered; the camera fit does not notice the list."""
    plain = fields[0].frame
    group = plain.rois[0]
    row0, col0 = 0.5 * (group.detection.row0 + group.detection.row1) + 1.0, 0.5 * (group.detection.col0 + group.detection.col1)
    strip = group.strips[0]
    row, col, _ = strip.pixel_coordinates(4096, 4096)
    width = np.sqrt(2) * PSF_PX
    by_row = erf((row + 0.5 - row0) / width) - erf((row - 0.5 - row0) / width)
    by_col = erf((col + 0.5 - col0) / width) - erf((col - 0.5 - col0) / width)
    values = strip.values_adu + np.rint(750.0 * by_row * by_col).astype(np.int32)
    crossed = replace(plain, rois=(replace(group, strips=(replace(strip, values_adu=values),)),))
    star = StarList(
        row=np.array([row0]),
        col=np.array([col0]),
        flux_e=np.array([3000.0], dtype=np.float32),
        snr=np.array([150.0], dtype=np.float32),
        flags=np.array([int(StarFlag.REMEMBERED)], dtype=np.uint8),
    )
    chain = chain_of(fields[0])
    state = chain.initial_state()
    results = [chain.process_frame(state, f)[1] for f in (plain, crossed, replace(crossed, remembered=star))]
    clean, spoilt, freed = (np.array([r.streaks[0].row_mid, r.streaks[0].col_mid]) for r in results)
    # the fit itself masks what it recognises as a star, so that the gain is less than whole
    assert np.linalg.norm(freed - clean) < 0.7 * np.linalg.norm(spoilt - clean)
    assert results[2].streaks[0].flags & StreakFlag.CROSSES_STAR
    for result in results[1:]:
        np.testing.assert_array_equal(result.solution.quaternion, results[0].solution.quaternion)
        np.testing.assert_array_equal(result.solution.star_index, results[0].solution.star_index)
        assert result.photometry.zero_point_mag == results[0].photometry.zero_point_mag
