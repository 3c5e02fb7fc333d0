"""Is a first frame as good as the others: ``python -m tests.benchmarks.first_frames --runs 24 [--side 1024]``.

Short runs of the simulator, the same frames twice through the chain: every frame judged at once (`OnboardChain.process`), and
frames without a predecessor waiting for the next one (`onboard.latency`). Completeness for trails of S/N >= 8 as `sboc score`
counts it (regions hold 90 % of the light), false regions that carry no impostor's flag, CPU-seconds. One line of JSON.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from onboard import latency
from onboard.chain import OnboardChain
from onboard.state import OnboardResult
from sboc_e2e.icd.frame import Frame
from sboc_e2e.registry import Registry
from sboc_e2e.run.onboard_stage import onboard_chain
from sboc_e2e.scenario import load
from sboc_e2e.score.detection import FLUX_HELD, LEAST_DETECTABLE_SNR, RoiFootprints
from sboc_e2e.score.evaluation import truth_streaks
from simulator.chain import Simulator
from simulator.scene.stars import sky_catalogue

SIDES: Final = {512: ("72 um", "4 cm", "80 us"), 1024: ("36 um", "8 cm", "40 us")}
"""Pixel, aperture and line time that keep the field of `smoke` on so many pixels: 512 is crowded."""


def at_once(chain: OnboardChain, frames: list[Frame]) -> list[OnboardResult]:
    """Every frame judged when it comes."""
    state, results = chain.initial_state(), list[OnboardResult]()
    for frame in frames:
        state, result = chain.process(state, frame)
        results.append(result)
    return results


def with_latency(chain: OnboardChain, frames: list[Frame]) -> list[OnboardResult]:
    """Frames without a predecessor wait."""
    sequence = latency.FrameSequence(chain=chain, state=chain.initial_state())
    results = [result for frame in frames for result in sequence.take(frame)]
    return [*results, *sequence.flush()]


def run(seed: int, side: int, n_frames: int) -> list[dict[str, Any]]:
    """Counts of one run: mode, frame, truth and found trails, false regions, CPU-seconds of the run."""
    pixel, aperture, line_time = SIDES[side]
    scenario = load(
        "smoke", registry=Registry(), seed=seed,
        overrides=[
            f"instrument.rows={side}", f"instrument.cols={side}", f'instrument.pixel="{pixel}"',
            f'shutter.line_time="{line_time}"', f'instrument.aperture="{aperture}"', f"frames={n_frames}",
        ],
    )  # fmt: skip
    simulator = Simulator(scenario.simulator, seed=seed, catalogue=sky_catalogue(scenario.simulator.stars))
    calibration = simulator.calibration()
    made = [simulator.frame(number) for number in range(n_frames)]
    rows = []
    for mode, judge in (("at once", at_once), ("latency", with_latency)):
        chain = onboard_chain(scenario, calibration=calibration, camera=calibration.camera, run_id=1)
        start = time.process_time()
        results = judge(chain, [frame for frame, _ in made])
        cpu_s = time.process_time() - start
        for (frame, truth), result in zip(made, results, strict=True):
            streaks = truth_streaks(Table(truth.streaks))
            footprints = RoiFootprints()
            footprints.add_frame(frame.header.frame, frame.pixels.shape, result.rois, streaks)
            wanted = [s for s in streaks if s.counted and s.snr >= LEAST_DETECTABLE_SNR]
            found = sum(footprints.captured[s.index] >= FLUX_HELD for s in wanted)
            rows.append(
                {
                    "mode": mode, "seed": seed, "frame": frame.header.frame, "cpu_s": cpu_s,
                    "truth": len(wanted), "found": found, "false": footprints.n_false_unflagged,
                }
            )  # fmt: skip
    return rows


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Completeness of first and later frames with 68 % intervals of runs drawn again, false regions, CPU ratio."""
    out: dict[str, Any] = {}
    seeds = sorted({row["seed"] for row in rows})
    rng = np.random.default_rng(1)
    drawn = rng.integers(0, len(seeds), (2000, len(seeds)))
    for mode in ("at once", "latency"):
        share = {}
        for name, first in (("first", True), ("later", False)):
            mine = [row for row in rows if row["mode"] == mode and (row["frame"] == 0) == first]
            by_seed = np.array([[sum(r[k] for r in mine if r["seed"] == s) for k in ("found", "truth", "false")] for s in seeds])
            found, truth, false = by_seed.sum(axis=0)
            boot = by_seed[drawn].sum(axis=1)
            share[name] = boot[:, 0] / np.maximum(boot[:, 1], 1)
            out[f"{mode}, {name}"] = {
                "found": int(found), "truth": int(truth), "completeness": round(found / max(truth, 1), 4),
                "interval": [round(float(x), 4) for x in np.quantile(share[name], (0.16, 0.84))],
                "false": int(false), "frames": len(mine),
            }  # fmt: skip
        difference = share["first"] - share["later"]
        out[f"{mode}, first less later"] = [round(float(x), 4) for x in np.quantile(difference, (0.16, 0.5, 0.84))]
    cpu = {mode: sum(r["cpu_s"] for r in rows if r["mode"] == mode and r["frame"] == 0) for mode in ("at once", "latency")}
    out["cpu_ratio"] = round(cpu["latency"] / cpu["at once"], 4)
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--side", type=int, default=512, choices=sorted(SIDES))
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--seed", type=int, default=700, help="of the first run")
    parser.add_argument("--out", type=Path, help="counts of every frame, one line of JSON each")
    asked = parser.parse_args()
    run(asked.seed, asked.side, 2)  # kernels are compiled or read
    counts: list[dict[str, Any]] = []
    for seed in range(asked.seed, asked.seed + asked.runs):
        counts += run(seed, asked.side, asked.frames)
        if asked.out:
            asked.out.write_text("".join(json.dumps(row) + "\n" for row in counts), encoding="utf-8")
        print(seed, file=sys.stderr)  # noqa: T201 - progress
    print(json.dumps(summary(counts), indent=1))  # noqa: T201 - the script's result
