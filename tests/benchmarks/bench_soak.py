"""Soak of the on-board chain: thousands of frames from eight stored ones; memory must stay flat, latency is a histogram."""

import dataclasses
import json
import resource
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.frame import Frame
from sboc_e2e.registry import Registry
from sboc_e2e.run.onboard_stage import onboard_chain
from sboc_e2e.scenario import load
from sboc_e2e.score.figures import exact
from simulator.chain import Simulator

STORED: Final = 8
SETTLED_SHARE: Final = 0.2
"""Growth is measured after this share of the frames: caches and pools fill first."""


def resident_mb() -> float:
    """Resident memory of this process now, MB (Linux), or its peak elsewhere."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def soak(scenario_name: str, n_frames: int, overrides: tuple[str, ...] = ()) -> dict[str, Any]:
    """Growth of memory per thousand frames and quantiles of the latency of one frame."""
    scenario = load(scenario_name, registry=Registry(), overrides=(f"frames={STORED}", *overrides))
    simulator = Simulator(scenario.simulator, seed=scenario.seed, catalogue=StarCatalogue.embedded())
    stored = [simulator.frame(k)[0] for k in range(STORED)]
    calibration = simulator.calibration()
    del simulator
    chain = onboard_chain(scenario, calibration=calibration, camera=calibration.camera, run_id=1)
    state = chain.initial_state()
    period_ns = round(1e9 / scenario.simulator.frame_rate_hz)
    latency_ms, memory_mb, sent = [], [], 0
    for k in range(n_frames):
        source = stored[k % STORED]
        header = dataclasses.replace(source.header, frame=k, t_start_tai_ns=stored[0].header.t_start_tai_ns + k * period_ns)
        start = time.process_time()
        state, result = chain.process(state, Frame(header=header, pixels=source.pixels))
        latency_ms.append(1000.0 * (time.process_time() - start))
        memory_mb.append(resident_mb())
        sent += len(result.packets)
    settled = int(SETTLED_SHARE * n_frames)
    frames = np.arange(settled, n_frames)
    growth = float(np.polyfit(frames, memory_mb[settled:], 1)[0]) * 1000.0
    quantiles = np.percentile(latency_ms[settled:], [50, 90, 99, 100])
    counts, edges = np.histogram(latency_ms[settled:], 20)
    return {
        "frames": exact(n_frames, n_frames),
        "growth_mb_per_1000_frames": exact(growth, len(frames)),
        "resident_rss_mb": exact(memory_mb[-1], 1),
        "resident_rss_mb_least_after_settling": exact(min(memory_mb[settled:]), len(frames)),
        "resident_rss_mb_most_after_settling": exact(max(memory_mb[settled:]), len(frames)),
        "downlink_bytes_per_frame": exact(sent / n_frames, n_frames),
        **{f"latency_cpu_ms_p{p}": exact(float(q), len(frames)) for p, q in zip((50, 90, 99, 100), quantiles, strict=True)},
        "latency_histogram": {"edges_ms": edges.round(2).tolist(), "counts": counts.tolist()},
    }


def main(quick: bool = False) -> dict[str, Any]:
    """10,000 frames of 512 x 512 and 2,000 of 4096 x 4096; the quick form takes 200 and none."""
    small = soak("smoke", 200 if quick else 10_000)
    return {"smoke_512": small} if quick else {"smoke_512": small, "sso_antisun_4096": soak("sso_antisun", 2_000)}


if __name__ == "__main__":
    print(json.dumps(main(), indent=2))  # noqa: T201 - the script's result
