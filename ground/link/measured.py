"""Measurement of a tracklet on its members: directions and epochs of their ends, errors, and the motion through them.

A linker's tracklets hold the ends of single-frame fits. The published values are measured here on the published members, in the
same way for every linker.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.link.hypotheses import ENTERING, FULL, LEAVING, POINT, Nodes, end_errors_px
from ground.link.motion import N_PARAMETERS, fit_motion, kappa_sigma
from ground.link.resolve import pieces_among
from ground.link.row_errors import common_errors
from ground.normal_equations import scaled_inverse
from ground.sky.shake_model import STEADY, EndShake
from ground.sky.sphere import ARCSEC_RAD, east_north, spherical_deg, unit_vectors
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

Array = NDArray[np.float64]

EDGES: Final = ((0, StreakFlag.EDGE0), (2, StreakFlag.EDGE1))
"""Points of a streak that the shutter dates, and the flags of points that it does not date."""
SIGMA_ACCELERATION_ARCSEC_S2: Final = 0.6
"""Differential gravity on the sky, prior of the motion's acceleration: some 3 n^2 rad/s^2, orbital rate n = 1e-3 rad/s."""
LEAST_SIGMA_ARCSEC: Final = 1e-3
"""Added to every row in quadrature: rows that share all their errors still have a covariance that can be inverted."""
LONGEST_POINT_PX: Final = 6.0
"""Median length of a tracklet's members from which a point among them is not the object at mid-exposure: a trail of 6 px is told
from a star (docs/own-scenario.md). In one tracklet of trails of 10 px a star gave a point 8 arcsec off, with an error of 0.1."""
LEAST_COSINE: Final = 0.25
"""Least cosine of the angle between trail and motion. A joint fit constrains a more oblique trail hardly at all."""
INHERITED: Final = StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.SATURATED | StreakFlag.VARIABLE


@dataclass(frozen=True, kw_only=True, eq=False)
class Member:
    """A member of a tracklet.

    single, final : the single-frame fit and the published streak, both with directions at their epochs.
    jacobian_arcsec : (3, 2, 2) of (east, north) by (row, col) at the three points of `final`. pointing_arcsec : one sigma of an
    axis of its frame; sigma_rate_arcsec_s : error of the camera's rate during the exposure; end_shake : errors that this causes
    at shutter open and close.
    group, shared_arcsec : window of a joint fit (-1: none) and (2, 3) errors that both ends share with the ends of that window;
    of points the same for the middle, in the first row (`foretold`). shared_cross_arcsec : (2, 3) errors across that both ends
    share with all ends on one line (`common_line`); zero for members that are on none.
    """

    single: StreakMeasurement
    final: StreakMeasurement
    jacobian_arcsec: Array
    pointing_arcsec: float
    sigma_rate_arcsec_s: float = 0.0
    end_shake: EndShake = STEADY
    group: int = -1
    shared_arcsec: Array
    shared_cross_arcsec: Array = field(default_factory=lambda: np.zeros((2, 3)))

    @property
    def is_on_line(self) -> bool:
        """Whether its place across the motion is that of a line through all frames."""
        return bool(self.shared_cross_arcsec.any())


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """Dated directions by time. covariance : (m, 2, 2) arcsec^2, headings : (m, 2) of motion, east, north; shared, shared_cross :
    (m, 3).

    narrower : (m,) variance along the motion minus the square of half the 68 % interval, arcsec^2.
    """

    streak_id: NDArray[np.int64]
    point: NDArray[np.int64]
    t_tai_ns: NDArray[np.int64]
    ra_deg: Array
    dec_deg: Array
    covariance: Array
    headings: Array
    group: NDArray[np.int64]
    shared: Array
    shared_cross: Array
    pointing: Array
    turning: Array
    frame: NDArray[np.int64]
    narrower: Array


