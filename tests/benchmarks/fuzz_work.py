"""Work on board of frames that nobody should send, counted: uniform, checkers, ramps, saturated parts, storms, mixtures.

python -m tests.benchmarks.fuzz_work [--frames N] [--side PX] [--first SEED]

Each seed draws a pair of frames; the later one is counted, with the state that the earlier one left. Operations do not depend on
the machine, so that the worst case is a fact about the code. CPU seconds are printed beside them as a check of the counts.
"""

import argparse
import json
import math
import sys
import time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.work import nominal
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.work import Work
from tests.benchmarks import sky_frames
from tests.benchmarks.other_skies import chain, frame
from tests.benchmarks.sky_frames import SATURATION, SIGMA_E, Light, digitised

SIDE: Final = 192


def _sky(rng: np.random.Generator, side: int) -> Light:
    return sky_frames.exposed(np.full((side, side), sky_frames.SKY_E), rng)


def _uniform(rng: np.random.Generator, counts: Light) -> None:
    counts[:] = rng.uniform(0.0, 10.0 ** rng.uniform(0.5, 4.5), counts.shape)


def _checker(rng: np.random.Generator, counts: Light) -> None:
    pitch = int(rng.integers(1, 65))
    row, col = np.indices(counts.shape) // pitch
    counts += 10.0 ** rng.uniform(0.5, 4.5) * ((row + col) % 2)


def _ramp(rng: np.random.Generator, counts: Light) -> None:
    angle, period = rng.uniform(0.0, math.pi), rng.uniform(2.0, 400.0)
    row, col = np.indices(counts.shape)
    counts += 10.0 ** rng.uniform(0.0, 3.5) * (((row * math.sin(angle) + col * math.cos(angle)) / period) % 1.0)


def _half(rng: np.random.Generator, counts: Light) -> None:
    angle, cut = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-0.5, 0.5)
    row, col = np.indices(counts.shape) / counts.shape[0] - 0.5
    counts[row * math.sin(angle) + col * math.cos(angle) > cut] = SATURATION


