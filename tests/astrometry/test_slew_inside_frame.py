"""Slew and jitter inside a frame: every point has the attitude of its own row's epoch, by the rates that telemetry gives.

The reference is an analytic attitude: a camera whose body turns with a constant angular velocity, or swings, evaluated with
scipy's rotations at the epoch at which each row was exposed; aberration of the camera's velocity is taken off by astropy.
"""

from collections.abc import Callable
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord
from astropy.time import Time
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ground.astrometry.astrometer import CameraFit
from ground.astrometry.camera import Camera as PinHole
from ground.sky.measure import initial_epochs_ns, with_sky
from ground.sky.pixel_sky import SolvedSky, published_directions, row_mid_exposure_tai_ns
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.tai import EPOCH_JD
from tests.astrometry.star_fields import FieldOptions, make_field
from tests.link.sky_scene import Camera, streak

ARCSEC = np.pi / 648000.0
SLEW_RAD_S = np.radians([0.04, -0.05, 0.06])
"""About the rate of an orbit on each axis, as a camera turns that keeps to the nadir."""
EXPOSURE_NS, LINE_TIME_NS, SIZE, FOCAL_PX = 200_000_000, 10_000, 4096, 44444.0
POINTING = Rotation.from_euler("zyx", [131.5, -17.9, 40.0], degrees=True) * Rotation.from_euler("y", 90.0, degrees=True)
"""Camera axes to GCRS axes at the frame's epoch."""

Body = Callable[[float], Rotation]


def slewing(t_s: float) -> Rotation:
    """Camera axes to GCRS t_s after the frame's epoch: the body turns about an axis that stands still in it."""
    return POINTING * Rotation.from_rotvec(SLEW_RAD_S * t_s)


SWING_RAD, SWING_RAD_S, SWING_PHASE = 5.0 * ARCSEC, 2.0 * np.pi * 0.5, 0.4
"""Jitter of 5 arcsec at 0.5 Hz: slow against the frame, as far as one rate can tell of it."""


def swinging(t_s: float) -> Rotation:
    """Camera axes to GCRS t_s after the frame's epoch, of a body that swings about its x axis."""
    return POINTING * Rotation.from_rotvec([SWING_RAD * np.sin(SWING_RAD_S * t_s + SWING_PHASE), 0.0, 0.0])


def header_of() -> FrameHeader:
    """A header with the observer's state at the frame's epoch; its rate comes through the solution."""
    start = 2_178_000_000 * 1_000_000_000
    middle = start + round(LINE_TIME_NS * 0.5 * (SIZE - 1)) + EXPOSURE_NS // 2
    return FrameHeader(
        frame=0,
        t_start_tai_ns=start,
        exposure_ns=EXPOSURE_NS,
        line_time_ns=LINE_TIME_NS,
        rows=SIZE,
        cols=SIZE,
        observer=ObserverState(
            tai_ns=middle,
            position_m=np.array([7.078e6, 0.0, 0.0]),
            velocity_m_s=np.array([0.0, 1500.0, 7350.0]),
            sigma_position_m=10.0,
            sigma_velocity_m_s=0.1,
        ),
    )


def solution_of(body: Body, rate_rad_s: NDArray[np.float64]) -> FrameSolution:
    """A perfect solution at the frame's epoch, moved by this rate."""
    return FrameSolution(
        frame=0,
        flags=FrameFlag(0),
        quaternion=body(0.0).inv().as_quat(),
        rate_rad_s=rate_rad_s,
        covariance_rad2=np.zeros((3, 3)),
        camera=PinHole(
            focal_px=FOCAL_PX, center_row=0.5 * (SIZE - 1), center_col=0.5 * (SIZE - 1), k1=0.0, k2=0.0, p1=0.0, p2=0.0
        ),
        n_stars=0,
        rms_px=0.0,
        star_index=np.zeros(0, dtype=np.int32),
        star_v_mag=np.zeros(0, dtype=np.float32),
        star_b_v=np.zeros(0, dtype=np.float32),
        star_residual_px=np.zeros((0, 2), dtype=np.float32),
    )


