"""What `onboard.tracker = joint` gains through the whole chain: pairs of run directories of the same frames, without and with it.

    sboc compare sso_faint --seam onboard.tracker --use none --use joint --seeds 3 --out DIR
    python -m tests.benchmarks.track_gain DIR/runs

prints tracklets a day of objects below 3 cm, weighted as nature has them, with and without, their ratio with its interval
(objects are resampled), the same by class of size, false and impure tracklets, pulls of the faint members, their errors
across the motion over the joint bound of all frames of their tracklet, and pulls of the mean place and of the rate across of
faint tracklets, from `tdm_angles.ecsv` and its shared errors. `--joint` takes runs with the tracker alone and prints the pulls.
"""

import json
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.score.astrometry import sky_paths, streak_astrometry
from sboc_e2e.score.evaluation import Evaluation, evaluate
from sboc_e2e.score.figures import bootstrap_by_owner, proportion, pull_width, rate, rms
from sboc_e2e.score.linking import linking
from sboc_e2e.score.photometry import mean_magnitudes

LARGEST_M: Final = 0.03
CLASSES_M: Final = ((0.001, 0.003), (0.003, 0.01), (0.01, 0.03))
FAINT_SNR: Final = 7.0
DRAWS: Final = 4000
DAY_S: Final = 86_400.0
RUN: Final = 1_000_000
"""Numbers of tracklets of one run are below it."""

Owned = list[tuple[float, int]]
"""Values, each with the number of its tracklet."""


def tracker_of(run: Path) -> str:
    """Name of the class."""
    components = json.loads((run / "manifest.json").read_text())["components"]
    return str(components["onboard.tracker"]["class"]).rsplit(":", 1)[1]


def seed_of(run: Path) -> int:
    """Of the run."""
    return int(json.loads((run / "manifest.json").read_text())["seed"])


def linked_objects(e: Evaluation) -> tuple[set[int], dict[int, int]]:
    """Objects with a tracklet, and the object of each tracklet (-1: false)."""
    _, owner = linking(e.streaks, e.pairs, e.n_frames)
    return {o for o in owner.values() if o >= 0}, owner


def small_objects(e: Evaluation) -> dict[int, tuple[float, float]]:
    """Natural objects below LARGEST_M: how many of them each stands for, and its size (m)."""
    table = e.truth_tables["objects"]
    return {
        int(row["object_id"]): (float(row["weight"]), float(row["size_m"]))
        for row in table
        if str(row["kind"]) == "population" and float(row["size_m"]) < LARGEST_M
    }


def ratio_interval(weight: NDArray[np.float64], before: NDArray[np.bool_], after: NDArray[np.bool_]) -> dict[str, float]:
    """Weighted count with over that without, and its 90 % interval when objects are drawn again."""
    rng = np.random.default_rng(1)
    draws = rng.integers(0, len(weight), (DRAWS, len(weight)))
    below = (weight * before)[draws].sum(axis=1)
    above = (weight * after)[draws].sum(axis=1)
    low, high = np.quantile(above / np.maximum(below, 1e-12), (0.05, 0.95))
    value = float((weight * after).sum() / max(float((weight * before).sum()), 1e-12))
    return {"value": value, "low": float(low), "high": float(high), "n": len(weight)}


