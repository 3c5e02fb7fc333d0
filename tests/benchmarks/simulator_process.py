"""The simulator alone in a process: ``python -m tests.benchmarks.simulator_process SIZE FAINT_LIMIT_MAG N_STREAKS [PRESET]``.

A square field at the anti-Sun point of `sso_antisun` with every effect of the default camera on, and straight streaks of
300 px. PRESET is one of [psf]: as_measured adds everything that real cameras and skies have. Prints as JSON the CPU seconds of
each frame after the first, stars in the frame, and the peak memory of the process while it made them (MB of 10^6 bytes),
interpreter, libraries, catalogue and compiled kernels included.
"""

import json
import math
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import document, toml_files
from simulator.chain import Simulator
from simulator.options import SimulatorOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.sources import ObjectOptions, PixelPathOptions
from tests.benchmarks.onboard_process import memory_mb, reset_peak

EXPOSURE_S = 0.2
LENGTH_PX = 300.0
N_FRAMES = 5
ALL_STARS_MAG = 16.0
"""The default limit: 25,000 to 35,000 stars above S/N 5 in 4096 x 4096 px."""


def trails(n: int, size_px: int) -> list[tuple[float, float, float]]:
    """Row, col of the middle (px) and angle (rad) of streaks wholly inside the frame."""
    rng = np.random.default_rng(20270129)
    return [(*rng.uniform(0.2 * size_px, 0.8 * size_px, 2), float(rng.uniform(0.0, math.pi))) for _ in range(n)]


def of_preset(preset: str) -> SimulatorOptions:
    """The default options over those of a preset of [psf]; none where it is empty."""
    given = toml_files.with_presets({"psf": {"preset": preset}}, toml_files.FOLDER, "benchmark") if preset else {}
    return document.bare("benchmark", {"frames": N_FRAMES, **given}, registry=Registry()).simulator


def options(size_px: int, faint_limit_mag: float, n_streaks: int, preset: str = "") -> SimulatorOptions:
    """The scene."""
    paths = []
    rate = LENGTH_PX / EXPOSURE_S
    for row, col, angle in trails(n_streaks, size_px):
        d_row, d_col = math.sin(angle), math.cos(angle)
        paths.append(
            PixelPathOptions(
                name=f"trail {len(paths)}",
                v_mag=9.0,
                row_px=row - 0.5 * LENGTH_PX * d_row,
                col_px=col - 0.5 * LENGTH_PX * d_col,
                row_rate_px_s=rate * d_row,
                col_rate_px_s=rate * d_col,
            )
        )
    base = of_preset(preset)
    return replace(
        base,
        frames=N_FRAMES,
        instrument=replace(base.instrument, rows=size_px, cols=size_px),
        stars=replace(base.stars, faint_limit_mag=faint_limit_mag),
        population=PopulationOptions(classes=()),
        objects=ObjectOptions(passing=(), pixel_path=tuple(paths)),
    )


def measure(size_px: int, faint_limit_mag: float, n_streaks: int, preset: str = "") -> dict[str, Any]:
    """The figures, measured in this process."""
    simulator = Simulator(options(size_px, faint_limit_mag, n_streaks, preset), seed=1, catalogue=StarCatalogue.embedded())
    costs, peaks, made = [], [], None
    for k in range(N_FRAMES):
        reset_peak()
        begin = time.process_time()
        _, made = simulator.frame(k)
        costs.append(time.process_time() - begin)
        peaks.append(memory_mb("VmHWM"))
    counts = {"n_stars": len(made.stars), "n_streaks": len(made.streaks)} if made else {}
    return {"cpu_s": costs[1:], "first_cpu_s": costs[0], "peak_mb": max(peaks), **counts}


def ask(size_px: int, faint_limit_mag: float, n_streaks: int, preset: str = "") -> dict[str, Any]:
    """The figures, measured in a process of their own."""
    command = [sys.executable, "-m", "tests.benchmarks.simulator_process", str(size_px), str(faint_limit_mag), str(n_streaks)]
    command += [preset] if preset else []
    return dict(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), *sys.argv[4:])))
