"""Where the truth has objects and the camera at any instant between its samples."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from sboc_e2e.score.published.axes import unit_vectors

Array = NDArray[np.float64]

ARCSEC_PER_RAD: Final = 648_000.0 / np.pi
LEAST_REACH_S: Final = 0.05
"""The motion of a trail is used this long before its first and after its last node, or as long as the trail lasted if longer."""

ALONE_REACH_S: Final = 1.0
"""How far in time a single state of the camera is carried on; a run of one frame has no other."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueMotion:
    """Published direction of one object over a run.

    rows : (k,) its rows in truth/streaks.ecsv by time. open_ns, middle_ns, close_ns : (k,) true epochs of their nodes first,
    middle and last. cut : (k, 3) whether the frame's edge, not the shutter, made the place (both ends for the middle).
    """

    rows: NDArray[np.intp]
    open_ns: NDArray[np.int64]
    middle_ns: NDArray[np.int64]
    close_ns: NDArray[np.int64]
    cut: NDArray[np.bool_]
    origin_ns: int
    spline: CubicSpline

    def streak_at(self, t_tai_ns: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Index into `rows` of the trail nearest in time (n,), and whether it reaches so far."""
        t = np.asarray(t_tai_ns, np.int64)[:, None]
        away_s = np.maximum(np.maximum(self.open_ns - t, t - self.close_ns), 0) * 1e-9
        nearest = np.argmin(away_s, axis=1)
        reach_s = np.maximum((self.close_ns - self.open_ns)[nearest] * 1e-9, LEAST_REACH_S)
        return nearest, away_s[np.arange(len(nearest)), nearest] <= reach_s

    def offset_arcsec(self, direction: Array, t_tai_ns: NDArray[np.int64]) -> Array:
        """Of a direction (n, 3) minus the true one at its epoch: along the motion, across it (at a position
        angle larger by 90 degrees), and the whole chord (n, 3)."""
        t_s = (np.asarray(t_tai_ns, np.int64) - self.origin_ns) * 1e-9
        true = self.spline(t_s)
        depth = np.linalg.norm(true, axis=1, keepdims=True)
        true = true / depth
        motion = self.spline(t_s, 1)
        motion -= np.sum(motion * true, axis=1, keepdims=True) * true
        speed = np.linalg.norm(motion, axis=1, keepdims=True)
        east = np.stack([-true[:, 1], true[:, 0], np.zeros(len(true))], axis=1)
        along = np.where(speed > 1e-12, motion / np.maximum(speed, 1e-12), east)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        off = direction - true
        across = np.sum(off * np.cross(along, true), axis=1)
        return np.stack([np.sum(off * along, axis=1), across, np.linalg.norm(off, axis=1)], axis=1) * ARCSEC_PER_RAD

    def epoch_error_ns(self, t_tai_ns: NDArray[np.int64], nearest: NDArray[np.intp]) -> Array:
        """Epochs (n,) minus the true one of the place of their trail nearest in time; NaN where the edge made that place."""
        places = np.stack([self.open_ns[nearest], self.middle_ns[nearest], self.close_ns[nearest]], axis=1)
        late = np.asarray(t_tai_ns, np.int64)[:, None] - places
        which = np.argmin(np.abs(late), axis=1)
        rows = np.arange(len(which))
        return np.where(self.cut[nearest, which], np.nan, late[rows, which].astype(np.float64))


def true_motions(streaks: Table) -> dict[int, TrueMotion]:
    """By object, for those whose directions the truth gives. streaks : truth/streaks.ecsv."""
    if not len(streaks):
        return {}
    ra, dec = np.asarray(streaks["path_ra_deg"], float), np.asarray(streaks["path_dec_deg"], float)
    known = np.isfinite(ra).all(axis=1) & np.isfinite(dec).all(axis=1)
    t_ns, owner = np.asarray(streaks["path_t_tai_ns"], np.int64), np.asarray(streaks["object_id"], int)
    edge0, edge1 = np.asarray(streaks["edge0"], bool), np.asarray(streaks["edge1"], bool)
    out = {}
    for number in np.unique(owner[known]):
        rows = np.flatnonzero(known & (owner == number))
        rows = rows[np.argsort(t_ns[rows, 0], kind="stable")]
        nodes, first = np.unique(t_ns[rows], return_index=True)
        if len(nodes) < 4:
            continue  # an exposure of a few nanoseconds shows no motion
        unit = unit_vectors(ra[rows].ravel()[first], dec[rows].ravel()[first])
        origin = int(nodes[0])
        out[int(number)] = TrueMotion(
            rows=rows,
            open_ns=t_ns[rows, 0],
            middle_ns=t_ns[rows, t_ns.shape[1] // 2],
            close_ns=t_ns[rows, -1],
            cut=np.stack([edge0[rows], edge0[rows] | edge1[rows], edge1[rows]], axis=1),
            origin_ns=origin,
            spline=CubicSpline((nodes - origin) * 1e-9, unit),
        )
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueObserver:
    """States of the camera by true time: t_tai_ns (n,), state (n, 6) m and m/s, GCRS."""

    t_tai_ns: NDArray[np.int64]
    state: Array

    def at(self, t_tai_ns: NDArray[np.int64]) -> Array:
        """States (m, 6), NaN further than one step outside the truth: cubic in between, of constant acceleration beyond."""
        t = np.asarray(t_tai_ns, np.int64)
        origin = int(self.t_tai_ns[0])
        nodes_s, t_s = (self.t_tai_ns - origin) * 1e-9, (t - origin) * 1e-9
        position, velocity = self.state[:, :3], self.state[:, 3:]
        if len(nodes_s) == 1:
            out = np.concatenate([position + t_s[:, None] * velocity, np.repeat(velocity, len(t), axis=0)], axis=1)
            out[np.abs(t_s) > ALONE_REACH_S] = np.nan
            return out
        motion = CubicHermiteSpline(nodes_s, position, velocity)
        out = np.concatenate([motion(t_s), motion(t_s, 1)], axis=1)
        for end, step in ((0, nodes_s[1] - nodes_s[0]), (-1, nodes_s[-1] - nodes_s[-2])):
            past_s = t_s - nodes_s[end]
            beyond = past_s < 0.0 if end == 0 else past_s > 0.0
            other = 1 if end == 0 else -2
            pull = (velocity[other] - velocity[end]) / (nodes_s[other] - nodes_s[end])
            ahead = past_s[beyond, None]
            out[beyond, :3] = position[end] + ahead * velocity[end] + 0.5 * ahead**2 * pull
            out[beyond, 3:] = velocity[end] + ahead * pull
            out[beyond & (np.abs(past_s) > step)] = np.nan
        return out


def true_observer(frames: Table) -> TrueObserver | None:
    """The camera's motion from truth/frames.ecsv, whose states are of mid-exposure of the middle row; None if it gives none."""
    if not len(frames):
        return None
    state = np.concatenate([np.asarray(frames["position_m"], float), np.asarray(frames["velocity_m_s"], float)], axis=1)
    # truth from elsewhere knows neither rows nor states
    known = np.isfinite(state).all(axis=1) & np.isfinite(np.asarray(frames["grid_row"], float)).all(axis=1)
    known &= np.any(state != 0.0, axis=1)  # nothing looks at the sky from the middle of the Earth
    if not known.any():
        return None
    middle_row = np.asarray(frames["grid_row"], float)[known].max(axis=1) / 2.0
    start = np.asarray(frames["t_start_true_tai_ns"], np.int64)[known] + np.asarray(frames["exposure_ns"], np.int64)[known] // 2
    delay = np.rint(np.asarray(frames["line_time_ns"], np.int64)[known] * middle_row).astype(np.int64)
    t, first = np.unique(start + delay, return_index=True)
    return TrueObserver(t_tai_ns=t, state=state[known][first])