def measured_tracklet(tracklet: Tracklet, members: Sequence[Member]) -> Tracklet:
    """The linker's tracklet with everything that is measured on its members; magnitudes do not change.

    Without two dated directions there is no motion: NaN.
    """
    final = [member.final for member in members]
    whole = [m for m, piece in zip(members, pieces_among(final, tracklet), strict=True) if not piece]
    rows = _rows_of(whole)
    sky = not any(s.flags & StreakFlag.NO_SKY for s in final)
    flags = StreakFlag(int(np.bitwise_or.reduce([int(s.flags) for s in final]))) & INHERITED
    flags |= StreakFlag.DIRECTION_RESOLVED if tracklet.direction_resolved else StreakFlag(0)
    flags |= StreakFlag(0) if sky else StreakFlag.NO_SKY
    t_ref_ns = int(rows.t_tai_ns[0]) + round(float((rows.t_tai_ns - rows.t_tai_ns[0]).mean())) if len(rows.t_tai_ns) else 0
    known = replace(
        tracklet,
        t_tai_ns=rows.t_tai_ns,
        ra_deg=rows.ra_deg,
        dec_deg=rows.dec_deg,
        row_streak_ids=rows.streak_id,
        row_points=rows.point,
        shared_arcsec=rows.shared,
        shared_group=rows.group,
        shared_cross_arcsec=rows.shared_cross,
        pointing_arcsec=rows.pointing,
        turning_arcsec=rows.turning,
        t_ref_tai_ns=t_ref_ns,
        flags=flags,
    )
    return replace(known, **_motion(rows, t_ref_ns), chi2_nu=_chi2_nu(whole) if sky else tracklet.chi2_nu)


