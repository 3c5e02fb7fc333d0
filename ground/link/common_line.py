"""Where the members of an on-board track lie across their motion: on one line through all of their frames.

A trail of S/N 4 is placed by its own frame to a third of a pixel across. All n frames of its track together know the place of
the line better by the root of n. So members are moved across onto the line, each with the line's error there. Where a frame
alone does not show its trail, the line is fitted to the frame's pixels, else to the frame's place and tilt.

A straight passage is a straight line in the tangent plane of any direction, whatever the range does. Differential gravity
bends it by a parabola of time with a narrow prior, which is fitted as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.link.measured import SIGMA_ACCELERATION_ARCSEC_S2
from ground.link.pixel_line import CrossedFrame, line_of_pixels
from ground.normal_equations import scaled_inverse
from ground.sky.gravity import Bend, bend_by_gravity
from ground.sky.measure import middle_of
from ground.sky.sphere import ARCSEC_RAD, east_north, unit_vectors
from ground.streaks.across import AcrossPixels
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import ObserverState
from sboc_e2e.icd.products import StreakFit, StreakMeasurement, StreakPixels

Array = NDArray[np.float64]

OFF_LINE_SIGMAS: Final = 3.5
"""A right place in 2,000 is farther off the line. What is, is a star or noise."""

LEAST_TILT: Final = 1e-6
"""Variance of the ends' difference over that of their mean, both across the trail, below which the fit was given its direction
and knows nothing of it. A trail of even light that has both free has 12."""

LEAST_PX: Final = 0.05
"""Added in quadrature to the ends of trails that were fitted freely, for errors of the PSF's model. Chosen, not measured: it
widens a trail of S/N 8 by 5 % and halves the weight of one of S/N 26."""

LEAST_SHARE: Final = 0.05
"""Of a place's variance, in its distance from a line that it alone decides: the two would be equal but for rounding."""

LEAST_AGREEING: Final = 3
"""Places that do not lie on one line do not say which of them is wrong while they are so few."""

UNUSABLE: Final = StreakFlag.NO_SKY | StreakFlag.POINT_LIKE | StreakFlag.FIT_FAILED | StreakFlag.FAST_ROWS


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedTrail:
    """A member of a tracklet, with its place on the sky.

    jacobian_arcsec : (3, 2, 2) of (east, north) by (row, col) at its three points. pointing_arcsec : one sigma of an axis of its
    frame. turning_arcsec : of an end, by the error of the camera's rate. pixels : calibrated; None where they are not at hand.
    """

    streak: StreakMeasurement
    jacobian_arcsec: Array
    pointing_arcsec: float
    turning_arcsec: float = 0.0
    pixels: StreakPixels | None = None

    @property
    def is_usable(self) -> bool:
        """Whether it is a trail with a direction and places on the sky."""
        streak = self.streak
        seen = bool(streak.flags & StreakFlag.DIRECTION_RESOLVED) and not (streak.flags & UNUSABLE or streak.fit.is_foretold)
        return seen and bool(np.isfinite(streak.ra_deg).all() and np.isfinite(self.jacobian_arcsec).all())


class _Plane:
    """The tangent plane about the middle of a tracklet, in arcsec along its motion and across."""

    def __init__(self, ends: Array, zero_ns: int) -> None:
        middle = ends.mean(axis=0)
        self.middle = middle / np.linalg.norm(middle)
        pole = np.linalg.svd(ends)[2][2]
        self.pole = pole - (pole @ self.middle) * self.middle
        self.pole /= np.linalg.norm(self.pole)
        self.way = np.cross(self.pole, self.middle)
        self.zero_ns = zero_ns

    def along(self, unit: Array) -> Array:
        """Of directions (n, 3)."""
        return np.asarray((unit @ self.way) / (unit @ self.middle) / ARCSEC_RAD)

    def across(self, unit: Array) -> Array:
        """Of directions (n, 3)."""
        return np.asarray((unit @ self.pole) / (unit @ self.middle) / ARCSEC_RAD)

    def rows(self, along: Array, t_tai_ns: NDArray[np.int64]) -> Array:
        """The line's three terms (n, 3) at places and epochs."""
        t_s = (t_tai_ns - self.zero_ns) * 1e-9
        return np.stack([np.ones_like(along), along, 0.5 * t_s**2], axis=1)


