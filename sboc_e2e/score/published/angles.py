"""Angles of the tracking data message against the true directions at their stated epochs, and against the table of streaks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.score.figures import Figure, absent, bootstrap_by_owner, exact, pull_width, rms
from sboc_e2e.score.published.axes import unit_vectors
from sboc_e2e.score.published.tdm_reader import TdmSegment
from sboc_e2e.score.published.true_motion import ARCSEC_PER_RAD, TrueMotion

Array = NDArray[np.float64]

SAME_ARCSEC: Final = 1e-3  # Chosen: 2,500 times what messages round to.
SAME_NS: Final = 1_000
"""Directions and epochs that differ by no more are the same measurement: messages round to 0.4 uas and 0.5 us."""

GROSS_ARCSEC: Final = 3600.0
"""Ends of faint long trails err by minutes of arc, not by a degree: swapped angles, wrong axes, foreign epochs do."""

PAIRED_S: Final = 0.02
"""An angle is a point of a row of the table when their epochs differ by less: ends are an exposure apart."""

_POINTS: Final = (
    ("t0_tai_ns", "ra0_deg", "dec0_deg"),
    ("t_mid_tai_ns", "ra_mid_deg", "dec_mid_deg"),
    ("t1_tai_ns", "ra1_deg", "dec1_deg"),
)


@dataclass(kw_only=True)
class _Rows:
    """Measured values, one for each angle, with the object of each (`owner`)."""

    owner: list[NDArray[np.int64]] = field(default_factory=list)
    columns: dict[str, list[Array]] = field(default_factory=dict)

    def add(self, owner: int, **columns: Array) -> None:
        self.owner.append(np.full(len(next(iter(columns.values()))), owner, np.int64))
        for name, values in columns.items():
            self.columns.setdefault(name, []).append(values)

    def column(self, name: str) -> tuple[Array, NDArray[np.int64]]:
        """Finite values and whose they are."""
        if name not in self.columns:
            return np.zeros(0), np.zeros(0, np.int64)
        values, owner = np.concatenate(self.columns[name]), np.concatenate(self.owner)
        known = np.isfinite(values)
        return values[known], owner[known]


def angle_figures(
    segments: Sequence[TdmSegment],
    streaks: Table,
    sigmas: Mapping[int, "StatedSigmas"],
    owner: Mapping[int, int],
    motions: Mapping[int, TrueMotion],
) -> dict[str, Any]:
    """Section `products.angles`.

    streaks : products/streaks.ecsv. sigmas : by tracklet, of a companion. owner : tracklet -> object, -1 for none.
    """
    rows = _Rows()
    n_angles, n_segments, n_objectless, n_outside = 0, 0, 0, 0
    points = _points_of(streaks)
    for segment in segments:
        n_segments += 1
        n_angles += len(segment.angle_tai_ns)
        motion = motions.get(owner.get(segment.tracklet_id, -1))
        if motion is None:
            n_objectless += len(segment.angle_tai_ns)
            continue
        nearest, reached = motion.streak_at(segment.angle_tai_ns)
        n_outside += int(np.count_nonzero(~reached))
        t_ns, direction, nearest = segment.angle_tai_ns[reached], segment.direction[reached], nearest[reached]
        if not len(t_ns):
            continue
        off = motion.offset_arcsec(direction, t_ns)
        stated = sigmas[segment.tracklet_id].at(t_ns) if segment.tracklet_id in sigmas else np.full((len(t_ns), 3), np.nan)
        row = {
            "along": off[:, 0],
            "cross": off[:, 1],
            "gross": (off[:, 2] > GROSS_ARCSEC).astype(np.float64),
            "along_pull": off[:, 0] / stated[:, 0],
            "cross_pull": off[:, 1] / stated[:, 1],
            "nees": _nees(off, stated),
            "epoch_ms": motion.epoch_error_ns(t_ns, nearest) * 1e-6,
        }
        rows.add(owner[segment.tracklet_id], **row, **_against_table(t_ns, direction, points.get(segment.tracklet_id), motion))
    none = "no angle of a true object was published" if n_segments else "no tracklet was published"
    if not motions:
        none = "the truth gives no directions (path_ra_deg and path_dec_deg of truth/streaks.ecsv, or ra0_deg to dec1_deg)"
    n = n_angles - n_objectless - n_outside

    def over(name: str, statistic: Any, reason: str = none) -> Figure:
        values, whose = rows.column(name)
        return bootstrap_by_owner(values, whose, statistic, "too few to measure" if len(values) else reason)

    def median(v: Array) -> float:
        return float(np.median(v))

    def middle(v: Array) -> float:
        return float(np.median(np.abs(v)))

    def mean(v: Array) -> float:
        return float(v.mean())

    out: dict[str, Any] = {
        "n_segments": exact(n_segments, n_segments),
        "n_angles": exact(n_angles, n_angles),
        "n_without_object": exact(n_objectless, n_angles),
        "n_outside_truth": exact(n_outside, n_angles) if motions else absent(none),
    }
    no_errors = "no errors are published for each angle" if n else none
    for name in ("along", "cross"):
        out[f"{name}_rms_arcsec"] = over(name, rms)
        out[f"{name}_median_arcsec"] = over(name, middle)
        out[f"{name}_bias_arcsec"] = over(name, median)
        out[f"{name}_pull_std"] = over(f"{name}_pull", pull_width, no_errors)
    out["nees"] = over("nees", mean, no_errors)
    out["gross_share"] = over("gross", mean)
    cut = "every published angle lies on the frame's edge" if n else none
    out["epoch_bias_ms"] = over("epoch_ms", median, cut)
    out["epoch_rms_ms"] = over("epoch_ms", rms, cut)
    out["differs_from_streaks"] = over("differs", mean)
    out["epoch_differs_from_streaks"] = over("epoch_differs", mean)
    for name in ("along", "cross"):
        out[f"streaks_{name}_rms_arcsec"] = over(f"table_{name}", rms, "no angle has a row in streaks.ecsv" if n else none)
        out[f"streaks_{name}_median_arcsec"] = over(f"table_{name}", middle, "no angle has a row in streaks.ecsv" if n else none)
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class StatedSigmas:
    """Errors that a companion table states for the angles of one tracklet.

    t_tai_ns : (n,) epochs. stated : (n, 3) sigma along, sigma across (arcsec), their correlation.
    """

    t_tai_ns: NDArray[np.int64]
    stated: Array

    def at(self, t_tai_ns: NDArray[np.int64]) -> Array:
        """Stated errors (m, 3) of the rows with the same epochs, NaN without such a row."""
        late = np.abs(np.asarray(t_tai_ns, np.int64)[:, None] - self.t_tai_ns)
        which = np.argmin(late, axis=1)
        same = late[np.arange(len(which)), which] <= SAME_NS
        return np.where(same[:, None], self.stated[which], np.nan)


def _nees(off: Array, stated: Array) -> Array:
    """e' C^-1 e / 2 (n,) of errors along and across; 1 in the mean where what is stated is right."""
    along, cross, correlation = off[:, 0] / stated[:, 0], off[:, 1] / stated[:, 1], np.clip(stated[:, 2], -0.999999, 0.999999)
    chi2 = (along**2 - 2.0 * correlation * along * cross + cross**2) / (1.0 - correlation**2)
    return np.asarray(0.5 * chi2)


