"""Tracklets back to pixels: what the joint refit of a tracklet's frames needs, and its result as measurements."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.apparent import unit_vectors
from ground.sky.measure import ARCSEC, middle_of
from ground.streaks.joint import TrackletFrame, refit_tracklet
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution, StreakFit, StreakMeasurement, StreakPixels, Tracklet

Array = NDArray[np.float64]

UNUSABLE: Final = StreakFlag.NO_SKY | StreakFlag.POINT_LIKE | StreakFlag.FIT_FAILED | StreakFlag.FAST_ROWS
FLUX_AGREEMENT_SIGMAS: Final = 3.5
GRAVITY_ARCSEC_S2: Final = 1.0
"""Change of rate that differential gravity makes, beyond the one of straight passages."""


def refit_streaks(
    streaks: Sequence[StreakMeasurement],
    tracklets: Sequence[Tracklet],
    headers: Sequence[FrameHeader],
    solutions: Sequence[FrameSolution],
    pixels_of: Callable[[StreakMeasurement], StreakPixels],
) -> tuple[StreakMeasurement, ...]:
    """Streaks whose direction is resolved, refitted with the other frames of their tracklet; the others as they came.

    pixels_of : calibrated pixels of a streak. Sky positions are those of the old fit until they are measured anew.
    """
    header_of = {header.frame: header for header in headers}
    solution_of = {solution.frame: solution for solution in solutions}
    at = {streak.streak_id: k for k, streak in enumerate(streaks)}
    out = list(streaks)
    for tracklet in tracklets:
        members = [streaks[at[int(i)]] for i in tracklet.streak_ids]
        # two members of one frame are fragments of one trail: their inner ends are no ends
        often = Counter(m.frame for m in members)
        members = [
            m for m in members if m.flags & StreakFlag.DIRECTION_RESOLVED and not m.flags & UNUSABLE and often[m.frame] == 1
        ]
        if len(members) < 2:
            continue
        path = _path_of(members)
        frames = [
            _tracklet_frame(m, header_of[m.frame], solution_of[m.frame], pixels_of(m), path, members[0].t_tai_ns[0])
            for m in members
        ]
        # a straight passage at rate w changes its rate by up to about 2 w^2
        rate_rad_s = float(np.radians(tracklet.rate_deg_s))
        sigma_acceleration = 2.0 * rate_rad_s**2 / ARCSEC + GRAVITY_ARCSEC_S2
        for member, fit in zip(members, refit_tracklet(frames, sigma_acceleration=sigma_acceleration), strict=True):
            if fit.flags & StreakFlag.REFIT and _agrees(member.fit, fit):
                line_ns = header_of[member.frame].line_time_ns
                row_mid, col_mid = middle_of(fit)
                moved = np.array([fit.row0, row_mid, fit.row1]) - np.array([member.fit.row0, member.row_mid, member.fit.row1])
                changed = StreakFlag.REFIT | StreakFlag.ENDS_NOT_GAUSSIAN
                out[at[member.streak_id]] = replace(
                    member,
                    fit=fit,
                    row_mid=row_mid,
                    col_mid=col_mid,
                    t_tai_ns=member.t_tai_ns + np.rint(line_ns * moved).astype(np.int64),
                    flags=member.flags & ~changed | fit.flags & changed,
                )
    return tuple(out)


def _agrees(single: StreakFit, joint: StreakFit) -> bool:
    """Whether the joint fit still sees the flux of the single one; another flux is another source, a star on the track."""
    error = float(np.hypot(single.flux_err_e, joint.flux_err_e))
    return abs(joint.flux_e - single.flux_e) <= FLUX_AGREEMENT_SIGMAS * error


def _path_of(members: Sequence[StreakMeasurement]) -> Array:
    """Axes (3, 3) of the tracklet's great circle: its middle, along it in the sense of time, its pole."""
    ends = np.concatenate([unit_vectors(np.radians(m.ra_deg), np.radians(m.dec_deg)) for m in members])
    middle = ends.mean(axis=0)
    middle /= np.linalg.norm(middle)
    pole = np.linalg.svd(ends)[2][2]
    along = np.cross(pole, middle)
    along /= np.linalg.norm(along)
    if float(along @ (ends[-1] - ends[0])) < 0.0:
        along = -along
    return np.stack((middle, along, np.cross(middle, along)))


def _tracklet_frame(
    streak: StreakMeasurement, header: FrameHeader, solution: FrameSolution, pixels: StreakPixels, path: Array, zero_tai_ns: int
) -> TrackletFrame:
    """One frame of the refit: coordinates along the path in arcsec, times in seconds from `zero_tai_ns`."""
    seen = unit_vectors(np.radians(streak.ra_deg), np.radians(streak.dec_deg)) @ path.T
    along = np.arctan2(seen[:, 1], seen[:, 0]) / ARCSEC
    pointing = np.asarray(solution.covariance_rad2)
    return TrackletFrame(
        pixels=pixels,
        fit=streak.fit,
        along0=float(along[0]),
        along1=float(along[2]),
        along_per_px=float(along[2] - along[0]) / max(streak.fit.length_px, 1e-6),
        t_open_s=float(streak.t_tai_ns[0] - zero_tai_ns) * 1e-9,
        t_close_s=float(streak.t_tai_ns[2] - zero_tai_ns) * 1e-9,
        line_time_s=header.line_time_ns * 1e-9,
        sigma_frame=float(np.sqrt(0.5 * max(pointing[0, 0] + pointing[1, 1], 0.0))) / ARCSEC,
    )