class CommonLine(NamedTuple):
    """Members moved onto one line, by their place among the trails.

    shared_arcsec : (2, 3) of each: ends i and j have the covariance ``shared[i] @ shared[j]`` across the motion, pointing apart.
    It is that of the line: every end is a linear function of its three numbers.
    """

    members: dict[int, StreakMeasurement]
    shared_arcsec: dict[int, Array]


class _Line(NamedTuple):
    """A line in a plane: parameters (3,), covariance (3, 3); of `used` trails, number of those that agree on it.

    off : distance of each trail's place from it, in its errors.
    """

    plane: _Plane
    parameters: Array
    covariance: Array
    used: list[int]
    off: dict[int, float]


def on_common_line(trails: Sequence[PlacedTrail], observer: ObserverState | None = None) -> CommonLine:
    """The members of on-board tracks moved across onto the line of all members.

    The line is that of the members that the joint refit took for light of one object, or of all where it took fewer than two.
    Members off the line do not count. They are moved, too, where enough others agree: a star or noise shifted them. Their light
    is that on the line. The ends' errors along the trail are kept. Those across are of the line, which all members share, and of
    their frame's pointing. Directions are still those before; the caller measures them again.

    observer : the camera's place, which tells how gravity bends the line.
    """
    movable = [k for k, trail in enumerate(trails) if trail.is_usable and trail.streak.track >= 0]
    nothing = CommonLine({}, {})
    if not movable:
        return nothing
    usable = [k for k, trail in enumerate(trails) if trail.is_usable]
    refitted = [k for k in usable if trails[k].streak.flags & StreakFlag.REFIT]
    members = refitted if len(refitted) >= 2 else usable
    if len(members) < 2:
        return nothing
    units = [_units(trail.streak) for trail in trails]
    line = _through_pixels(trails, units, members, _through_places(trails, units, members, movable, observer), observer)
    disagree = line.off[max(line.used, key=lambda k: line.off[k])] > OFF_LINE_SIGMAS
    if disagree or len(line.used) < 2:
        return nothing
    sure = len(line.used) > LEAST_AGREEING
    on_line = [k for k in movable if sure or line.off[k] <= OFF_LINE_SIGMAS]
    moved = {k: _moved(trails[k], units[k], line.plane, line.parameters, line.covariance) for k in on_line}
    root = np.linalg.cholesky(line.covariance)
    return CommonLine(moved, {k: _ends_rows(trails[k], units[k], line.plane) @ root for k in on_line})


def _through_places(
    trails: Sequence[PlacedTrail], units: list[Array], members: list[int], movable: list[int], observer: ObserverState | None
) -> _Line:
    """The line through the places of the members without those off it, as long as enough are left."""
    used = members
    while True:
        plane = _plane_of(trails, units, used)
        shares = _even({k: _evidence(trails[k], units[k], plane) for k in {*used, *movable}}, used)
        information, right = _of_places(shares, used, _bend(trails, units, used, plane, observer))
        covariance = scaled_inverse(information)
        line = covariance @ right
        off = {k: _off_line(shares[k], line, covariance, is_part=k in used) for k in shares}
        worst = max(used, key=lambda k: off[k])
        if off[worst] <= OFF_LINE_SIGMAS or len(used) <= LEAST_AGREEING:
            return _Line(plane, line, covariance, used, off)
        used = [k for k in used if k != worst]


def _through_pixels(
    trails: Sequence[PlacedTrail], units: list[Array], members: list[int], start: _Line, observer: ObserverState | None
) -> _Line:
    """The line through the pixels of the members that were placed on their track's direction, and the places of the others.

    That through the places alone, where there are no such pixels or they lead away from it.
    """
    plane = start.plane
    shares = {k: _evidence(trails[k], units[k], plane) for k in members}
    faint = [k for k in members if len(shares[k][0]) == 1]
    frames = {k: frame for k in faint if (frame := _crossed(trails[k], units[k], plane)) is not None}
    bright = [k for k in start.used if k not in faint]
    if len(frames) < 2:
        return start
    known = _of_places(_even(shares, members), bright, _bend(trails, units, start.used, plane, observer))
    found = line_of_pixels(list(frames.values()), start.parameters, *known)
    if found is None:
        return start
    counts = [k for k, on in zip(frames, found.counts.tolist(), strict=True) if on]
    off = dict(start.off) | {k: 0.0 if k in counts else np.inf for k in frames}
    return _Line(plane, found.parameters, found.covariance, [*bright, *counts], off)


