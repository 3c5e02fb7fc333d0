"""Time bias, pointing and noise of a sensor from what it saw of objects whose orbits are known to metres."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from ground.orbit.reference import PreciseOrbit, seen_from
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]
Place = Callable[[NDArray[np.int64]], Array]
"""Where the sensor was, (n, 3) km, GCRS axes, at TAI epochs (n,) ns."""

_HALF_STEP_S: Final = 0.5  # half the step of the central difference for the rate; at 0.1 deg/s it errs by 1e-7 of the rate
_CLIP_SIGMA: Final = 4.5  # a right direction in 150,000 is beyond it on each axis
_ROUNDS: Final = 8  # rounds of weights and clipping, after which they have settled; chosen, not measured
_SAME_ARCSEC: Final = 5.0
"""Orbits that are nearer to each other, as an angle at the sensor, are of one object: files name it differently. Chosen."""
_FEWEST_TRACKS: Final = 3  # one track gives three numbers to three unknowns; three show the scatter between tracks


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Directions (n, 3), unit vectors, GCRS axes, at tagged epochs (n,) TAI ns, of one object on one pass."""

    t_tai_ns: NDArray[np.int64]
    direction: Array

    def __post_init__(self) -> None:
        validate.finite_array("track.direction", self.direction, (len(self.t_tai_ns), 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorBias:
    """What a session's observations say of the sensor.

    time_s : tags later than the truth, positive. east_arcsec, north_arcsec : pointing, observed minus true. covariance : (3, 3)
    of these. noise_along, noise_cross : one sigma of a direction along and across the motion; common_along, common_cross : of
    what the directions of a track share, arcsec. along, cross : mean residuals before any correction.
    degrees : (3,) of freedom of the variances of (time_s, east, north), for intervals. first_tai_ns, last_tai_ns : the session.
    """

    first_tai_ns: int
    last_tai_ns: int
    time_s: float
    east_arcsec: float
    north_arcsec: float
    covariance: Array
    noise_along_arcsec: float
    noise_cross_arcsec: float
    common_along_arcsec: float
    common_cross_arcsec: float
    along_arcsec: float
    cross_arcsec: float
    n_tracks: int
    n_used: int
    n_clipped: int
    objects: tuple[str, ...]
    degrees: Array

    def half_widths(self, share: float) -> Array:
        """Half widths (3,) of intervals of (time_s, east, north) that hold the truth in a share of sessions."""
        return np.asarray(np.sqrt(np.diag(self.covariance)) * student.ppf(0.5 + 0.5 * share, self.degrees))


@dataclass(frozen=True, eq=False)
class _Part:
    """Residuals (m, 2) along and across, rates and axes of one track's directions, arcsec; design (m, 2, 3)."""

    residual: Array
    design: Array


def sessions_of(tracks: Sequence[Track], gap_s: float) -> list[list[Track]]:
    """Tracks in order of time, cut where nothing was seen for longer than a gap: nights, or visits of an orbit."""
    ordered = sorted(tracks, key=lambda track: int(track.t_tai_ns[0]))
    out: list[list[Track]] = []
    last = 0
    for track in ordered:
        if not out or int(track.t_tai_ns[0]) - last > gap_s * 1e9:
            out.append([])
        out[-1].append(track)
        last = max(last, int(track.t_tai_ns[-1]))
    return out


def identified(track: Track, here: Array, orbits: Sequence[PreciseOrbit], within_arcsec: float) -> PreciseOrbit | None:
    """The orbit of the only object near a track, seen from places (n, 3), all along; None near none or several.

    Orbits of one name, and those that agree, are of one object. Of these the one whose table begins last is taken: of predictions
    the newest, of ultra-rapid orbits the half that was observed; of tables that begin together the shortest.
    """
    near: list[tuple[PreciseOrbit, Array]] = []
    for orbit in orbits:
        computed, rho = seen_from(orbit.states, track.t_tai_ns, here)
        away = np.linalg.norm(track.direction - computed, axis=1).max() / ARCSEC_RAD
        if np.isfinite(away) and away < within_arcsec:
            near.append((orbit, computed * rho[:, None]))
    if not near:
        return None
    best, line = max(near, key=lambda found: (int(found[0].t_tai_ns[0]), -int(found[0].t_tai_ns[-1])))
    same = _SAME_ARCSEC * ARCSEC_RAD * np.linalg.norm(line, axis=1)
    names = {orbit.name for orbit, other in near if (np.linalg.norm(other - line, axis=1) < same).all()}
    return best if names.issuperset(orbit.name for orbit, _ in near) else None


def estimate(
    tracks: Sequence[Track],
    place: Place,
    orbits: Sequence[PreciseOrbit],
    *,
    shares_clock: bool,
    within_arcsec: float = 600.0,
) -> SensorBias:
    """Weighted least squares of observed minus computed; noise and what a track has in common are estimated beside.

    shares_clock : whether the sensor's own states carry the tags' clock (a space telescope): its place is then right for the
    tags, and the object's motion alone counts; at a site whose place follows from the tags, the whole apparent motion does.
    UserError without three tracks of known objects.
    """
    found = [(track, identified(track, place(track.t_tai_ns), orbits, within_arcsec)) for track in tracks]
    pairs = [(track, orbit) for track, orbit in found if orbit is not None and len(track.t_tai_ns) > 1]
    if len(pairs) < _FEWEST_TRACKS:
        raise UserError(
            f"calibration: {len(pairs)} of {len(tracks)} tracks belong to one precise orbit each; {_FEWEST_TRACKS} are needed"
        )
    parts = [_part(track, orbit, place, shares_clock) for track, orbit in pairs]
    use: list[NDArray[np.bool_]] = [np.asarray(np.isfinite(p.residual).all(axis=1)) for p in parts]
    own, common, freedom = np.ones(2), np.zeros(2), np.ones(2)
    solution: Array = np.zeros(3)
    covariance: Array = np.eye(3)
    for _ in range(_ROUNDS):
        information, right = np.zeros((2, 3, 3)), np.zeros(3)
        for part, chosen in zip(parts, use, strict=True):
            for axis in range(2):
                design, value = part.design[chosen, axis], part.residual[chosen, axis]
                # (s2 + c2 11')^-1 = (1 - c2 11'/(s2 + m c2)) / s2
                shrink = common[axis] / (own[axis] + len(value) * common[axis])
                weighted = (design - shrink * design.sum(axis=0)) / own[axis]
                information[axis] += weighted.T @ design
                right += weighted.T @ value
        together = information.sum(axis=0)
        if np.linalg.cond(together) > 1e14:
            raise UserError("calibration: all objects move alike: time and pointing cannot be told apart")
        covariance = np.asarray(np.linalg.inv(together), dtype=np.float64)
        solution = covariance @ right
        left = [part.residual - part.design @ solution for part in parts]
        own, common, freedom = _variances(left, use)
        sigma = np.sqrt(own + common)
        use = [np.asarray((np.abs(r) < _CLIP_SIGMA * sigma).all(axis=1)) for r in left]
    all_residuals = np.vstack([part.residual[chosen] for part, chosen in zip(parts, use, strict=True)])
    epochs = np.concatenate([track.t_tai_ns for track, _ in pairs])
    n_used = int(sum(chosen.sum() for chosen in use))
    # The share of each variance that the noise along and that across have (Satterthwaite 1946, Biometrics 2, 110).
    weight = np.einsum("ij,ajk,ki->ai", covariance, information, covariance) / np.diag(covariance)
    # The weights come from the same few tracks (Kenward & Roger 1997, Biometrics 53, 983, for one variance an axis).
    lost = sum((own_part - own_part @ covariance @ own_part) / nu for own_part, nu in zip(information, freedom, strict=True))
    covariance = covariance + 4.0 * covariance @ np.asarray(lost) @ covariance
    return SensorBias(
        first_tai_ns=int(epochs.min()),
        last_tai_ns=int(epochs.max()),
        time_s=float(solution[0]),
        east_arcsec=float(solution[1]),
        north_arcsec=float(solution[2]),
        covariance=covariance,
        noise_along_arcsec=float(np.sqrt(own[0])),
        noise_cross_arcsec=float(np.sqrt(own[1])),
        common_along_arcsec=float(np.sqrt(common[0])),
        common_cross_arcsec=float(np.sqrt(common[1])),
        along_arcsec=float(all_residuals[:, 0].mean()),
        cross_arcsec=float(all_residuals[:, 1].mean()),
        n_tracks=len(pairs),
        n_used=n_used,
        n_clipped=int(sum((~chosen).sum() for chosen in use)),
        objects=tuple(sorted({orbit.name for _, orbit in pairs})),
        degrees=1.0 / (weight**2 / freedom[:, None]).sum(axis=0),
    )


def _part(track: Track, orbit: PreciseOrbit, place: Place, shares_clock: bool) -> _Part:
    t, half_ns = track.t_tai_ns, round(_HALF_STEP_S * 1e9)
    here = place(t)
    before, after = (
        seen_from(orbit.states, t + shift, here if shares_clock else place(t + shift))[0] for shift in (-half_ns, half_ns)
    )
    computed, _ = seen_from(orbit.states, t, here)
    rate = (after - before) / (2.0 * _HALF_STEP_S) / ARCSEC_RAD
    speed = np.linalg.norm(rate, axis=1, keepdims=True)
    heading = rate / np.maximum(speed, 1e-12)
    east = np.cross([0.0, 0.0, 1.0], computed)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(computed, east)
    axes = np.stack([heading, np.cross(computed, heading)], axis=1)
    offset = (track.direction - computed) / ARCSEC_RAD
    residual = np.einsum("mij,mj->mi", axes, offset)
    design = np.stack([-np.einsum("mij,mj->mi", axes, rate), *(np.einsum("mij,mj->mi", axes, v) for v in (east, north))], axis=2)
    return _Part(residual, design)


def _variances(left: Sequence[Array], use: Sequence[NDArray[np.bool_]]) -> tuple[Array, Array, Array]:
    """Variance within tracks, of the common error of each track, and degrees of freedom of a track's mean, (2,) along and across.

    Analysis of variance. Where tracks share an error, their means are the independent data; elsewhere the directions are.
    """
    groups = [r[chosen] for r, chosen in zip(left, use, strict=True) if chosen.sum() > 1]
    inside = sum(((g - g.mean(axis=0)) ** 2).sum(axis=0) for g in groups)
    own = np.asarray(inside) / max(sum(len(g) - 1 for g in groups), 1)
    own = np.maximum(own, 1e-6)
    means = np.array([g.mean(axis=0) for g in groups])
    size = np.array([len(g) for g in groups])
    # three numbers were fitted to two coordinates of all tracks
    fitted = 1.5
    tracks = max(len(groups) - fitted, 0.5)
    noise = own * (1.0 / size).mean()
    between = np.maximum((means**2).sum(axis=0) / tracks - noise, 0.0)
    return own, between, np.where(between > noise, tracks, size.sum() - fitted)
