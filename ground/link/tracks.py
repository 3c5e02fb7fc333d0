"""A linked track and its product, the `Tracklet`."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.link.hypotheses import ENTERING, LEAVING, POINT, FrameTable, StreakTable
from ground.link.motion import N_PARAMETERS, position_on_plane, velocity_on_plane
from ground.photometry.magnitude import mean_magnitude
from ground.sky.sphere import ARCSEC_RAD, spherical_deg
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import Tracklet


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Hypotheses in time order and the motion through them (parameters of `motion.fit_motion`).

    points : (n, 2) epochs, units : (n, 2, 3) directions, sigma_rad : (n, 3) as measured, kinds : (n,) of the members.
    covariance : (7, 7) of theta. pieces : streaks (rows of the table) of broken trails that lie on the track.
    """

    members: NDArray[np.int64]
    log_odds: float
    chi2_nu: float
    t_ref_s: float
    centre: NDArray[np.float64]
    basis: NDArray[np.float64]
    theta: NDArray[np.float64]
    covariance: NDArray[np.float64]
    points: NDArray[np.float64]
    kinds: NDArray[np.int64]
    sigma_rad: NDArray[np.float64]
    units: NDArray[np.float64]
    pieces: NDArray[np.int64]


def tracklet_of(
    number: int,
    track: Track,
    table: StreakTable,
    frames: FrameTable,
    sky: bool,
) -> Tracklet:
    """The contract's record of a track; directions and rates are NaN when it was linked in pixels."""
    chosen = track.members // 2
    whole = np.sort(np.concatenate([chosen, track.pieces]))
    timed = np.column_stack([track.kinds != ENTERING, (track.kinds != LEAVING) & (track.kinds != POINT)])
    unit, t_s = track.units[timed], track.points[timed]
    by_time = np.argsort(t_s, kind="stable")
    unit, t_s = unit[by_time], t_s[by_time]
    along = track.sigma_rad[:, :2][timed][by_time]
    across = np.repeat(track.sigma_rad[:, 2:], 2, axis=1)[timed][by_time]
    ra, dec = _sky(unit, sky)

    x, y = position_on_plane(track.theta, 0.0)
    vx, vy = velocity_on_plane(track.theta, 0.0)
    here = track.centre + x * track.basis[0] + y * track.basis[1]
    there = track.centre + (x + vx) * track.basis[0] + (y + vy) * track.basis[1]
    depth = float(np.linalg.norm(here))
    rate = (there - here - here * float(np.dot(here, there - here)) / depth**2) / depth
    here = here / depth
    ra_ref, dec_ref = _sky(here[None, :], sky)
    east = np.array([-here[1], here[0], 0.0]) / max(math.hypot(here[0], here[1]), 1e-12)
    north = np.cross(here, east)
    speed = math.hypot(vx, vy)
    direction = np.zeros(N_PARAMETERS)
    direction[2], direction[3] = vx / max(speed, 1e-15), vy / max(speed, 1e-15)
    rate_err = math.sqrt(max(float(direction @ track.covariance @ direction), 0.0))
    mag, mag_err = mean_magnitude(table.mag[chosen], table.mag_err[chosen])
    inherited = StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.SATURATED | StreakFlag.VARIABLE
    flags = StreakFlag(int(np.bitwise_or.reduce(table.flags[chosen]))) & inherited
    directed = bool(np.any(track.kinds != POINT)) or len(chosen) > 2
    if directed:
        flags |= StreakFlag.DIRECTION_RESOLVED
    if not sky:
        flags |= StreakFlag.NO_SKY
    return Tracklet(
        tracklet_id=number,
        streak_ids=table.streak_id[whole],
        frames=frames.number[table.frame[whole]],
        t_tai_ns=frames.origin_tai_ns + np.round(t_s * 1e9).astype(np.int64),
        ra_deg=ra,
        dec_deg=dec,
        sigma_along_arcsec=along / ARCSEC_RAD if sky else np.full(len(ra), np.nan),
        sigma_cross_arcsec=across / ARCSEC_RAD if sky else np.full(len(ra), np.nan),
        t_ref_tai_ns=frames.origin_tai_ns + round(track.t_ref_s * 1e9),
        ra_ref_deg=float(ra_ref[0]),
        dec_ref_deg=float(dec_ref[0]),
        rate_deg_s=math.degrees(float(np.linalg.norm(rate))) if sky else math.nan,
        rate_err_deg_s=math.degrees(rate_err) if sky else math.nan,
        position_angle_deg=math.degrees(math.atan2(float(rate @ east), float(rate @ north))) % 360.0 if sky else math.nan,
        mag=mag,
        mag_err=mag_err,
        chi2_nu=track.chi2_nu,
        probability=1.0 / (1.0 + math.exp(-min(track.log_odds, 700.0))),
        direction_resolved=directed,
        flags=flags,
        pieces=table.streak_id[np.sort(track.pieces)],
    )


def _sky(unit: NDArray[np.float64], sky: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension in [0, 360) and declination (deg) of unit vectors (m, 3); NaN when they are no sky directions."""
    return spherical_deg(unit if sky else np.full_like(unit, np.nan))