def _rectangles(rng: np.random.Generator, counts: Light) -> None:
    side = counts.shape[0]
    for _ in range(int(rng.integers(1, 120))):
        (r, c), (h, w) = rng.integers(0, side, 2), rng.integers(1, max(2, side // 2), 2)
        counts[r : r + h, c : c + w] += 10.0 ** rng.uniform(0.0, 5.0)


def _lines(rng: np.random.Generator, counts: Light) -> None:
    for _ in range(int(rng.integers(1, 200))):
        if rng.random() < 0.5:
            counts[int(rng.integers(0, counts.shape[0]))] += 10.0 ** rng.uniform(0.5, 4.5)
        else:
            counts[:, int(rng.integers(0, counts.shape[1]))] += 10.0 ** rng.uniform(0.5, 4.5)


def _storm(rng: np.random.Generator, counts: Light) -> None:
    sky_frames.add_tracks(counts, round(10.0 ** rng.uniform(0.5, 2.9) * (counts.shape[0] / 192.0) ** 2), rng)


def _points(rng: np.random.Generator, counts: Light) -> None:
    n = round(10.0 ** rng.uniform(1.0, 3.7) * (counts.shape[0] / 192.0) ** 2)
    at = rng.uniform(0.0, counts.shape[0], (2, n))
    flux = 10.0 ** rng.uniform(0.5, 4.0) * SIGMA_E * rng.random(n) ** -rng.uniform(0.0, 1.5)
    sky_frames.add_points(counts, at[0], at[1], np.minimum(flux, 1e7), float(rng.uniform(1.0, 5.0)))


def _trails(rng: np.random.Generator, counts: Light) -> None:
    """Equal trails, as stars make them in a camera that turns or follows something."""
    side, n = counts.shape[0], int(rng.integers(5, 120))
    length, angle, turn = rng.uniform(3.0, 60.0), rng.uniform(0.0, math.pi), rng.choice([0.0, rng.uniform(-0.5, 0.5)])
    for row, col in rng.uniform(0.0, side, (n, 2)):
        here = angle + turn * (row + col) / side
        flux = SIGMA_E * 10.0 ** rng.uniform(0.0, 3.0)
        along = np.arange(0.0, length, 0.5)
        sky_frames.add_points(counts, row + along * math.sin(here), col + along * math.cos(here), np.full(len(along), flux), 2.0)


def _arcs(rng: np.random.Generator, counts: Light) -> None:
    counts[:] = sky_frames.arcs(counts.shape[0], rng)


def _glow(rng: np.random.Generator, counts: Light) -> None:
    side = counts.shape[0]
    row, col = np.indices(counts.shape)
    distance = np.hypot(row - rng.uniform(0.0, side), col - rng.uniform(0.0, side))
    counts += 10.0 ** rng.uniform(2.0, 6.0) / (1.0 + distance / rng.uniform(1.0, 50.0)) ** rng.uniform(1.0, 4.0)


KINDS: Final = (_uniform, _checker, _ramp, _half, _rectangles, _lines, _storm, _points, _trails, _arcs, _glow)


def drawn(seed: int, side: int) -> tuple[str, NDArray[np.uint16], NDArray[np.uint16]]:
    """Kinds and a pair of frames of a seed: one kind, or two or three on top of each other; the pair is alike or not at all."""
    rng = np.random.default_rng(seed)
    kinds = [KINDS[k] for k in rng.choice(len(KINDS), size=int(rng.integers(1, 4)), replace=False)]
    if seed < 4 * len(KINDS):  # each kind alone is among the first
        kinds = [KINDS[seed % len(KINDS)]]
    again = rng.random() < 0.5
    state = rng.bit_generator.state
    frames = []
    for _ in range(2):
        if again:
            rng.bit_generator.state = state
        counts = _sky(rng, side)
        for kind in kinds:
            kind(rng, counts)
        frames.append(digitised(counts))
    # the same scene once more, with other noise: stars and structure stand still
    noise = np.random.default_rng((seed, 1)).normal(0.0, SIGMA_E, counts.shape)
    later = digitised(frames[0] + noise) if again else frames[1]
    return "+".join(kind.__name__[1:] for kind in kinds), frames[0], later


def counted(seed: int, side: int = SIDE) -> dict[str, Any]:
    """Operations over nominal, by kind, and what was shed, of one seed's later frame."""
    kinds, earlier, later = drawn(seed, side)
    run = chain(side)
    state, _ = run.process(run.initial_state(), frame(0, earlier))
    start = time.process_time()
    _, result = run.process(state, frame(1, later))
    seconds = time.process_time() - start
    return {
        "seed": seed,
        "kinds": kinds,
        "of_nominal": result.work.operations / nominal(side * side),
        "of_limit": {kind.name: result.work.done[kind] / result.work.limits[kind] for kind in Work},
        "shed": {kind.name: result.work.shed[kind] for kind in Work if result.work.shed[kind]},
        "flagged": bool(result.housekeeping.flags & FrameFlag.WORK_SHED),
        "operations": result.work.operations,
        "cpu_s": seconds,
    }


def main() -> None:
    """The worst case of many seeds, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--side", type=int, default=SIDE)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    counted(0, options.side)
    rows = [counted(seed, options.side) for seed in range(options.first, options.first + options.frames)]
    worst = max(rows, key=lambda row: row["of_nominal"])
    slowest = max(rows, key=lambda row: row["cpu_s"])
    summary = {
        "frames": len(rows),
        "side": options.side,
        "worst": worst,
        "slowest": slowest,
        "above_twice_nominal": sum(row["of_nominal"] > 2.0 for row in rows),
        "shed": sum(row["flagged"] for row in rows),
        "most_of_limit": {kind.name: max(row["of_limit"][kind.name] for row in rows) for kind in Work},
        "ns_per_operation_quantiles": [
            float(np.quantile([1e9 * row["cpu_s"] / row["operations"] for row in rows], q)) for q in (0.05, 0.5, 0.95, 0.99, 1.0)
        ],
    }
    sys.stdout.write(json.dumps(summary, indent=1) + "\n")


if __name__ == "__main__":
    main()
