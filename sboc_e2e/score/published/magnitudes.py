"""Published magnitudes of tracklets against the true light of their trails."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.score.figures import Figure, bootstrap_by_owner, exact, pull_width, rms
from sboc_e2e.score.published.tdm_reader import TdmSegment
from sboc_e2e.score.published.true_motion import TrueMotion

Array = NDArray[np.float64]

PAIRED_S: Final = 0.02
"""A MAG line is the magnitude of a row of streaks.ecsv when their epochs differ by less."""


def magnitude_figures(
    segments: Sequence[TdmSegment],
    streaks: Table,
    tracklets: Table,
    owner: Mapping[int, int],
    motions: Mapping[int, TrueMotion],
    truth_mag: Mapping[int, float],
) -> dict[str, Any]:
    """Section `products.magnitudes`: single lines with the errors of streaks.ecsv, means with those of tracklets.ecsv.

    truth_mag : V of the mean light of each row of truth/streaks.ecsv. A tracklet's true magnitude is that of the mean light over
    the trails of its own lines.
    """
    line: dict[str, list[float]] = {"off": [], "pull": [], "owner": []}
    mean: dict[str, list[float]] = {"off": [], "pull": [], "owner": []}
    quoted = _quoted(tracklets)
    errors = _errors_of_lines(streaks)
    n_lines = 0
    for segment in segments:
        n_lines += len(segment.mag)
        number = segment.tracklet_id
        motion = motions.get(owner.get(number, -1))
        if motion is None or not len(segment.mag):
            continue
        nearest, reached = motion.streak_at(segment.mag_tai_ns)
        true = np.array([truth_mag.get(int(row), np.nan) for row in motion.rows[nearest]])
        true = np.where(reached, true, np.nan)
        known = np.isfinite(true)
        off = segment.mag[known] - true[known]
        sigma = _nearest(errors.get(number), segment.mag_tai_ns[known])
        line["off"] += off.tolist()
        line["pull"] += (off / sigma).tolist()
        line["owner"] += [owner[number]] * len(off)
        if known.any() and number in quoted:
            mag, mag_err = quoted[number]
            mean["off"].append(mag - _of_mean_light(true[known]))
            mean["pull"].append(mean["off"][-1] / mag_err if mag_err > 0.0 else np.nan)
            mean["owner"].append(owner[number])
    none = "no magnitude of a true object was published" if segments else "no tracklet was published"
    if not any(np.isfinite(v) for v in truth_mag.values()):
        none = "the truth gives no magnitudes (mag of truth/streaks.ecsv)"

    def over(rows: dict[str, list[float]], name: str, statistic: Any, reason: str = none) -> Figure:
        values, whose = np.array(rows[name], dtype=np.float64), np.array(rows["owner"], dtype=np.float64)
        known = np.isfinite(values)
        why = "too few to measure" if known.any() else reason
        return bootstrap_by_owner(values[known], whose[known], statistic, why)

    def median(v: Array) -> float:
        return float(np.median(v))

    no_lines = "no published line has an error in streaks.ecsv" if line["off"] else none
    no_means = "no tracklet has an error" if mean["off"] else none
    return {
        "n_lines": exact(n_lines, n_lines),
        "line_bias_mag": over(line, "off", median),
        "line_rms_mag": over(line, "off", rms),
        "line_pull_std": over(line, "pull", pull_width, no_lines),
        "tracklet_bias_mag": over(mean, "off", median),
        "tracklet_rms_mag": over(mean, "off", rms),
        "tracklet_pull_std": over(mean, "pull", pull_width, no_means),
    }


def _of_mean_light(mag: Array) -> float:
    """Magnitude of the mean of the light of magnitudes (n,)."""
    return float(-2.5 * np.log10(np.mean(10.0 ** (-0.4 * mag))))


def _quoted(tracklets: Table) -> dict[int, tuple[float, float]]:
    """Magnitude and error of each tracklet that has both."""
    if not all(name in tracklets.colnames for name in ("tracklet_id", "mag", "mag_err")):
        return {}
    rows = ((int(t["tracklet_id"]), float(t["mag"]), float(t["mag_err"])) for t in tracklets)
    return {number: (mag, error) for number, mag, error in rows if np.isfinite([mag, error]).all()}


def _errors_of_lines(streaks: Table) -> dict[int, tuple[NDArray[np.int64], Array]]:
    """By tracklet: epochs of the middles of its rows and their errors."""
    if not len(streaks) or not all(n in streaks.colnames for n in ("tracklet_id", "t_mid_tai_ns", "mag_err")):
        return {}
    tracklet, t_ns = np.asarray(streaks["tracklet_id"], int), np.asarray(streaks["t_mid_tai_ns"], np.int64)
    error = np.asarray(streaks["mag_err"], float)
    order = np.argsort(tracklet, kind="stable")
    names, first = np.unique(tracklet[order], return_index=True)
    return {int(name): (t_ns[rows], error[rows]) for name, rows in zip(names, np.split(order, first[1:]), strict=True)}


def _nearest(errors: tuple[NDArray[np.int64], Array] | None, t_ns: NDArray[np.int64]) -> Array:
    """Error of the row nearest in time (n,), NaN where none is near or its error is not positive."""
    if errors is None or not len(t_ns):
        return np.full(len(t_ns), np.nan)
    late = np.abs(t_ns[:, None] - errors[0])
    which = np.argmin(late, axis=1)
    found = np.where(late[np.arange(len(which)), which] <= PAIRED_S * 1e9, errors[1][which], np.nan)
    return np.where(found > 0.0, found, np.nan)
