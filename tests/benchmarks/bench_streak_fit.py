"""Streak fits against the Cramér-Rao bound: cross-track, ends, flux, pulls, coverage, joint refits, cost.

Trails come from tests/streaks/trail_rendering.py (brute-force integration, numerical Fisher matrix), not from the fitter's
model. Ratios are sqrt(mean((residual / bound)^2)) with 90 % bootstrap intervals; pulls sqrt(median(z^2) / 0.4549).
``ends_attainable`` refers to max(CRLB, 4.39 L / S^2); ``ends_best_equivariant`` to the larger of the CRLB and the rms of
Pitman's estimator with everything else known, which no fit can beat: between the two laws it lies above both.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.streaks import TrackletFrame, TrailedPsfFitter, refit_tracklet
from ground.streaks.fit_record import reversed_ends
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from tests.streaks.trail_rendering import (
    Exposure,
    Trail,
    attainable_px,
    best_equivariant_end_px,
    expose,
    residuals,
    trail_at,
)

LENGTHS_PX = (10.0, 20.0, 50.0, 100.0, 300.0, 1000.0)
SNRS = (7.0, 8.0, 10.0, 15.0, 25.0, 50.0, 100.0)
MEDIAN_Z2 = 0.4549


def figure(values: NDArray[np.float64], statistic: Callable[[NDArray[np.float64]], float], seed: int = 1) -> dict[str, Any]:
    """Value, n and 90 % bootstrap interval of a statistic of (n,) or (n, k) values, rows drawn together."""
    n = len(values)
    if n < 5:
        return {"value": None, "n": n, "low": None, "high": None, "reason": "fewer than five cases"}
    rng = np.random.default_rng(seed)
    draws = np.array([statistic(values[rng.integers(0, n, n)]) for _ in range(200)])
    low, high = np.quantile(draws, (0.05, 0.95))
    return {"value": float(statistic(values)), "n": n, "low": float(low), "high": float(high)}


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def pull(z: NDArray[np.float64]) -> float:
    """Robust width of pulls: 1 for a normal."""
    return float(np.sqrt(np.median(np.square(z)) / MEDIAN_Z2))


def measure(exposure: Exposure, fit: StreakFit, bounds: dict[str, float]) -> dict[str, float]:
    """Residuals of one fit over their bounds and over their quoted errors."""
    trail = exposure.trail
    cos, sin = trail.axes
    if (fit.row1 - fit.row0) * sin + (fit.col1 - fit.col0) * cos < 0.0:
        fit = reversed_ends(fit)
    end0, end1, across = residuals(trail, fit.row0, fit.col0, fit.row1, fit.col1)
    # the middle of a curved trail lies its height above the chord
    across += fit.sagitta_px
    along = np.array([sin, cos])
    sigma0 = math.sqrt(along @ fit.covariance_px2[:2, :2] @ along)
    sigma1 = math.sqrt(along @ fit.covariance_px2[2:, 2:] @ along)
    interval = fit.end_interval_px
    attainable = max(bounds["end_px"], attainable_px(trail.length_px, exposure.snr))
    return {
        "cross": across / bounds["cross_px"],
        "cross_z": across / fit.sigma_cross_px,
        "end0": end0 / attainable,
        "end1": end1 / attainable,
        "end0_best": end0 / bounds["best_end_px"],
        "end1_best": end1 / bounds["best_end_px"],
        "end0_crlb": end0 / bounds["end_px"],
        "end1_crlb": end1 / bounds["end_px"],
        "end0_z": end0 / sigma0,
        "end1_z": end1 / sigma1,
        # the interval is positive outwards: end 0 lies outwards of the truth when its residual is negative
        "covered0": float(interval[0, 0] <= end0 <= interval[0, 1]),
        "covered1": float(interval[1, 0] <= -end1 <= interval[1, 1]),
        "flux": (fit.flux_e - trail.flux_e) / bounds["flux_e"],
        "flux_relative": fit.flux_e / trail.flux_e - 1.0,
        "flux_z": (fit.flux_e - trail.flux_e) / fit.flux_err_e,
        "gaussian": float(StreakFlag.ENDS_NOT_GAUSSIAN not in fit.flags),
        "chi2_nu": fit.chi2_nu,
    }


def run_cell(length_px: float, snr: float, n: int, seed: int) -> dict[str, NDArray[np.float64]]:
    """Measurements of n trails of one length and S/N: columns of `measure`, CPU ms, and the share of failed fits."""
    rng = np.random.default_rng([seed, int(length_px), int(10 * snr)])
    fitter = TrailedPsfFitter()
    rows, cost, failed = [], [], 0
    bounds: dict[str, float] = {}
    for i in range(n):
        exposure = expose(rng, trail_at(rng, length_px), snr)
        # a bound depends on the sub-pixel phase of short trails only
        if not bounds or (length_px <= 20.0 and i % 4 == 0):
            best = bounds.get("best_end_px") or best_equivariant_end_px(exposure.trail, rng, draws=600)
            bounds = exposure.bounds() | {"best_end_px": max(best, exposure.bounds()["end_px"])}
        start = time.process_time()
        fit = fitter.fit(exposure.pixels, exposure.detection)
        cost.append(1e3 * (time.process_time() - start))
        if fit.flags & (StreakFlag.FIT_FAILED | StreakFlag.POINT_LIKE):
            failed += 1
            continue
        rows.append(measure(exposure, fit, bounds))
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return columns | {"cost_ms": np.array(cost), "failed": np.array([failed / n])}


def figures_of(cells: list[dict[str, NDArray[np.float64]]]) -> dict[str, Any]:
    """Figures of one or more cells together."""
    c = {name: np.concatenate([cell[name] for cell in cells]) for name in cells[0]}
    ends = np.stack([c["end0"], c["end1"]], axis=1)
    ends_crlb = np.stack([c["end0_crlb"], c["end1_crlb"]], axis=1)
    ends_best = np.stack([c["end0_best"], c["end1_best"]], axis=1)
    ends_z = np.stack([c["end0_z"], c["end1_z"]], axis=1)
    gaussian = c["gaussian"] > 0.5
    return {
        "cross_crlb_ratio": figure(c["cross"], rms),
        "cross_pull_std": figure(c["cross_z"], pull),
        "ends_attainable_ratio": figure(ends, rms),
        "ends_best_equivariant_ratio": figure(ends_best, rms),
        "ends_crlb_ratio": figure(ends_crlb, rms),
        "ends_pull_std_where_gaussian": figure(ends_z[gaussian], pull),
        "ends_coverage_68": figure(np.stack([c["covered0"], c["covered1"]], axis=1), lambda x: float(np.mean(x))),
        "flux_crlb_ratio": figure(c["flux"], rms),
        "flux_bias": figure(c["flux_relative"], lambda x: float(np.mean(x))),
        "flux_pull_std": figure(c["flux_z"], pull),
        "failed_fraction": float(np.mean(c["failed"])),
        "cost_ms": float(np.median(c["cost_ms"])),
    }


def single_frames(quick: bool) -> dict[str, Any]:
    """Every cell of length and S/N, and all of S/N >= 8 together."""
    lengths, snrs = ((20.0, 100.0, 300.0), (8.0, 15.0, 50.0)) if quick else (LENGTHS_PX, SNRS)
    cells, out = {}, {}
    for length in lengths:
        for snr in snrs:
            n = 60 if quick else (200 if length < 1000 else 80)
            cells[length, snr] = run_cell(length, snr, n, seed=5)
            out[f"length_{length:g}_snr_{snr:g}"] = figures_of([cells[length, snr]])
    out["all_snr_8_up"] = figures_of([cell for (_, snr), cell in cells.items() if snr >= 8.0])
    for snr in snrs:
        out[f"all_lengths_snr_{snr:g}"] = figures_of([cell for (_, s), cell in cells.items() if s == snr])
    return out


def tracklet_cell(length_px: float, snr: float, n_frames: int, n: int, line_time_s: float, seed: int) -> dict[str, Any]:
    """Along-track errors of jointly refitted ends over the joint bound of all frames, and pulls.

    The joint bound ties all ends to a position and a rate: J^T I J summed over frames, I the ends' information.
    """
    rng = np.random.default_rng([seed, int(length_px), int(snr), n_frames])
    fitter = TrailedPsfFitter()
    exposure_s, period_s = 0.2, 0.25
    ratios, z, covered, single, cost = [], [], [], [], []
    for _ in range(n):
        angle = float(rng.uniform(-1.4, 1.4))
        forward = bool(rng.random() < 0.5)
        speed_px_s = length_px / exposure_s
        row_speed = speed_px_s * math.sin(angle) * (1.0 if forward else -1.0)
        # a mover with both ends inside is exposed for T / (1 - v_row line_time)
        lit_px = length_px / (1.0 - row_speed * line_time_s)
        frames, truths, information = [], [], []
        for k in range(n_frames):
            shot = expose(rng, trail_at(rng, lit_px, angle_rad=angle), snr)
            fit = fitter.fit(shot.pixels, shot.detection)
            if fit.flags & (StreakFlag.FIT_FAILED | StreakFlag.POINT_LIKE):
                break
            frame, truth = _timed(shot, fit, forward, k * period_s, exposure_s, line_time_s, speed_px_s)
            frames.append(frame)
            truths.append(truth)
            if not information or lit_px <= 20.0:
                bounds = shot.bounds()
                pair = np.full((2, 2), bounds["end_cov_px2"])
                np.fill_diagonal(pair, bounds["end_px"] ** 2)
                information.append(np.linalg.inv(pair))
            else:
                information.append(information[-1])
        if len(frames) < n_frames:
            continue
        start = time.process_time()
        refitted = refit_tracklet(frames).fits
        cost.append(1e3 * (time.process_time() - start))
        epochs = np.array([[k * period_s, k * period_s + exposure_s] for k in range(n_frames)])
        jacobians = np.stack([np.ones_like(epochs), epochs], axis=2)
        joint = np.linalg.inv(sum(j.T @ i @ j for j, i in zip(jacobians, information, strict=True)))
        bound = np.sqrt(np.einsum("kei,ij,kej->ke", jacobians, joint, jacobians))
        for k, (fit, truth) in enumerate(zip(refitted, truths, strict=True)):
            error = _along(truth, fit)
            direction = _direction(truth)
            sigma = [math.sqrt(direction @ fit.covariance_px2[i : i + 2, i : i + 2] @ direction) for i in (0, 2)]
            ratios.append(error / bound[k])
            z.append(error / sigma)
            single.append(_along(truth, frames[k].fit) / bound[k])
            low, high = fit.end_interval_px[:, 0], fit.end_interval_px[:, 1]
            outward = np.array([error[0], -error[1]])
            covered.append((low <= outward) & (outward <= high))

    def by_tracklet(values: list[NDArray[Any]]) -> NDArray[np.float64]:
        # frames of a tracklet share its motion, so tracklets are drawn, not frames
        return np.array(values, dtype=np.float64).reshape(-1, n_frames * 2)

    return {
        "along_joint_crlb_ratio": figure(by_tracklet(ratios), rms),
        "along_joint_crlb_ratio_robust": figure(by_tracklet(ratios), pull),
        "single_frame_over_joint_crlb_ratio": figure(by_tracklet(single), rms),
        "along_pull_std": figure(by_tracklet(z), pull),
        "coverage_68": figure(by_tracklet(covered), lambda x: float(np.mean(x))),
        "joint_change_point_over_crlb": 4.39 * length_px / (n_frames * snr**2) / float(np.mean(bound)),
        "cost_ms": float(np.median(cost)),
    }


def _timed(
    shot: Exposure, fit: StreakFit, forward: bool, start_s: float, exposure_s: float, line_time_s: float, speed_px_s: float
) -> tuple[TrackletFrame, Trail]:
    """The frame as the chain would hand it over, and the true trail from shutter open to close."""
    trail = shot.trail
    if not forward:
        trail = Trail(row0=trail.row1, col0=trail.col1, row1=trail.row0, col1=trail.col0, flux_e=trail.flux_e)
    cos, sin = trail.axes
    if (fit.row1 - fit.row0) * sin + (fit.col1 - fit.col0) * cos < 0.0:
        fit = reversed_ends(fit)
    origin = speed_px_s * (start_s + trail.row0 * line_time_s)

    def along(row: float, col: float) -> float:
        return origin + (row - trail.row0) * sin + (col - trail.col0) * cos

    frame = TrackletFrame(
        pixels=shot.pixels,
        fit=fit,
        along0=along(fit.row0, fit.col0),
        along1=along(fit.row1, fit.col1),
        along_per_px=1.0,
        t_open_s=start_s + fit.row0 * line_time_s,
        t_close_s=start_s + exposure_s + fit.row1 * line_time_s,
        line_time_s=line_time_s,
    )
    return frame, trail


def _direction(trail: Trail) -> NDArray[np.float64]:
    """Unit vector (row, col) of the motion."""
    cos, sin = trail.axes
    return np.array([sin, cos])


def _along(trail: Trail, fit: StreakFit) -> NDArray[np.float64]:
    """(2,) errors of both ends along the motion."""
    truth = np.array([[trail.row0, trail.col0], [trail.row1, trail.col1]])
    return (np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]]) - truth) @ _direction(trail)


def tracklets(quick: bool) -> dict[str, Any]:
    """Joint refits: short and long, faint and bright, global and rolling shutter."""
    cells = [(50.0, 10.0, 4, 0.0), (100.0, 15.0, 4, 0.0)]
    if not quick:
        cells += [(20.0, 10.0, 4, 0.0), (20.0, 10.0, 8, 0.0), (50.0, 10.0, 8, 0.0), (100.0, 8.0, 8, 0.0), (100.0, 10.0, 8, 0.0)]
        cells += [(100.0, 25.0, 4, 0.0), (100.0, 25.0, 4, 1e-4), (300.0, 15.0, 6, 0.0), (300.0, 25.0, 8, 0.0)]
    return {
        f"length_{length:g}_snr_{snr:g}_frames_{frames}" + ("_rolling" if tau else ""): tracklet_cell(
            length, snr, frames, 25 if quick else 40, tau, seed=9
        )
        for length, snr, frames, tau in cells
    }


def crossers() -> dict[str, Any]:
    """Cost of a trail from edge to edge along the diagonal of a large frame."""
    rng = np.random.default_rng(3)
    shot = expose(rng, trail_at(rng, 5700.0, angle_rad=0.7), 40.0, margin_px=5.0)
    fitter = TrailedPsfFitter()
    start = time.process_time()
    for _ in range(3):
        fit = fitter.fit(shot.pixels, shot.detection)
    return {"length_px": fit.length_px, "n_pixels": len(shot.pixels.row), "cost_ms": 1e3 * (time.process_time() - start) / 3}


def warm_up() -> float:
    """Compile everything; CPU seconds."""
    start = time.process_time()
    rng = np.random.default_rng(0)
    fitter = TrailedPsfFitter()
    for length in (4.0, 12.0, 200.0):
        shot = expose(rng, trail_at(rng, length), 30.0)
        fitter.fit(shot.pixels, shot.detection)
    return time.process_time() - start


def main(quick: bool = False) -> dict[str, Any]:
    """All figures of the streak fits."""
    cold_s = warm_up()
    return {"cold_cpu_s": cold_s, "single_frame": single_frames(quick), "tracklet": tracklets(quick), "crosser": crossers()}


if __name__ == "__main__":
    print(json.dumps(main(quick="--quick" in sys.argv), indent=1))  # noqa: T201  a script's output