def _rows_of(members: Sequence[Member]) -> _Rows:
    """The dated directions of members: both ends, except those on the frame's edge; the middle of a point or of an unresolved
    streak.

    A point among trails has no direction: it is a star on the trail, or a flash whose time within the exposure is unknown.
    """
    found: list[tuple[Member, int, Array]] = []
    trails = _are_trails(members)
    for member in members:
        streak = member.final
        if trails and streak.flags & StreakFlag.POINT_LIKE:
            continue
        if streak.flags & StreakFlag.DIRECTION_RESOLVED and not streak.flags & StreakFlag.POINT_LIKE:
            found += [(member, p, member.shared_arcsec[p // 2]) for p, edge in EDGES if not streak.flags & edge]
        elif streak.flags & StreakFlag.POINT_LIKE or not streak.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1):
            found.append((member, 1, member.shared_arcsec[0] if streak.fit.is_foretold else np.zeros(3)))
    found.sort(key=lambda row: (int(row[0].final.t_tai_ns[row[1]]), row[0].final.streak_id))
    t_tai_ns = np.array([m.final.t_tai_ns[p] for m, p, _ in found], dtype=np.int64)
    ra_deg, dec_deg = (np.array([getattr(m.final, name)[p] for m, p, _ in found]) for name in ("ra_deg", "dec_deg"))
    headings = _headings(t_tai_ns, unit_vectors(np.radians(ra_deg), np.radians(dec_deg)))
    slants = [_slant(m, p, heading) for (m, p, _), heading in zip(found, headings, strict=True)]
    turning = [slant * turning_arcsec(m.final, m.sigma_rate_arcsec_s, p) for (m, p, _), slant in zip(found, slants, strict=True)]
    return _Rows(
        streak_id=np.array([m.final.streak_id for m, _, _ in found], dtype=np.int64),
        point=np.array([p for _, p, _ in found], dtype=np.int64),
        t_tai_ns=t_tai_ns,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        covariance=np.array(
            [_covariance_arcsec2(m, p, h, s) for (m, p, _), h, s in zip(found, headings, slants, strict=True)]
        ).reshape(-1, 2, 2),
        headings=headings,
        group=np.array([m.group if p != 1 or m.final.fit.is_foretold else -1 for m, p, _ in found], dtype=np.int64),
        shared=np.array([shared for _, _, shared in found]).reshape(-1, 3),
        shared_cross=np.array([np.zeros(3) if p == 1 else m.shared_cross_arcsec[p // 2] for m, p, _ in found]).reshape(-1, 3),
        pointing=np.array([m.pointing_arcsec for m, _, _ in found], dtype=np.float64),
        turning=np.array(turning, dtype=np.float64),
        frame=np.array([m.final.frame for m, _, _ in found], dtype=np.int64),
        narrower=np.array([_narrower_arcsec2(m, p, h) for (m, p, _), h in zip(found, headings, strict=True)], dtype=np.float64),
    )


def _are_trails(members: Sequence[Member]) -> bool:
    """Whether most members are long enough to be told from points, so that the object cannot be one."""
    lengths = [0.0 if m.final.flags & StreakFlag.POINT_LIKE else m.final.fit.length_px for m in members]
    return bool(lengths) and float(np.median(lengths)) > LONGEST_POINT_PX


def _slant(member: Member, point: int, heading: Array) -> float:
    """Ratio of the error across the motion to the error across the trail that causes it. It is 1 except for refitted ends.

    If the camera turns, the trail of a slow object lies at an angle to its motion. The joint fit moves an end along the trail to
    the place of the motion. The error of the end across the trail then appears across the motion, divided by the cosine of the
    angle. A member on one line with others is placed across the motion, not across its trail.
    """
    if point == 1 or member.is_on_line or not member.final.flags & StreakFlag.REFIT or not np.isfinite(heading).all():
        return 1.0
    trail = _trail_heading(member, point)
    return 1.0 / max(abs(float(trail @ heading)), LEAST_COSINE)


def _trail_heading(member: Member, point: int) -> Array:
    """Direction (2,) of a trail, end 0 to end 1, east and north, with both ends at one attitude of the camera."""
    fit = member.final.fit
    along = member.jacobian_arcsec[point] @ np.array([fit.row1 - fit.row0, fit.col1 - fit.col0])
    return np.asarray(along / max(float(np.linalg.norm(along)), 1e-12))


def _narrower_arcsec2(member: Member, point: int, heading: Array) -> float:
    """Variance of a jointly fitted end along the motion minus the square of half its 68 % interval; 0 of other points.

    The posterior of a change point has heavy tails: its standard deviation holds more than 68 %.
    """
    fit = member.final.fit
    if point == 1 or not member.final.flags & StreakFlag.REFIT or not np.isfinite(heading).all():
        return 0.0
    along = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / max(fit.length_px, 1e-6)
    start = 2 * (point // 2)
    variance = float(along @ np.asarray(fit.covariance_px2)[start : start + 2, start : start + 2] @ along)
    half = 0.5 * float(np.ptp(np.asarray(fit.end_interval_px)[point // 2]))
    scale_arcsec = float(member.jacobian_arcsec[point] @ along @ heading)
    found = (variance - half**2) * scale_arcsec**2 - member.pointing_arcsec**2
    return found if math.isfinite(found) else 0.0


def turning_arcsec(streak: StreakMeasurement, sigma_rate_arcsec_s: float, point: int) -> float:
    """Error of a point from an error of the camera's rate: zero in the middle, opposite at both ends."""
    return (point - 1) * sigma_rate_arcsec_s * 0.5e-9 * abs(float(streak.t_tai_ns[2] - streak.t_tai_ns[0]))


def _covariance_arcsec2(member: Member, point: int, heading: Array, slant: float) -> Array:
    """Covariance (2, 2) of a point east and north; an end of a single fit that is a change point counts by its interval.

    heading : of the motion. slant : of the trail to it (`_slant`).
    """
    fit, jacobian = member.final.fit, member.jacobian_arcsec[point]
    blocks = np.asarray(fit.covariance_px2).reshape(2, 2, 2, 2).transpose(0, 2, 1, 3)
    if point == 1:
        return np.asarray(jacobian @ blocks.sum(axis=(0, 1)) @ jacobian.T / 4.0 + member.pointing_arcsec**2 * np.eye(2))
    # the attitude of an end is that of mid-exposure, turned by half an exposure; across, the line averages over the shake
    turning = turning_arcsec(member.final, member.sigma_rate_arcsec_s, point)
    block = blocks[point // 2, point // 2]
    along = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / max(fit.length_px, 1e-6)
    across = np.array([-along[1], along[0]])
    # the covariance of a joint fit is that of its draws, their tails included; widened once more it held 85 % within one sigma
    alone = not member.final.flags & StreakFlag.REFIT
    if not np.isfinite(block).all() or (alone and fit.flags & StreakFlag.ENDS_NOT_GAUSSIAN):
        sigma_along, sigma_cross = end_errors_px([member.final])
        block = sigma_along[0, point // 2] ** 2 * np.outer(along, along) + sigma_cross[0] ** 2 * np.outer(across, across)
    trail = _trail_heading(member, point)
    side = np.array([-trail[1], trail[0]])
    if member.final.flags & StreakFlag.REFIT and np.isfinite(heading).all():
        # the joint fit has already included the attitude's errors along the motion in the ends
        beside = np.array([-heading[1], heading[0]])
        off = float(across @ block @ across) * float(np.linalg.norm(jacobian @ across)) ** 2
        if member.is_on_line:
            off = float(np.sum(member.shared_cross_arcsec[point // 2] ** 2))
        off += member.pointing_arcsec**2 + turning**2
        way = jacobian @ along
        return np.asarray(float(along @ block @ along) * np.outer(way, way) + slant**2 * off * np.outer(beside, beside))
    sway = member.end_shake.sway(fit.length_px, fit.width_px)
    attitude = member.pointing_arcsec**2 + (member.end_shake.turn**2 + sway**2) * turning**2
    pointing = attitude * np.outer(trail, trail) + (member.pointing_arcsec**2 + turning**2) * np.outer(side, side)
    return np.asarray(jacobian @ block @ jacobian.T + pointing)


def _motion(rows: _Rows, t_ref_ns: int) -> dict[str, Any]:
    """Fields of a tracklet from the motion through its rows; NaN with fewer than two rows."""
    nan = math.nan
    m = len(rows.t_tai_ns)
    along, cross, correlation, angle, half68 = (np.full(m, nan) for _ in range(5))
    out: dict[str, Any] = dict.fromkeys(("ra_ref_deg", "dec_ref_deg", "rate_deg_s", "rate_err_deg_s", "position_angle_deg"), nan)
    t_s = np.asarray((rows.t_tai_ns - t_ref_ns) * 1e-9, dtype=np.float64)
    unit = unit_vectors(np.radians(rows.ra_deg), np.radians(rows.dec_deg))
    if m >= 2 and np.isfinite(unit).all() and len(np.unique(rows.t_tai_ns)) >= 2:
        centre, plane = _plane_of(unit)
        headings = rows.headings
        axes = np.stack([np.stack([np.array([s, c]), np.array([c, -s])]) for s, c in headings])
        turned = axes @ rows.covariance @ axes.transpose(0, 2, 1)
        along, cross = np.sqrt(turned[:, 0, 0]), np.sqrt(turned[:, 1, 1])
        correlation = turned[:, 0, 1] / np.maximum(along * cross, 1e-12)
        angle = np.degrees(np.arctan2(headings[:, 0], headings[:, 1])) % 360.0
        half68 = np.sqrt(np.maximum(turned[:, 0, 0] - np.maximum(rows.narrower, 0.0), 0.0))
        here, rate, rate_err = _fitted(t_s, unit, centre, plane, _joint_covariance(rows, turned), headings)
        ra_ref, dec_ref = spherical_deg(here[None, :])
        east, north = east_north(here)
        out = {
            "ra_ref_deg": float(ra_ref[0]),
            "dec_ref_deg": float(dec_ref[0]),
            "rate_deg_s": math.degrees(float(np.linalg.norm(rate))),
            "rate_err_deg_s": math.degrees(rate_err),
            "position_angle_deg": math.degrees(math.atan2(float(rate @ east), float(rate @ north))) % 360.0,
        }
    return out | {
        "sigma_along_arcsec": along,
        "sigma_cross_arcsec": cross,
        "correlation": correlation,
        "motion_angle_deg": angle,
        "half68_along_arcsec": half68,
    }


def _headings(t_tai_ns: NDArray[np.int64], unit: Array) -> Array:
    """Direction of motion (m, 2) at each row, east and north there: of a parabola through all rows; NaN without two epochs."""
    m = len(t_tai_ns)
    if m < 2 or not np.isfinite(unit).all() or len(np.unique(t_tai_ns)) < 2:
        return np.full((m, 2), np.nan)
    centre, plane = _plane_of(unit)
    t_s = (t_tai_ns - t_tai_ns[0]) * 1e-9
    t_s = t_s - t_s.mean()
    placed = unit @ plane.T / (unit @ centre)[:, None]
    terms = np.vander(t_s, min(3, len(np.unique(t_s))), increasing=True)
    coefficients = np.linalg.lstsq(terms, placed, rcond=None)[0]
    slopes = np.column_stack([np.zeros_like(t_s), np.ones_like(t_s), 2.0 * t_s])[:, : terms.shape[1]]
    moving = slopes @ coefficients @ plane
    out = []
    for u, v in zip(unit, moving, strict=True):
        east, north = east_north(u)
        heading = np.array([v @ east, v @ north])
        length = float(np.linalg.norm(heading))
        out.append(heading / length if length > 0.0 else np.array([0.0, 1.0]))
    return np.array(out)


def _plane_of(unit: Array) -> tuple[Array, Array]:
    """Middle (3,) of directions and axes (2, 3) east and north there."""
    centre = unit.mean(axis=0) / np.linalg.norm(unit.mean(axis=0))
    return centre, np.stack(east_north(centre))


def _joint_covariance(rows: _Rows, each: Array) -> Array:
    """Covariance (2 m, 2 m) of all rows along, then all across, arcsec^2. each : (m, 2, 2) of single rows."""
    m = len(rows.t_tai_ns)
    common, same_frame = common_errors(
        rows.shared, rows.group, rows.pointing, rows.turning, rows.frame, rows.point, rows.shared_cross
    )
    k = np.arange(m)
    own = each.copy()
    own[:, 0, 0] -= common[k, k]
    own[:, 1, 1] -= same_frame[k, k]
    # the row's own part is a difference of similar numbers
    variance, axes = np.linalg.eigh(own)
    own = (axes * np.maximum(variance, LEAST_SIGMA_ARCSEC**2)[:, None, :]) @ axes.transpose(0, 2, 1)
    out = np.zeros((2 * m, 2 * m))
    out[:m, :m], out[m:, m:] = common, same_frame
    out[k, k] += own[:, 0, 0]
    out[k + m, k + m] += own[:, 1, 1]
    out[k, k + m] = out[k + m, k] = own[:, 0, 1]
    return out


def _fitted(
    t_s: Array, unit: Array, centre: Array, plane: Array, covariance_arcsec2: Array, headings: Array
) -> tuple[Array, Array, float]:
    """Direction (3,), rate (3,) in rad/s and error of its length, rad/s, at the reference epoch.

    Generalised least squares of the model of `motion.fit_motion`, a projective straight line with a small acceleration.
    """
    m = len(t_s)
    placed = unit @ plane.T / (unit @ centre)[:, None]
    rows, seen = np.zeros((2 * m, N_PARAMETERS)), np.zeros(2 * m)
    for k in range(m):
        east, north = east_north(unit[k])
        heading = headings[k, 0] * east + headings[k, 1] * north
        for block, axis in enumerate((heading, np.cross(heading, unit[k]))):
            n = plane @ axis
            n = n / np.linalg.norm(n)
            seen[k + block * m] = n @ placed[k]
            rows[k + block * m] = (*n, *(n * t_s[k]), -seen[k + block * m] * t_s[k], *(0.5 * n * t_s[k] ** 2))
    speed = float(np.linalg.norm(placed[-1] - placed[0]) / max(t_s[-1] - t_s[0], 1e-6))
    sigma = SIGMA_ACCELERATION_ARCSEC_S2 * ARCSEC_RAD
    weight = np.linalg.inv(covariance_arcsec2 * ARCSEC_RAD**2)
    information = rows.T @ weight @ rows + np.diag([0.0, 0.0, 0.0, 0.0, kappa_sigma(speed) ** -2, sigma**-2, sigma**-2])
    covariance = scaled_inverse(information)
    x0, y0, vx, vy, kappa, _, _ = theta = covariance @ (rows.T @ weight @ seen)
    # x(t) = (x0 + v t + ...) / (1 + kappa t): the velocity at t = 0 is v - kappa x0
    velocity = np.array([vx - kappa * x0, vy - kappa * y0])
    slope = np.array([[0.0, 0.0, 1.0, 0.0, -x0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0, -y0, 0.0, 0.0]])
    slope[0, 0] = slope[1, 1] = -kappa
    direction = velocity / max(float(np.linalg.norm(velocity)), 1e-15) @ slope
    here = centre + theta[:2] @ plane
    depth = float(np.linalg.norm(here))
    moving = velocity @ plane
    rate = (moving - here * float(here @ moving) / depth**2) / depth
    return here / depth, rate, math.sqrt(max(float(direction @ covariance @ direction), 0.0))


def _chi2_nu(members: Sequence[Member]) -> float:
    """Reduced chi-square of one motion against the single-frame fits of the members; NaN for fewer than two.

    With four members or more, outlying ends are weighted as change points (`motion.fit_motion`).
    """
    edges = StreakFlag.EDGE0 | StreakFlag.EDGE1
    used = [m for m in members if m.single.flags & StreakFlag.POINT_LIKE or (m.single.flags & edges) != edges]
    used = [m for m in used if m.single.flags & (StreakFlag.DIRECTION_RESOLVED | StreakFlag.POINT_LIKE)]
    used.sort(key=lambda m: int(m.single.t_tai_ns[1]))
    if len(used) < 2:
        return math.nan
    streaks = [m.single for m in used]
    point = np.array([bool(s.flags & StreakFlag.POINT_LIKE) for s in streaks])
    cut0, cut1 = (np.array([bool(s.flags & flag) for s in streaks]) for _, flag in EDGES)
    points = np.where(point[:, None], 1, np.array([[0, 2]]))
    at = np.arange(len(used))[:, None]
    ra, dec = (np.radians(np.array([getattr(s, name) for s in streaks])) for name in ("ra_deg", "dec_deg"))
    unit = unit_vectors(ra, dec)[at, points]
    t_ns = np.array([s.t_tai_ns for s in streaks])[at, points]
    zero_ns = int(t_ns.min())
    along_px, cross_px = end_errors_px(streaks)
    scale = np.array([math.sqrt(abs(float(np.linalg.det(m.jacobian_arcsec[1])))) for m in used])
    sigma = np.hypot(np.column_stack([along_px, cross_px]) * scale[:, None], [[m.pointing_arcsec] for m in used]) * ARCSEC_RAD
    # The fit uses kind, epochs, directions and errors of a hypothesis. The other fields are for the search.
    count, none = len(used), np.zeros(len(used))
    nodes = Nodes(
        frame=np.arange(count),
        kind=np.select([point, cut0, cut1], [POINT, ENTERING, LEAVING], FULL).astype(np.int8),
        t_s=(t_ns - zero_ns) * 1e-9,
        unit=np.ascontiguousarray(unit),
        sigma_rad=np.maximum(sigma, LEAST_SIGMA_ARCSEC * ARCSEC_RAD),
        measured_rad=sigma,
        vetoed=np.zeros(count, dtype=np.bool_),
        length_rad=none,
        duration_s=none,
        fastest_rad_s=none,
        log_clutter=none,
        log_odds=none,
        order=np.arange(count),
        sorted_key=none,
        first=np.zeros(count + 1, dtype=np.int64),
        axis=0,
    )
    chi2, _, n_rows, _ = fit_motion(
        nodes, np.arange(count), 0.0, SIGMA_ACCELERATION_ARCSEC_S2 * ARCSEC_RAD, np.empty(3), np.empty((2, 3)),
        np.empty(N_PARAMETERS), np.empty((N_PARAMETERS, N_PARAMETERS)),
    )  # fmt: skip
    return float(chi2 / max(n_rows - 4, 1))