_Points = tuple[NDArray[np.int64], Array]


def _points_of(streaks: Table) -> dict[int, _Points]:
    """Epochs (3 k,) and directions (3 k, 3) of both ends and the middle of the k rows of each tracklet."""
    if not len(streaks) or not all(name in streaks.colnames for names in _POINTS for name in names):
        return {}
    tracklet = np.asarray(streaks["tracklet_id"], int)
    t = np.stack([np.asarray(streaks[names[0]], np.int64) for names in _POINTS])
    unit = np.stack([unit_vectors(np.asarray(streaks[ra], float), np.asarray(streaks[dec], float)) for _, ra, dec in _POINTS])
    order = np.argsort(tracklet, kind="stable")
    order = order[tracklet[order] >= 0]
    if not len(order):
        return {}
    names, first = np.unique(tracklet[order], return_index=True)
    return {
        int(name): (t[:, rows].ravel(), unit[:, rows].reshape(-1, 3))
        for name, rows in zip(names, np.split(order, first[1:]), strict=True)
    }


def _against_table(t_ns: NDArray[np.int64], direction: Array, points: _Points | None, motion: TrueMotion) -> dict[str, Array]:
    """Whether angles differ from the table's points nearest in time, and the errors of those points; NaN without such a point.

    An angle that no row of the table has is a difference.
    """
    n = len(t_ns)
    if points is None:
        unknown = np.full(n, np.nan)
        return {"differs": np.ones(n), "epoch_differs": np.ones(n), "table_along": unknown, "table_cross": unknown}
    late = np.abs(t_ns[:, None] - points[0])
    which = np.argmin(late, axis=1)
    paired = late[np.arange(n), which] <= PAIRED_S * 1e9
    apart = np.linalg.norm(direction - points[1][which], axis=1) * ARCSEC_PER_RAD
    off = np.where(paired[:, None], motion.offset_arcsec(points[1][which], points[0][which]), np.nan)
    return {
        "differs": (~(apart <= SAME_ARCSEC) | ~paired).astype(np.float64),
        "epoch_differs": (late[np.arange(n), which] > SAME_NS).astype(np.float64),
        "table_along": off[:, 0],
        "table_cross": off[:, 1],
    }