def _plane_of(trails: Sequence[PlacedTrail], units: list[Array], used: Sequence[int]) -> _Plane:
    epochs = np.array([trails[k].streak.t_tai_ns[1] for k in used], dtype=np.int64)
    return _Plane(np.concatenate([units[k][[0, 2]] for k in used]), int(epochs[0] + np.mean(epochs - epochs[0])))


def _bend(
    trails: Sequence[PlacedTrail], units: list[Array], used: Sequence[int], plane: _Plane, observer: ObserverState | None
) -> Bend:
    """What is known of the line's third parameter."""
    t_s = np.concatenate([(trails[k].streak.t_tai_ns[[0, 2]] - plane.zero_ns) * 1e-9 for k in used])
    along = np.concatenate([plane.along(units[k][[0, 2]]) for k in used])
    rate = float(np.ptp(along)) / max(float(np.ptp(t_s)), 1e-6)
    return bend_by_gravity(observer, plane.middle, plane.pole, rate) or Bend(0.0, SIGMA_ACCELERATION_ARCSEC_S2)


def _of_places(shares: dict[int, tuple[Array, Array, Array]], used: Sequence[int], bend: Bend) -> tuple[Array, Array]:
    """Normal equations (3, 3) and (3,) of the places of the trails used and of the bend."""
    information = np.diag([0.0, 0.0, bend.sigma**-2])
    right = np.array([0.0, 0.0, bend.mean * bend.sigma**-2])
    for rows, values, weights in (shares[k] for k in used):
        information += (rows * weights[:, None]).T @ rows
        right += rows.T @ (weights * values)
    return information, right


def _crossed(trail: PlacedTrail, units: Array, plane: _Plane) -> CrossedFrame | None:
    """The pixels of a trail, and how a line in the plane moves it; None without pixels."""
    pixels = None if trail.pixels is None else AcrossPixels.of(trail.streak.fit, trail.pixels)
    if pixels is None:
        return None
    ends = units[[0, 2]]
    steps = np.array([pixels.across_px(_step_px(trail, units, plane, point)) for point in (0, 2)])
    to_place = 0.5 * np.array([[1.0, 1.0], [-1.0, 1.0]]) * steps
    per_arcsec = float(np.abs(steps).mean())
    return CrossedFrame(
        pixels=pixels,
        offset_px=-to_place @ plane.across(ends),
        by_line=to_place @ _ends_rows(trail, units, plane),
        variance_px2=(per_arcsec * np.array([trail.pointing_arcsec, trail.turning_arcsec])) ** 2,
    )


def _ends_rows(trail: PlacedTrail, units: Array, plane: _Plane) -> Array:
    """The line's three terms (2, 3) at both ends of a trail."""
    return plane.rows(plane.along(units[[0, 2]]), trail.streak.t_tai_ns[[0, 2]])


def _step_px(trail: PlacedTrail, units: Array, plane: _Plane, point: int) -> Array:
    """Row and col (2,) by which a point of a trail moves for an arcsec across the motion."""
    return np.asarray(np.linalg.solve(trail.jacobian_arcsec[point], _side(units[point], plane)))


def _units(streak: StreakMeasurement) -> Array:
    """Directions (3, 3) of end 0, middle and end 1."""
    return np.asarray(unit_vectors(np.radians(streak.ra_deg), np.radians(streak.dec_deg)))


def _side(unit: Array, plane: _Plane) -> Array:
    """Across the motion, east and north (2,) of a direction (3,)."""
    side = np.array(east_north(unit)) @ plane.pole
    return np.asarray(side / np.linalg.norm(side))


def _blocks(fit: StreakFit) -> Array:
    """Covariances (2, 2, 2, 2) of both ends with each other, row and col last, px^2."""
    return np.asarray(fit.covariance_px2).reshape(2, 2, 2, 2).transpose(0, 2, 1, 3)


def _evidence(trail: PlacedTrail, units: Array, plane: _Plane) -> tuple[Array, Array, Array]:
    """What a frame says of the line: terms (m, 3), values (m,) in arcsec and weights (m,): of its place, and tilt if fitted."""
    streak, blocks = trail.streak, _blocks(trail.streak.fit)
    at, values = plane.rows(plane.along(units), streak.t_tai_ns), plane.across(units)
    seen = trail.jacobian_arcsec[1].T @ _side(units[1], plane)
    place, tilt = blocks.sum(axis=(0, 1)) / 4.0, blocks[0, 0] + blocks[1, 1] - blocks[0, 1] - blocks[1, 0]
    along = np.array([streak.fit.row1 - streak.fit.row0, streak.fit.col1 - streak.fit.col0])
    side = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-6)
    place_arcsec2 = float(seen @ place @ seen) + trail.pointing_arcsec**2
    if float(side @ tilt @ side) <= LEAST_TILT * float(side @ place @ side):
        return at[1:2], values[1:2], 1.0 / np.array([place_arcsec2])
    least = LEAST_PX**2 * float(seen @ seen)
    variances = np.array([place_arcsec2 + least, float(seen @ tilt @ seen) + 2.0 * least])
    return np.array([at[1], at[2] - at[0]]), np.array([values[1], values[2] - values[0]]), 1.0 / variances


