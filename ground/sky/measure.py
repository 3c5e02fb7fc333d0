"""A fitted streak on the sky: directions and epochs of its ends and middle, and their errors."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.sky.pixel_sky import PixelSky, published_directions, row_mid_exposure_tai_ns
from ground.sky.rotation import turn
from ground.sky.sphere import ARCSEC_RAD, east_north, spherical_deg, unit_vectors
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement

Array = NDArray[np.float64]


def middle_of(fit: StreakFit) -> tuple[float, float]:
    """Row and col of the trail's middle: of the chord, moved onto the arc by the sagitta."""
    row, col = 0.5 * (fit.row0 + fit.row1), 0.5 * (fit.col0 + fit.col1)
    length = fit.length_px
    if length < 1e-9 or fit.sagitta_px == 0.0:
        return row, col
    # the contract: positive towards the normal (row, col) = (dcol, -drow) of the chord (drow, dcol)
    d_row, d_col = (fit.row1 - fit.row0) / length, (fit.col1 - fit.col0) / length
    return row + fit.sagitta_px * d_col, col - fit.sagitta_px * d_row


def initial_epochs_ns(fit: StreakFit, row_mid: float, header: FrameHeader) -> NDArray[np.int64]:
    """Mid-exposure epochs (3,) of the rows of end 0, middle and end 1, as they stand until the direction is known."""
    return row_mid_exposure_tai_ns(header, np.array([fit.row0, row_mid, fit.row1]))


def with_sky(
    streak: StreakMeasurement, header: FrameHeader, sky: PixelSky | None, pointing_covariance_rad2: Array
) -> StreakMeasurement:
    """The streak with the published directions of its three points at its epochs, and one-sigma errors of the middle.

    pointing_covariance_rad2 : (3, 3) of the solution, camera frame; NaN without one. Without a sky: NaN and NO_SKY.
    """
    fit = streak.fit
    if sky is None:
        unknown = np.full(3, np.nan)
        return replace(
            streak,
            ra_deg=unknown,
            dec_deg=unknown,
            sigma_along_arcsec=float("nan"),
            sigma_cross_arcsec=float("nan"),
            turn_rad_s=np.zeros(3),
            flags=streak.flags | StreakFlag.NO_SKY,
        )
    row = np.array([fit.row0, streak.row_mid, fit.row1])
    col = np.array([fit.col0, streak.col_mid, fit.col1])
    vectors = published_directions(sky, header, row, col, streak.t_tai_ns)
    ra_deg, dec_deg = spherical_deg(vectors)
    along_px, cross_px = middle_sigma_px(fit)
    scale_arcsec = pixel_scale_arcsec(sky, header, streak.row_mid, streak.col_mid)
    if streak.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1) and not streak.flags & StreakFlag.DIRECTION_RESOLVED:
        # The part of the exposure that was seen is unknown. The error is about as large as the unseen part.
        along_px = float(np.hypot(along_px, 0.5 * fit.length_px))
    elif bool(streak.flags & StreakFlag.EDGE0) != bool(streak.flags & StreakFlag.EDGE1):
        # The epoch at the edge follows from the other end's epoch, so this end has the error of the whole trail.
        along_px *= 2.0
    pointing_arcsec = pointing_sigma_arcsec(pointing_covariance_rad2)
    return replace(
        streak,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        sigma_along_arcsec=float(np.hypot(along_px * scale_arcsec, pointing_arcsec)),
        sigma_cross_arcsec=float(np.hypot(cross_px * scale_arcsec, pointing_arcsec)),
        turn_rad_s=sky.turn_rad_s,
        flags=streak.flags & ~StreakFlag.NO_SKY,
    )


def pointing_sigma_arcsec(covariance_rad2: Array) -> float:
    """One sigma of an axis of a frame's pointing, mean of both; 0 where it is unknown."""
    pointing = 0.5 * float(covariance_rad2[0, 0] + covariance_rad2[1, 1])
    return float(np.sqrt(pointing)) / ARCSEC_RAD if np.isfinite(pointing) else 0.0


def jacobian_arcsec(streak: StreakMeasurement, sky: PixelSky | None) -> Array:
    """Change of direction (3, 2, 2), east and north in arcsec, by row and col in px, at the three points; NaN without a sky."""
    if sky is None:
        return np.full((3, 2, 2), np.nan)
    fit = streak.fit
    row = np.array([fit.row0, streak.row_mid, fit.row1])
    col = np.array([fit.col0, streak.col_mid, fit.col1])
    here = sky.apparent(row, col, streak.t_tai_ns)
    steps = np.stack(
        [sky.apparent(row + 1.0, col, streak.t_tai_ns) - here, sky.apparent(row, col + 1.0, streak.t_tai_ns) - here], axis=2
    )
    axes = np.array([east_north(vector) for vector in here])
    return np.asarray(axes @ steps / ARCSEC_RAD)


def redated(streak: StreakMeasurement, t_tai_ns: NDArray[np.int64]) -> StreakMeasurement:
    """The same pixels at other epochs (3,): their directions move as the camera turned in between."""
    vectors = unit_vectors(np.radians(streak.ra_deg), np.radians(streak.dec_deg))
    seconds = (np.asarray(t_tai_ns) - streak.t_tai_ns) * 1e-9
    ra_deg, dec_deg = spherical_deg(turn(vectors, np.outer(seconds, streak.turn_rad_s)))
    return replace(streak, t_tai_ns=np.array(t_tai_ns, dtype=np.int64), ra_deg=ra_deg, dec_deg=dec_deg)


def middle_sigma_px(fit: StreakFit) -> tuple[float, float]:
    """One sigma of the middle along and across the chord."""
    covariance = np.asarray(fit.covariance_px2)
    middle = 0.25 * (covariance[:2, :2] + covariance[2:, 2:] + covariance[:2, 2:] + covariance[2:, :2])
    length = fit.length_px
    if length < 1e-6:
        sigma = float(np.sqrt(max(0.5 * float(middle[0, 0] + middle[1, 1]), 0.0)))
        return sigma, sigma
    along = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / length
    across = np.array([-along[1], along[0]])
    return float(np.sqrt(max(float(along @ middle @ along), 0.0))), float(np.sqrt(max(float(across @ middle @ across), 0.0)))


def pixel_scale_arcsec(sky: PixelSky, header: FrameHeader, row: float, col: float) -> float:
    """Scale at a pixel: geometric mean over rows and cols."""
    rows, cols = np.array([row, row + 1.0, row]), np.array([col, col, col + 1.0])
    here, by_row, by_col = sky.apparent(rows, cols, np.full(3, row_mid_exposure_tai_ns(header, np.array([row]))[0]))
    return float(np.sqrt(np.linalg.norm(np.cross(by_row - here, by_col - here)))) / ARCSEC_RAD