def joint_cross(
    x: NDArray[np.float64], cross_px: NDArray[np.float64], error_px: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Errors across the motion of members as published, and of the line through them, each over the joint bound; (n,) both.

    x : middles along the track, in trail lengths. cross_px : bounds of single frames. A trail of even light tells its line's
    place, 1 / cross_px^2, and its slope, a twelfth of that per length squared: the Fisher matrix of a line's two parameters,
    summed over frames, is the joint one.
    """
    weight = cross_px**-2.0
    rows = np.stack([np.ones_like(x), x], axis=1)
    places = np.einsum("k,ki,kj->ij", weight, rows, rows)
    both = places + np.diag([0.0, weight.sum() / 12.0])
    bound = np.sqrt(np.einsum("ki,ij,kj->k", rows, np.linalg.inv(both), rows))
    line = rows @ np.linalg.solve(places, rows.T @ (weight * error_px))
    return [error_px / bound, line / bound]


def joint_ratios(e: Evaluation, table: list[dict[str, float]]) -> dict[str, Owned]:
    """Errors across the motion of the members of tracklets whose frames all show less than FAINT_SNR, over bounds.

    Members of one tracklet share the line's two errors.
    """
    of: dict[int, list[dict[str, float]]] = {}
    for row in table:
        of.setdefault(int(e.streaks["tracklet_id"][int(row["row"])]), []).append(row)
    out: dict[str, Owned] = {f"faint_{name}_bound": [] for name in ("own_over_own", "own_over_joint", "line_over_joint")}
    for tracklet, rows in of.items():
        objects = {e.pairs[int(r["row"])].object_id for r in rows}
        if len(rows) < 2 or len(objects) > 1 or max(r["snr"] for r in rows) >= FAINT_SNR:
            continue
        s = e.streaks[[int(r["row"]) for r in rows]]
        epochs, length_ns = np.asarray(s["t_mid_tai_ns"], np.float64), np.asarray(s["t1_tai_ns"] - s["t0_tai_ns"], np.float64)
        exposure_ns = float(np.abs(np.median(length_ns)))
        error, ratio = (np.array([r[name] for r in rows]) for name in ("cross_px", "cross_ratio"))
        if exposure_ns > 0.0 and np.isfinite(ratio).all() and (ratio != 0.0).all():
            own, line = joint_cross((epochs - epochs.mean()) / exposure_ns, np.abs(error / ratio), error)
            for name, values in zip(out, (ratio, own, line), strict=True):
                out[name] += [(float(value), tracklet) for value in values]
    return out


def row_covariance(rows: Table) -> NDArray[np.float64]:
    """Covariance (m, m) across the motion of the directions of a tracklet, as its companion table states it."""
    shared = np.column_stack([rows[f"shared_cross_{k}_arcsec"] for k in (1, 2, 3)])
    frame = np.asarray(rows["frame"])
    pointing, turning = np.asarray(rows["pointing_arcsec"]), np.asarray(rows["turning_arcsec"])
    together = np.outer(pointing, pointing) + np.outer(turning, turning)
    common = shared @ shared.T + np.where(frame[:, None] == frame, together, 0.0)
    sigma2 = np.asarray(rows["sigma_cross_arcsec"]) ** 2
    return np.asarray(common + np.diag(np.maximum(sigma2 - np.diag(common), 1e-3 * sigma2)))


def tracklet_pulls(e: Evaluation, run: Path) -> dict[str, Owned]:
    """Mean place and rate across of tracklets whose frames all show less than FAINT_SNR, over their stated errors."""
    angles = Table.read(run / "products" / "tdm_angles.ecsv")
    row_of = {int(k): i for i, k in enumerate(e.streaks["streak_id"])}
    paths = sky_paths(e.truth_tables["streaks"], [t.index for t in e.pairs.values()])
    out: dict[str, Owned] = {"tracklet_place_cross": [], "tracklet_rate_cross": [], "tracklet_row_cross": []}
    for number in np.unique(angles["tracklet_id"]):
        rows = angles[angles["tracklet_id"] == number]
        at = [row_of[int(k)] for k in rows["streak_id"]]
        seen = [e.pairs.get(i) for i in at]
        truth = [t for t in seen if t is not None and t.index in paths]
        if len(rows) < 4 or len(truth) < len(rows) or len({t.object_id for t in truth}) > 1:
            continue
        if max(t.snr for t in truth) >= FAINT_SNR or not set(rows["end"]) <= {"end 0", "end 1"}:
            continue
        off = np.zeros(len(rows))
        for k, (i, t) in enumerate(zip(at, truth, strict=True)):
            end = str(rows["end"][k])[-1]
            ra, dec = float(e.streaks[f"ra{end}_deg"][i]), float(e.streaks[f"dec{end}_deg"][i])
            off[k] = paths[t.index].offset_arcsec(ra, dec, int(rows["epoch_tai_ns"][k]))[1]
        t_s = 1e-9 * (np.asarray(rows["epoch_tai_ns"]) - int(rows["epoch_tai_ns"][0]))
        design = np.stack([np.ones(len(rows)), t_s - t_s.mean()], axis=1)
        covariance = row_covariance(rows)
        weighted = np.linalg.solve(covariance, design)
        known = np.linalg.inv(design.T @ weighted)
        pulls = known @ (weighted.T @ off) / np.sqrt(np.diag(known))
        out["tracklet_place_cross"].append((float(pulls[0]), int(number)))
        out["tracklet_rate_cross"].append((float(pulls[1]), int(number)))
        out["tracklet_row_cross"] += [(float(pull), int(number)) for pull in off / np.sqrt(np.diag(covariance))]
    return out


def faint_pulls(e: Evaluation) -> dict[str, Owned]:
    """Residuals over errors of the members of tracklets below FAINT_SNR; across also over the frame's own bound."""
    linked = {i: t for i, t in e.pairs.items() if int(e.streaks["tracklet_id"][i]) >= 0 and t.snr >= 3.0}
    paths = sky_paths(e.truth_tables["streaks"], [t.index for t in linked.values()])
    _, whole = streak_astrometry(e.streaks, linked, e.bounds, paths)
    rows = {i: t for i, t in linked.items() if t.snr < FAINT_SNR}
    table = [r for r in whole if r["snr"] < FAINT_SNR]
    magnitudes = mean_magnitudes(e.truth_tables["streaks"], e.truth)
    mag = [
        ((float(e.streaks["mag"][i]) - magnitudes[t.index]) / float(e.streaks["mag_err"][i]), tracklet_of(e, i))
        for i, t in rows.items()
        if t.index in magnitudes and float(e.streaks["mag_err"][i]) > 0.0
    ]

    def column(name: str) -> Owned:
        return [(r[name], tracklet_of(e, int(r["row"]))) for r in table if name in r]

    return {
        **joint_ratios(e, whole),
        "cross": column("cross_pull"),
        "along": column("along_pull"),
        "cross_over_bound": column("cross_ratio"),
        "mag": [m for m in mag if np.isfinite(m[0])],
    }


def tracklet_of(e: Evaluation, row: int) -> int:
    """Number of the tracklet of a row of the streaks."""
    return int(e.streaks["tracklet_id"][row])


def add_run(pulls: dict[str, Owned], e: Evaluation, run: Path, number: int) -> None:
    """Add the pulls of a run; `number` tells its tracklets from those of other runs."""
    for name, values in (faint_pulls(e) | tracklet_pulls(e, run)).items():
        pulls.setdefault(name, []).extend((value, number * RUN + tracklet) for value, tracklet in values)


def gain(pairs: list[tuple[Path, Path]]) -> dict[str, Any]:
    """Figures of pairs of runs, without and with."""
    weight: list[float] = []
    size: list[float] = []
    before: list[bool] = []
    after: list[bool] = []
    pulls: dict[str, Owned] = {}
    false, n_tracklets, impure, span_s, n_frames = [0, 0], [0, 0], 0, 0.0, 0
    for number_of_pair, (without, with_tracker) in enumerate(pairs):
        runs = [evaluate(without), evaluate(with_tracker)]
        found = [linked_objects(e) for e in runs]
        for number, (_, owner) in enumerate(found):
            false[number] += sum(o < 0 for o in owner.values())
            n_tracklets[number] += len(owner)
        for o, (w, size_m) in small_objects(runs[1]).items():
            weight.append(w)
            size.append(size_m)
            before.append(o in found[0][0])
            after.append(o in found[1][0])
        add_run(pulls, runs[1], with_tracker, number_of_pair)
        for tracklet in found[1][1]:
            members = np.flatnonzero(np.asarray(runs[1].streaks["tracklet_id"]) == tracklet)
            owners = {runs[1].pairs[int(k)].object_id if int(k) in runs[1].pairs else -1 for k in members}
            impure += len(owners) > 1
        span_s += runs[0].n_frames / float(runs[0].manifest["frame_rate_hz"])
        n_frames += runs[0].n_frames
    w, b, a = np.asarray(weight, np.float64), np.asarray(before, np.bool_), np.asarray(after, np.bool_)
    of_class = {
        f"{1e3 * low:g} to {1e3 * high:g} mm": (np.asarray(size) >= low) & (np.asarray(size) < high) for low, high in CLASSES_M
    }
    return {
        "runs": len(pairs), "objects": len(w), "linked": [int(b.sum()), int(a.sum())],
        "a_day": [round(float((w * x).sum()) * DAY_S / span_s, 1) for x in (b, a)],
        "ratio_weighted": ratio_interval(w, b, a), "ratio_drawn": ratio_interval(np.ones(len(w)), b, a),
        "by_size": {
            name: {
                "objects": int(c.sum()), "linked": [int((b & c).sum()), int((a & c).sum())],
                "a_day": [round(float((w * x)[c].sum()) * DAY_S / span_s, 1) for x in (b, a)],
                "ratio_weighted": ratio_interval(w[c], b[c], a[c]),
            }
            for name, c in of_class.items() if c.any()
        },
        "false_tracklets_per_frame": [rate(k, float(n_frames), n_frames) for k in false],
        "impure": proportion(impure, n_tracklets[1]), "tracklets": n_tracklets,
        "pulls": widths(pulls),
    }  # fmt: skip


def widths(pulls: dict[str, Owned]) -> dict[str, Any]:
    """Rms of ratios to bounds, rms and widths of pulls, with their intervals when tracklets are drawn again."""
    out: dict[str, Any] = {}
    for name, owned in pulls.items():
        values, owners = [value for value, _ in owned], [owner for _, owner in owned]
        if not name.endswith("_bound"):
            out[name] = bootstrap_by_owner(values, owners, pull_width)
        out[name if name.endswith("_bound") else f"{name}_rms"] = bootstrap_by_owner(values, owners, rms)
    return out


def main() -> None:
    """Print the figures as JSON."""
    folders = [name for name in sys.argv[1:] if name != "--joint"]
    runs = [run for folder in folders for run in sorted(Path(folder).iterdir()) if (run / "products/streaks.ecsv").exists()]
    if "--joint" in sys.argv:
        pulls: dict[str, Owned] = {}
        for number, run in enumerate(runs):
            add_run(pulls, evaluate(run), run, number)
        sys.stdout.write(json.dumps(widths(pulls), indent=1) + "\n")
        return
    of: dict[int, dict[str, Path]] = {}
    for run in runs:
        of.setdefault(seed_of(run), {})[tracker_of(run)] = run
    pairs = [(each["NoTracker"], each["JointTracker"]) for each in of.values() if len(each) == 2]
    sys.stdout.write(json.dumps(gain(pairs), indent=1) + "\n")


if __name__ == "__main__":
    main()
