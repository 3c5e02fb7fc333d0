"""Cost of the simulator and of its sensor half in CPU seconds of one core, beside numpy's floor measured in the same run.

`main()` returns a dictionary of figures; run as a script it prints them as JSON. Compilation is excluded (a first call at a small
size) and the cold time of that call is given apart. Whole frames (all effects, all stars, streaks) are made in a process of
their own.
"""

import json
import resource
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.exposure import render_stars, render_trail
from simulator.radiation import ParticleField, RadiationOptions
from simulator.sensor import Sensor, SensorOptions
from tests.benchmarks.peers.environment import spread
from tests.benchmarks.simulator_process import ALL_STARS_MAG, ask

SKY_E = 2.8
EXPOSURE_S = 0.2
STARS_PER_PIXEL = 30000 / 4096**2


def cpu_s(work: Callable[[], Any], repeats: int) -> float:
    """Least CPU time of some repeats."""
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return best


def numpy_floor(mean_e: NDArray[np.float32]) -> NDArray[np.uint16]:
    """What plain numpy does at the least: exact Poisson, normal read noise, one converter."""
    rng = np.random.default_rng(1)
    signal = rng.poisson(mean_e) + rng.normal(0.0, 2.3, mean_e.shape)
    return np.clip(np.rint(signal / 1.2 + 100.0), 0, 65535).astype(np.uint16)


def bench_size(size: int, repeats: int) -> dict[str, float]:
    """Figures of one frame size."""
    rng = np.random.default_rng(size)
    n_stars = round(STARS_PER_PIXEL * size**2)
    row, col = rng.uniform(0, size, n_stars), rng.uniform(0, size, n_stars)
    flux = 20.0 * rng.random(n_stars) ** -0.9
    mean_e = np.full((size, size), SKY_E, dtype=np.float32)
    figures = {"stars": cpu_s(lambda: render_stars(mean_e, row, col, flux, 0.85), repeats)}
    mean_e[:] = SKY_E
    render_stars(mean_e, row, col, flux, 0.85)
    start = time.process_time()
    sensor = Sensor(SensorOptions(), rows=size, cols=size, seed=1)
    figures["fixed_pattern_once"] = time.process_time() - start
    field = ParticleField(RadiationOptions(environment="quiet"), rows=size, cols=size, pitch_um=9.0, seed=1)
    storm = ParticleField(RadiationOptions(environment="saa"), rows=size, cols=size, pitch_um=9.0, seed=1)
    hits, many = field.hits(0, EXPOSURE_S, None), storm.hits(0, EXPOSURE_S, None)
    figures["hits_quiet"] = cpu_s(lambda: field.hits(0, EXPOSURE_S, None), repeats)
    figures["hits_saa"] = cpu_s(lambda: storm.hits(0, EXPOSURE_S, None), repeats)
    figures["n_hits_saa"] = float(len(many.tracks))
    figures["digitise"] = cpu_s(lambda: sensor.digitise(mean_e, 0, EXPOSURE_S, hits), repeats)
    figures["digitise_saa"] = cpu_s(lambda: sensor.digitise(mean_e, 0, EXPOSURE_S, many), repeats)
    sensor.entropy_bits(mean_e[:64], EXPOSURE_S)
    figures["entropy_truth"] = cpu_s(lambda: sensor.entropy_bits(mean_e, EXPOSURE_S), repeats)
    return figures


def bench_trails(repeats: int) -> dict[str, float]:
    """CPU seconds of single trails by length and defocus."""
    image = np.zeros((4096, 4096), dtype=np.float32)
    figures = {}
    for defocus_px in (0.0, 8.0):
        for length in (100, 300, 1000, 3000):
            t = (np.arange(2 * length) + 0.5) / (2 * length)
            row, col = 200.0 + 0.6 * length * t, 200.0 + 0.8 * length * t
            flux = np.full(t.size, 10.0)
            name = f"trail_{length}_px_defocus_{defocus_px:g}"
            figures[name] = cpu_s(partial(render_trail, image, row, col, flux, 0.85, defocus_px, 0.3), repeats)
    return figures


def exponent(size: Sequence[float], cost: Sequence[float]) -> float:
    """Power of `size` with which a cost grows: 1 is linear."""
    return float(np.polyfit(np.log(size), np.log(cost), 1)[0])


def bench_whole_frames(sizes: Sequence[int], n_processes: int) -> dict[str, Any]:
    """CPU seconds and peak memory of whole frames for each size, and the power of the number of pixels with which they grow."""
    figures: dict[str, Any] = {}
    for size in sizes:
        answers = [ask(size, ALL_STARS_MAG, round(12 * (size / 4096) ** 2)) for _ in range(n_processes)]
        figures[str(size)] = {
            "cpu_s": spread([cost for answer in answers for cost in answer["cpu_s"]]),
            "peak_rss_mb": spread([answer["peak_mb"] for answer in answers]),
            "n_stars": float(answers[0]["n_stars"]),
        }
    figures["exponent_of_pixels"] = exponent([size**2 for size in sizes], [figures[str(size)]["cpu_s"]["low"] for size in sizes])
    return figures


def main(quick: bool = False) -> dict[str, Any]:
    """All figures; `quick` leaves out the largest frame."""
    start = time.process_time()
    bench_size(64, 1)
    cold_s = time.process_time() - start
    sizes = (1024, 2048) if quick else (1024, 2048, 4096)
    figures: dict[str, Any] = {"cold_cpu_s": cold_s, "trails_cpu_s": bench_trails(3)}
    figures["frames_cpu_s"] = {str(size): bench_size(size, 2 if size == 4096 else 3) for size in sizes}
    figures["hits_of_storm"] = {size: frame.pop("n_hits_saa") for size, frame in figures["frames_cpu_s"].items()}  # no time
    for defocus in ("0", "8"):
        lengths = (300, 1000, 3000)
        cost = [figures["trails_cpu_s"][f"trail_{length}_px_defocus_{defocus}"] for length in lengths]
        figures[f"trail_exponent_of_length_defocus_{defocus}"] = exponent(lengths, cost)
    per_mpx = [figures["frames_cpu_s"][str(size)]["digitise"] / size**2 * 1e6 for size in sizes]
    figures["digitise_cpu_s_per_mpx"] = dict(zip(map(str, sizes), per_mpx, strict=True))
    figures["peak_rss_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    # numpy comes last: its integer images would hide the peak of the sensor.
    for size in sizes:
        mean_e = np.full((size, size), SKY_E, dtype=np.float32)
        frame = figures["frames_cpu_s"][str(size)]
        frame["numpy_floor"] = cpu_s(partial(numpy_floor, mean_e), 1)
        frame["digitise_over_numpy_floor"] = frame["digitise"] / frame["numpy_floor"]
    whole = figures["whole_frames"] = bench_whole_frames(sizes, 1 if quick else 3)
    for size in sizes:
        whole[str(size)]["over_numpy_floor"] = (
            whole[str(size)]["cpu_s"]["value"] / figures["frames_cpu_s"][str(size)]["numpy_floor"]
        )
    return figures


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(), indent=2) + "\n")