def _even(shares: dict[int, tuple[Array, Array, Array]], used: Sequence[int]) -> dict[int, tuple[Array, Array, Array]]:
    """The evidence with no frame's place better than the median of those used.

    An object is about as bright in all frames of a track. A frame states a smaller error where a star or noise has added light,
    just where its place is wrong.
    """
    most = float(np.median([shares[k][2][0] for k in used]))
    return {k: (rows, values, weights * min(1.0, most / weights[0])) for k, (rows, values, weights) in shares.items()}


def _off_line(evidence: tuple[Array, Array, Array], line: Array, covariance: Array, *, is_part: bool) -> float:
    """Distance of a frame's place from the line, in errors of this distance. is_part : whether the line is fitted to it."""
    row, value, weight = evidence[0][0], evidence[1][0], evidence[2][0]
    known = float(row @ covariance @ row)
    variance = max(1.0 / weight - known, LEAST_SHARE / weight) if is_part else 1.0 / weight + known
    return abs(float(value - row @ line)) / float(np.sqrt(variance))


def _moved(trail: PlacedTrail, units: Array, plane: _Plane, line: Array, covariance: Array) -> StreakMeasurement:
    """A member with its ends on the line."""
    streak, fit = trail.streak, trail.streak.fit
    ends = units[[0, 2]]
    rows = _ends_rows(trail, units, plane)
    shift = rows @ line - plane.across(ends)
    steps = np.array([_step_px(trail, units, plane, point) for point in (0, 2)])
    shared = rows @ covariance @ rows.T + trail.pointing_arcsec**2
    length = max(fit.length_px, 1e-6)
    along = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / length
    keep = np.kron(np.eye(2), np.outer(along, along))
    across = np.einsum("ij,ia,jb->iajb", shared, steps, steps).reshape(4, 4)
    middle = steps.mean(axis=0)
    (row0, col0), (row1, col1) = np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]]) + shift[:, None] * steps
    placed = replace(
        fit,
        row0=float(row0),
        col0=float(col0),
        row1=float(row1),
        col1=float(col1),
        covariance_px2=keep @ np.asarray(fit.covariance_px2) @ keep + across,
        sigma_cross_px=float(np.sqrt(shared.mean()) * np.linalg.norm(middle)),
        flags=fit.flags | StreakFlag.REFIT,
    )
    flux_e = fit.flux_e + _light_gained(trail, placed)
    # a flash that the light on the line does not hold was noise beside it
    placed = replace(placed, flux_e=flux_e, flash_e=fit.flash_e if fit.flash_e < flux_e else 0.0)
    row_mid, col_mid = middle_of(placed)
    return replace(streak, fit=placed, row_mid=row_mid, col_mid=col_mid, flags=streak.flags | StreakFlag.REFIT)


def _light_gained(trail: PlacedTrail, placed: StreakFit) -> float:
    """Electrons by which a trail is brighter on the line than at the place that its own frame chose.

    A frame of S/N S puts its trail where its noise adds most light. That makes its flux too large by 1 / (2 S) of its error on
    average, and as much again where it chooses the tilt, too. Where the frame knows its place better than the line does, its flux
    stays.
    """
    fit = trail.streak.fit
    if trail.pixels is None or placed.sigma_cross_px >= fit.sigma_cross_px:
        return 0.0
    pixels = AcrossPixels.of(placed, trail.pixels)
    if pixels is None:
        return 0.0
    back = np.array([[fit.row0 - placed.row0, fit.col0 - placed.col0], [fit.row1 - placed.row1, fit.col1 - placed.col1]])
    end0, end1 = (pixels.across_px(step) for step in back)
    on_line, own = np.zeros(2), np.array([0.5 * (end0 + end1), 0.5 * (end1 - end0)])
    pixels = pixels.without_intruders(on_line)
    return (pixels.density(on_line)[0] - pixels.density(own)[0]) * placed.length_px