def true_apparent(body: Body, header: FrameHeader, row: float, col: float, tai_ns: float) -> NDArray[np.float64]:
    """Apparent direction of a pixel at an epoch: a pinhole camera turned as its body was then."""
    middle = header.t_start_tai_ns + header.line_time_ns * 0.5 * (SIZE - 1) + 0.5 * header.exposure_ns
    ray = np.array([(col - 0.5 * (SIZE - 1)) / FOCAL_PX, (row - 0.5 * (SIZE - 1)) / FOCAL_PX, 1.0])
    return np.asarray(body((tai_ns - middle) * 1e-9).apply(ray / np.linalg.norm(ray)))


def true_published(apparent: NDArray[np.float64], header: FrameHeader) -> NDArray[np.float64]:
    """The same as an observer sees it who stands where the camera does and does not move about the Earth, by astropy."""
    assert header.observer is not None
    t = Time(header.t_start_tai_ns // 10**9 / 86400.0 + EPOCH_JD, format="jd", scale="tai")
    place = CartesianRepresentation(np.asarray(header.observer.position_m) * u.m)
    moving = GCRS(
        obstime=t, obsgeoloc=place, obsgeovel=CartesianRepresentation(np.asarray(header.observer.velocity_m_s) * u.m / u.s)
    )
    at_rest = GCRS(obstime=t, obsgeoloc=place, obsgeovel=CartesianRepresentation(np.zeros(3) * u.m / u.s))
    seen = SkyCoord(CartesianRepresentation(apparent), frame=moving).transform_to(at_rest).cartesian.xyz.value
    return np.asarray(seen / np.linalg.norm(seen))


def apart_arcsec(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angle between unit vectors (..., 3)."""
    return np.asarray(np.linalg.norm(a - b, axis=-1) / ARCSEC)


def unit(ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors (n, 3)."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


POINTS = [(100.0, 300.0), (400.0, 3900.0), (2047.5, 2047.5), (3300.0, 150.0), (4000.0, 3800.0)]


def test_centroids_have_the_attitude_of_their_row() -> None:
    """Mid-exposure of each row: right to 0.1 mas with the rate; without it up to 4 arcsec off at the frame's ends."""
    header = header_of()
    row, col = np.array(POINTS).T
    t_ns = header.t_start_tai_ns + LINE_TIME_NS * row + 0.5 * EXPOSURE_NS
    want = np.array([true_apparent(slewing, header, r, c, t) for r, c, t in zip(row, col, t_ns, strict=True)])
    epochs = row_mid_exposure_tai_ns(header, row)
    assert np.abs(epochs - t_ns).max() <= 1.0
    error = apart_arcsec(SolvedSky(header=header, solution=solution_of(slewing, SLEW_RAD_S)).apparent(row, col, epochs), want)
    still = apart_arcsec(SolvedSky(header=header, solution=solution_of(slewing, np.zeros(3))).apparent(row, col, epochs), want)
    assert error.max() < 1e-4
    assert still[2] < 1e-4
    assert still[[0, 4]].min() > 3.0


@pytest.mark.parametrize("resolved", [False, True])
def test_ends_and_middle_of_a_streak_each_have_their_own_epoch(resolved: bool) -> None:
    """Published directions of end 0, middle and end 1 to 1 mas, before and after the direction of motion is known.

    Unresolved, ends stand at mid-exposure of their rows; resolved, at shutter open and close of them, 0.1 s before and after:
    without rates they are then 20 arcsec off.
    """
    header = header_of()
    made = streak(Camera(), 0, 0, np.array([[700.0, 900.0], [2900.0, 3100.0]]), 0.3, 0.1, StreakFlag(0))
    row = np.array([700.0, 1800.0, 2900.0])
    shift = np.array([0, EXPOSURE_NS // 2, EXPOSURE_NS]) if resolved else np.full(3, EXPOSURE_NS // 2)
    t_ns = header.t_start_tai_ns + LINE_TIME_NS * row.astype(np.int64) + shift
    if not resolved:
        assert np.array_equal(initial_epochs_ns(made.fit, 1800.0, header), t_ns)
    measured = replace(made, t_tai_ns=t_ns)
    pairs = zip(row, [900.0, 2000.0, 3100.0], t_ns, strict=True)
    want = np.array([true_published(true_apparent(slewing, header, r, c, t), header) for r, c, t in pairs])

    def errors(rate_rad_s: NDArray[np.float64]) -> NDArray[np.float64]:
        sky = SolvedSky(header=header, solution=solution_of(slewing, rate_rad_s))
        seen = with_sky(measured, header, sky, np.zeros((3, 3)))
        return apart_arcsec(unit(seen.ra_deg, seen.dec_deg), want)

    assert errors(SLEW_RAD_S).max() < 1e-3
    assert errors(np.zeros(3))[[0, 2]].min() > (20.0 if resolved else 1.5)


def test_slow_jitter_is_followed_to_its_second_order() -> None:
    """One rate for a frame leaves the swing's second derivative: at most A (w dt)^2 / 2, where it takes A w dt away."""
    rate = np.array([SWING_RAD * SWING_RAD_S * np.cos(SWING_PHASE), 0.0, 0.0])
    header = header_of()
    row, col = np.array(POINTS).T
    for after_ns in (-EXPOSURE_NS // 2, 0, EXPOSURE_NS // 2):
        t_ns = row_mid_exposure_tai_ns(header, row) + after_ns
        dt_s = 1e-9 * (after_ns + LINE_TIME_NS * (row - 0.5 * (SIZE - 1)))
        want = np.array([true_apparent(swinging, header, r, c, t) for r, c, t in zip(row, col, t_ns, strict=True)])
        error = apart_arcsec(SolvedSky(header=header, solution=solution_of(swinging, rate)).apparent(row, col, t_ns), want)
        bound = SWING_RAD / ARCSEC * (0.5 * (SWING_RAD_S * dt_s) ** 2)
        assert (error <= bound + 1e-4).all()
        still = apart_arcsec(SolvedSky(header=header, solution=solution_of(swinging, np.zeros(3))).apparent(row, col, t_ns), want)
        if after_ns:
            assert (still > 3.0 * error).all()
            assert still.min() > 1.0


def test_stars_of_a_slewing_frame_give_its_camera_by_the_telemetered_rates() -> None:
    """From a star list whose every star was seen by its own row's attitude: directions at frame corners and centre.

    300 stars, telemetry off by 100 arcsec: with the rates 0.02 arcsec in this field, with rates of zero 3.8.
    """
    field = make_field(StarCatalogue.embedded(), 3, FieldOptions(rate_rad_s=tuple(SLEW_RAD_S), displaced=False))
    header = field.frame.header
    row, col = (np.array(p) for p in zip(*POINTS, strict=True))
    epochs = row_mid_exposure_tai_ns(header, row)
    want = published_of(field.true_directions(row, col), header)

    def worst(frame: DownlinkFrame) -> float:
        step = CameraFit(lost_in_space="never")
        _, solution = step.solve(step.initial_state(field.calibration, StarCatalogue.embedded()), frame)
        assert FrameFlag.NO_SOLUTION not in solution.flags
        got = published_directions(SolvedSky(header=frame.header, solution=solution), frame.header, row, col, epochs)
        return float(apart_arcsec(got, want).max())

    assert header.attitude is not None
    still = replace(header, attitude=replace(header.attitude, rate_rad_s=np.zeros(3)))
    assert worst(field.frame) < 0.1
    assert worst(replace(field.frame, header=still)) > 3.0


def published_of(apparent: NDArray[np.float64], header: FrameHeader) -> NDArray[np.float64]:
    """`true_published` of each direction."""
    return np.array([true_published(direction, header) for direction in apparent])
