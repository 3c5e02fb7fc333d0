"""Linking figures: completeness, purity, fragments, direction, false tracklets, veto loss, cost; each with n and an interval.

The streaks come from an independent little simulation (tests/link/sky_scene.py); false tracklets are counted at list level, on a
bank of chance streaks and of cosmic-ray tracks whose lengths follow isotropic flux through a thin layer.
"""

import json
import math
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta, chi2

from ground.link import MotionLinker, apply_links
from ground.link.hypotheses import ARCSEC_RAD, FrameTable, StreakTable, relative_log_odds
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement
from sboc_e2e.run.measure import peak_rss_mb
from tests.link.sky_scene import Camera, Mover, mover_somewhere, observe

PIXEL_RAD = 4.64 * ARCSEC_RAD
BLOCK_FRAMES = 500
VETTED = 0.995
"""Share of particle tracks that the vetter rejects: none of 1,000 passed in its benchmark, 95 % upper limit 0.37 %."""


def share(k: int, n: int) -> dict[str, Any]:
    """A proportion with its 90 % Clopper-Pearson interval."""
    if n == 0:
        return {"value": None, "n": 0, "interval": None, "reason": "no case"}
    low = 0.0 if k == 0 else float(beta.ppf(0.05, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(0.95, k + 1, n - k))
    return {"value": k / n, "n": n, "interval": [low, high]}


def rate_per_1000(k: int, n_frames: int) -> dict[str, Any]:
    """A count per 1,000 frames with its 95 % Poisson upper limit."""
    return {
        "value": 1000.0 * k / n_frames,
        "n_frames": n_frames,
        "upper_95": 1000.0 * float(chi2.ppf(0.95, 2 * k + 2)) / 2.0 / n_frames,
    }


def movers_of(camera: Camera, rng: np.random.Generator, n: int, span_s: float, px_s: tuple[float, float]) -> list[Mover]:
    """Objects at random places, log-uniform speeds (px/s), ranges of 10 to 1,000 km, closing or receding up to 10 km/s."""
    movers = []
    for _ in range(n):
        speed = 10 ** rng.uniform(math.log10(px_s[0]), math.log10(px_s[1]))
        angle, range_km = rng.random() * 2 * np.pi, 10 ** rng.uniform(1.0, 3.0)
        closing = float(np.clip(4.0 * rng.normal(), -range_km / (span_s + 1.0), range_km / 4.0))
        movers.append(mover_somewhere(camera, rng, span_s, (speed * np.sin(angle), speed * np.cos(angle)), range_km, closing))
    return movers


def score(camera: Camera, movers: list[Mover], n_frames: int, seed: int, **how: Any) -> dict[str, int]:
    """Counts of one run: the measures of difi (Pieres et al.), with objects of three or more detections as findable."""
    headers, streaks, truth = observe(camera, movers, n_frames, np.random.default_rng(seed), **how)
    tracklets = MotionLinker().link(headers, streaks)
    at = {(s.frame, s.streak_id): k for k, s in enumerate(streaks)}
    owner = np.array(truth.owner)
    detected = np.bincount(owner[owner >= 0], minlength=len(movers))
    found = np.zeros(len(movers), dtype=int)
    counts = dict.fromkeys(("members", "pure", "false", "tracklets"), 0)
    for tracklet in tracklets:
        keys = list(zip(tracklet.frames.tolist(), tracklet.streak_ids.tolist(), strict=True))
        owners, times = np.unique(owner[[at[key] for key in keys]], return_counts=True)
        counts["tracklets"] += 1
        counts["members"] += len(keys)
        counts["pure"] += int(times.max()) if owners[times.argmax()] >= 0 else 0
        counts["false"] += int(owners[times.argmax()] < 0 or times.max() < 2)
        if owners[times.argmax()] >= 0:
            found[owners[times.argmax()]] += 1
    three, two = detected >= 3, detected == 2
    linked = apply_links(streaks, tracklets, headers)
    directed = [(k, s) for k, s in enumerate(linked) if s.flags & StreakFlag.DIRECTION_RESOLVED and owner[k] >= 0]
    right = sum(
        (streaks[k].fit.col0 == s.fit.col0 and streaks[k].fit.row0 == s.fit.row0) == truth.end0_first[k] for k, s in directed
    )
    return counts | {
        "findable": int(three.sum()),
        "found": int((found[three] > 0).sum()),
        "fragments": int(found[three].sum()),
        "two_frames": int(two.sum()),
        "two_found": int((found[two] > 0).sum()),
        "directed": len(directed),
        "right": right,
        "frames": n_frames,
    }


def summed(runs: list[dict[str, int]]) -> dict[str, Any]:
    """Figures of several runs together."""
    total = {key: sum(run[key] for run in runs) for key in runs[0]}
    return {
        "completeness": share(total["found"], total["findable"]),
        "two_frame_completeness": share(total["two_found"], total["two_frames"]),
        "purity": share(total["pure"], total["members"]),
        "fragments_per_object": {"value": total["fragments"] / max(total["found"], 1), "n": total["found"]},
        "direction_correct": share(total["right"], total["directed"]),
        "false_tracklets_per_1000_frames": rate_per_1000(total["false"], total["frames"]),
    }


def chance_streaks(
    n_frames: int, per_frame: float, rng: np.random.Generator, *, cosmic: bool, exactly: bool = False, vetoed: float = 0.0
) -> tuple[StreakTable, FrameTable]:
    """A bank of detections without objects: uniform in place and direction; lengths of cosmic tracks or uniform in the logarithm.

    Isotropic flux through a layer of 1.1 px gives P(> L) = 1 / (1 + (L / 1.1 px)^2). exactly : as many in each frame.
    vetoed : share that the vetter rejected; such streaks may join a track that one which passed has started.
    """
    frame = np.repeat(np.arange(n_frames), round(per_frame) if exactly else rng.poisson(per_frame, n_frames))
    n = len(frame)
    length = 1.1 * np.sqrt(1.0 / rng.uniform(1e-7, 1.0, n) - 1.0) if cosmic else 10 ** rng.uniform(0.8, 2.8, n)
    middle, angle = rng.random((n, 2)) * 4096.0, rng.random(n) * 2.0 * np.pi
    half = 0.5 * length[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    ends = np.clip(middle - half, 0.0, 4095.0), np.clip(middle + half, 0.0, 4095.0)
    edge0, edge1 = np.any(ends[0] != middle - half, axis=1), np.any(ends[1] != middle + half, axis=1)
    points = np.stack([ends[0], 0.5 * (ends[0] + ends[1]), ends[1]], axis=1)
    plane = np.concatenate([(points[:, :, ::-1] - 2048.0) * PIXEL_RAD, np.ones((n, 3, 1))], axis=2)
    rejected = rng.random(n) < vetoed
    table = StreakTable(
        frame=frame,
        streak_id=np.arange(n),
        flags=(
            np.where(np.linalg.norm(ends[1] - ends[0], axis=1) < 4.0, int(StreakFlag.POINT_LIKE), 0)
            | np.where(edge0, int(StreakFlag.EDGE0), 0)
            | np.where(edge1, int(StreakFlag.EDGE1), 0)
            | np.where(rejected, int(StreakFlag.VETOED), 0)
        ).astype(np.int64),
        row=np.ascontiguousarray(points[:, :, 0]),
        col=np.ascontiguousarray(points[:, :, 1]),
        unit=plane / np.linalg.norm(plane, axis=-1, keepdims=True),
        turn_rad_s=np.zeros((n, 3)),
        sigma_along_rad=np.full((n, 2), 0.5 * PIXEL_RAD),
        sigma_cross_rad=np.full(n, 0.15 * PIXEL_RAD),
        scale_rad_px=np.full(n, PIXEL_RAD),
        log_odds=relative_log_odds(np.full(n, 0.5), rejected),
        mag=np.full(n, 10.0),
        mag_err=np.full(n, 0.1),
        track=np.full(n, -1),
        snr=np.full(n, 10.0),
        track_snr=np.zeros(n),
    )
    frames = FrameTable(
        number=np.arange(n_frames),
        start_s=0.25 * np.arange(n_frames),
        exposure_s=np.full(n_frames, 0.2),
        line_time_s=np.full(n_frames, 1e-5),
        shape=np.full((n_frames, 2), 4096),
        origin_tai_ns=0,
    )
    return table, frames


def false_tracklets(
    n_frames: int, per_frame: float, *, cosmic: bool, seed: int, block: int = 500, vetoed: float = 0.0
) -> dict[str, Any]:
    """False tracklets per 1,000 frames of a bank, in blocks."""
    found, done = 0, 0
    start = time.process_time()
    for b in range(math.ceil(n_frames / block)):
        size = min(block, n_frames - done)
        table, frames = chance_streaks(size, per_frame, np.random.default_rng([seed, b]), cosmic=cosmic, vetoed=vetoed)
        found += len(MotionLinker().tracks(table, frames, sky=True))
        done += size
    return rate_per_1000(found, done) | {"streaks_per_frame": per_frame, "cpu_s_per_frame": (time.process_time() - start) / done}


class Records(Sequence[StreakMeasurement]):
    """Chance streaks of a run as the contract's records, each made when it is asked for: as a stage reads them from its files."""

    def __init__(self, n_frames: int, per_frame: int) -> None:
        self.n_frames, self.per_frame = n_frames, per_frame
        self._block, self._table = -1, None

    def __len__(self) -> int:
        return self.n_frames * self.per_frame

    def __getitem__(self, k: int) -> StreakMeasurement:  # type: ignore[override]
        if not 0 <= k < len(self):
            raise IndexError(k)
        block, place = divmod(k, BLOCK_FRAMES * self.per_frame)
        if block != self._block:
            frames = min(BLOCK_FRAMES, self.n_frames - block * BLOCK_FRAMES)
            rng = np.random.default_rng([3, block])
            self._block, self._table = block, chance_streaks(frames, self.per_frame, rng, cosmic=False, exactly=True)[0]
        return self._record(k, place, block * BLOCK_FRAMES)

    def _record(self, k: int, place: int, first_frame: int) -> StreakMeasurement:
        table = self._table
        row, col, unit = table.row[place], table.col[place], table.unit[place]
        flags = StreakFlag(int(table.flags[place]))
        fit = StreakFit(
            row0=float(row[0]), col0=float(col[0]), row1=float(row[2]), col1=float(col[2]),
            covariance_px2=np.diag([0.25, 0.0225, 0.25, 0.0225]), end_interval_px=np.array([[-0.5, 0.5], [-0.5, 0.5]]),
            sigma_cross_px=0.15, flux_e=1000.0 + k, flux_err_e=50.0 + k, snr=20.0 + k, sagitta_px=0.0, sagitta_err_px=0.1 + k,
            gradient=0.1 + k, width_px=0.85 + k, width_err_px=0.02 + k, chi2_nu=1.0 + k, n_pixels=100, flags=flags,
            light_curve_e_px=np.arange(10, dtype=np.float32),
        )  # fmt: skip
        return StreakMeasurement(
            frame=first_frame + int(table.frame[place]), streak_id=k, roi_id=k, fit=fit, row_mid=float(row[1]),
            col_mid=float(col[1]), ra_deg=np.degrees(np.arctan2(unit[:, 1], unit[:, 0])),
            dec_deg=np.degrees(np.arcsin(unit[:, 2])),
            t_tai_ns=np.zeros(3, dtype=np.int64), sigma_along_arcsec=2.3 + k, sigma_cross_arcsec=0.7 + k, mag=10.0 + k,
            mag_err=0.1 + k, probability=0.5, tracklet_id=-1, flags=flags,
        )  # fmt: skip


def run_cost(n_frames: int, per_frame: int) -> dict[str, Any]:
    """CPU seconds and peak memory of this process to link a long run, the making of its records included."""
    headers = [
        FrameHeader(
            frame=k, t_start_tai_ns=10**18 + k * 250_000_000, exposure_ns=200_000_000, line_time_ns=10_000, rows=4096, cols=4096
        )
        for k in range(n_frames)
    ]  # fmt: skip
    MotionLinker().link(headers[:40], Records(40, per_frame))  # compiles
    compiled_mb = peak_rss_mb()
    records = Records(n_frames, per_frame)
    start = time.process_time()
    found = MotionLinker().link(headers, records)
    return {
        "frames": n_frames,
        "streaks": len(records),
        "tracklets": len(found),
        "cpu_s": time.process_time() - start,
        "peak_rss_mb": peak_rss_mb(),
        "before_linking_mb": compiled_mb,
    }


def cost(n_frames: int, per_frame: int) -> dict[str, Any]:
    """`run_cost` in a process of its own, whose memory nothing else has used."""
    words = [sys.executable, "-m", "tests.benchmarks.bench_linking", "--cost", str(n_frames), str(per_frame)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures


def main(quick: bool = True) -> dict[str, Any]:
    """All figures; quick: about a minute, else about seven."""
    camera, fast_rows = Camera(), Camera(rows=1024, cols=1024, line_time_s=100e-6)
    seeds = range(2 if quick else 5)
    start = time.process_time()
    score(camera, movers_of(camera, np.random.default_rng(0), 3, 2.0, (100, 1000)), 8, 0, false_per_frame=5)
    cold_s = time.process_time() - start
    cases: dict[str, tuple[Camera, tuple[float, float], dict[str, Any]]] = {
        "slow_to_fast": (camera, (100.0, 4000.0), {}),
        "fast_and_cut": (camera, (2000.0, 9000.0), {}),
        "faint_ends": (camera, (100.0, 4000.0), {"sigma_along": 8.0, "sigma_cross": 0.4, "p_seen": 0.7}),
        "wrong_ends": (camera, (100.0, 4000.0), {"p_wrong_end": 0.15}),
        "rolling_shutter": (fast_rows, (300.0, 4000.0), {}),
        "pixels_only": (camera, (100.0, 4000.0), {"sky": False}),
    }
    out: dict[str, Any] = {"cold_s": cold_s}
    for name, (view, px_s, how) in cases.items():
        settings: dict[str, Any] = {"false_per_frame": 50.0, "p_seen": 0.9, "jitter_px": 0.05} | how
        runs = []
        for seed in seeds:
            movers = movers_of(view, np.random.default_rng([1, seed]), 120 if px_s[1] > 5000 else 60, 12.0, px_s)
            runs.append(score(view, movers, 48, seed, **settings))
        out[name] = summed(runs)
    scale = 1 if quick else 10
    out["false_50_chance_streaks"] = false_tracklets(3000 * scale, 50, cosmic=False, seed=5)
    out["false_20_cosmics_left_of_1000"] = false_tracklets(3000 * scale, 20, cosmic=True, seed=6)
    out["false_100_cosmics_left_of_5000"] = false_tracklets(1500 * scale, 100, cosmic=True, seed=7)
    # all of a storm, of which the vetter lets through what its benchmark's upper limit allows
    out["false_1000_cosmics_vetted"] = false_tracklets(600 * scale, 1000, cosmic=True, seed=9, block=50, vetoed=VETTED)
    out["false_5000_cosmics_vetted"] = false_tracklets(60 * scale, 5000, cosmic=True, seed=10, block=20, vetoed=VETTED)
    out["false_1000_cosmics_unvetted"] = false_tracklets(30 * scale, 1000, cosmic=True, seed=8, block=30)
    out["cost"] = cost(2000 if quick else 10_000, 50)
    # here, so that the process that links alone does not load what a whole stage needs
    from tests.benchmarks import ground_run

    out["ground_run"] = ground_run.ask(300 if quick else 10_000, 50)
    return out


if __name__ == "__main__":
    if sys.argv[1:2] == ["--cost"]:
        result = run_cost(int(sys.argv[2]), int(sys.argv[3]))
    else:
        result = main(quick="--full" not in sys.argv)
    sys.stdout.write(json.dumps(result, indent=1) + "\n")
