"""Slow objects in sums of many frames: S50 per frame, noise above S/N against theory, CPU-seconds.

Cubes of noise (with stars that jitter on request) and points that move within a box of velocities, drawn by `detection_frames`
independently of the simulator. Frames are pieces of a sensor of 4096 x 4096 px: S/N is asked as of whole ones. Run from the
repository's root:

    python -m tests.benchmarks.bench_stacks                      # 32 frames of 512 x 512, noise
    python -m tests.benchmarks.bench_stacks --stars --frames 128
    python -m tests.benchmarks.bench_stacks --box meo --size 768 --stars    # objects on orbits, in the box that their name gives
    python -m tests.benchmarks.bench_stacks --whole 30    # windows of whole frames of noise: what is above the threshold itself
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.image import registration
from onboard.track.boxes import blind_box
from onboard.track.false_alarms import expected_above, half_point_sigma, independent_stacks, threshold_sigma
from onboard.track.joint_and_stack import JointAndStackTracker
from onboard.track.stack import WARM_UP, Box, SlowObject, Stack
from sboc_e2e.icd.signals import StarList
from sboc_e2e.score.figures import half_point, rate
from tests.benchmarks import detection_frames
from tests.benchmarks.detection_frames import PSF_SIGMA_PX, Scene, Streak, add_streak, exposure, random_stars, view_of
from tests.benchmarks.orbits_in_view import DRAWN, Observer

PERIOD_S, EXPOSURE_S = 0.25, 0.2
STARS = 25_000
WHOLE_PX = 4096
JITTER_PX = 0.4
FOCAL_PX = 0.4 / 9e-6
"""Of `sboc_like`."""

GEO = Box(row_px_s=1.6, col_px_s=9.0, half_row_px_s=0.4, half_col_px_s=0.88)
"""0.2 x 0.44 px in 0.25 s about the motion of a geostationary object seen from a low orbit."""

BOXES = ("given", *DRAWN, "blind")

LOW_SNR = 5.2
"""Noise is counted from here on: at the threshold itself too few windows would be seen."""


@dataclass(frozen=True, kw_only=True)
class PieceStack(Stack):
    """Asks of a piece of the sensor what it would ask of all of it."""

    least_snr: float = 0.0

    def threshold(self, shape: tuple[int, int], period_s: float, psf_sigma_px: float) -> float:
        """That of the whole sensor, or a given one."""
        return self.least_snr or super().threshold((WHOLE_PX, WHOLE_PX), period_s, psf_sigma_px)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Place at the first frame's middle of exposure (px), rates (px/s), S/N in each frame."""

    start: NDArray[np.float64]
    rate: NDArray[np.float64]
    snr: float


@dataclass(frozen=True, kw_only=True)
class Motions:
    """A box that is searched, and how the rates (row, col; px/s) of objects are drawn."""

    box: Box
    rate: Callable[[np.random.Generator], NDArray[np.float64]]

    @classmethod
    def all_of(cls, box: Box) -> "Motions":
        """Any rate of a box alike."""
        middle, half = np.array([box.row_px_s, box.col_px_s]), np.array([box.half_row_px_s, box.half_col_px_s])
        return cls(box=box, rate=lambda rng: middle + rng.uniform(-1, 1, 2) * half)

    @classmethod
    def of_orbits(cls, kind: str, frames: int, rng: np.random.Generator) -> "Motions":
        """Objects of a kind in the field of an observer somewhere, and the box that the kind's name gives there."""
        tracker = JointAndStackTracker(box=kind, stack_frames=frames)
        while True:
            observer = Observer.towards_the_night(rng)
            box = tracker.box_of(observer.header(WHOLE_PX), FOCAL_PX)
            # a box of the field's corner alone is passed over: few orbits lead through there
            if box is not None and observer.object_in_view(DRAWN[kind], 0.5 * WHOLE_PX, FOCAL_PX, rng) is not None:
                return cls(box=box, rate=partial(_rate_of_some, observer, kind))


def _rate_of_some(observer: Observer, kind: str, rng: np.random.Generator) -> NDArray[np.float64]:
    """Rate of an object of a kind somewhere in the field, through which there are orbits."""
    while (drawn := observer.object_in_view(DRAWN[kind], 0.5 * WHOLE_PX, FOCAL_PX, rng)) is None:
        pass
    return observer.rate_px_s(*drawn, FOCAL_PX)


def motions(kind: str, frames: int, rng: np.random.Generator) -> Motions:
    """By the name of a box: "given" is `GEO`."""
    if kind == "given":
        return Motions.all_of(GEO)
    return Motions.all_of(blind_box(PERIOD_S)) if kind == "blind" else Motions.of_orbits(kind, frames, rng)


def draw(
    n: int, size: int, seconds: float, low: float, high: float, rng: np.random.Generator, moving: Motions | None = None
) -> list[Truth]:
    """Objects that stay inside, at least 16 px from each other in the middle of the window; moving: in `GEO` by default."""
    moving = moving or Motions.all_of(GEO)
    made: list[Truth] = []
    while len(made) < n:
        rate = moving.rate(rng)
        way = rate * seconds
        if np.abs(way).max() > size - 32.0:
            raise RuntimeError(f"an object moves by {np.abs(way).max():.0f} px in a window: --size {size} is too small")
        start = rng.uniform(8.0 - np.minimum(way, 0.0), size - 8.0 - np.maximum(way, 0.0))
        if all(np.hypot(*(start + 0.5 * way - t.start - 0.5 * seconds * t.rate)) > 16.0 for t in made):
            made.append(Truth(start=start, rate=rate, snr=float(rng.uniform(low, high))))
    return made


def run_cube(
    stack: Stack, truth: list[Truth], size: int, rng: np.random.Generator, n_stars: int = 0
) -> tuple[list[SlowObject], float, float]:
    """What a cube of one window holds, in the grid of its first frame; CPU-seconds of the search and of each frame."""
    stars = random_stars(size, n_stars, rng) if n_stars else None
    state, before, search_s = stack.initial_state(), StarList.empty(), 0.0
    found: list[SlowObject] = []
    frame_s: list[float] = []
    origin = np.zeros(2)
    for k in range(WARM_UP + stack.frames):
        shift = rng.normal(0.0, JITTER_PX, 2) if stars is not None else np.zeros(2)
        origin = shift if k == 0 else origin
        if stars is None:
            scene = Scene(image=rng.standard_normal((size, size), dtype=np.float32) * np.float32(detection_frames.SIGMA))
        else:
            scene = exposure(size, stars, rng, shift_px=(float(shift[0]), float(shift[1])))
        for t in truth:
            ends = [t.start + t.rate * (k * PERIOD_S + s * EXPOSURE_S) + shift for s in (-0.5, 0.5)]
            if (np.array(ends) > 3).all() and (np.array(ends) < size - 4).all():
                row0, col0, row1, col1 = np.concatenate(ends)
                add_streak(scene, Streak(row0=row0, col0=col0, row1=row1, col1=col1, snr=t.snr), rng)
        view = detection_frames.bare_view(scene, frame=k) if stars is None else view_of(scene, frame=k)
        transform = None
        if k:
            transform = np.eye(2, 3) if stars is None else registration.register(before, view.stars, reach_px=300.0)
        before = view.stars
        begin = time.process_time()
        state, new = stack.step(state, view, transform)
        took = time.process_time() - begin
        frame_s.append(took)
        search_s = max(search_s, took)
        found += [replace(o, place=(o.place[0] - origin[0], o.place[1] - origin[1], *o.place[2:])) for o in new]
    return found, search_s, float(np.median(frame_s))


def near(found: SlowObject, truth: Truth, seconds: float) -> bool:
    """Whether a found object lies within 2 px of a true one at the window's middle, and within 3 px at its ends."""
    misses = [
        float(np.hypot(*(found.at(t) - truth.start - truth.rate * t)))
        for t in (found.middle_s, found.middle_s - 0.4 * seconds, found.middle_s + 0.4 * seconds)
    ]
    return misses[0] < 2.0 and max(misses) < 3.0


def noise(frames: int, size: int, cubes: int, n_stars: int) -> dict[str, Any]:
    """Maxima above LOW_SNR in cubes without objects, against what theory expects; figures of time."""
    stack = PieceStack(frames=frames, box=GEO, false_per_window=0.1, least_snr=LOW_SNR)
    snrs, search, each = [], [], []
    for c in range(cubes):
        found, a, b = run_cube(stack, [], size, np.random.default_rng((7, frames, c)), n_stars)
        snrs += [o.snr for o in found]
        search.append(a)
        each.append(b)
    volume = independent_stacks(
        PERIOD_S * np.arange(frames, dtype=np.float64),
        area_px=float(size**2),
        box_px2_s2=GEO.area_px2_s2,
        psf_sigma_px=PSF_SIGMA_PX,
    )
    levels = (5.2, 5.5, 5.8, 6.1)
    return {
        "windows": cubes,
        "above": {str(u): [sum(s > u for s in snrs), round(cubes * expected_above(u, volume), 1)] for u in levels},
        "search_cpu_s": round(float(np.median(search[1:] or search)), 3),
        "frame_cpu_s": round(float(np.median(each[1:] or each)), 4),
    }


def whole_windows(frames: int, windows: int, n_stars: int) -> dict[str, Any]:
    """False objects at the threshold in windows of whole frames, each written as soon as it is done; see `noise`."""
    stack = PieceStack(frames=frames, box=GEO, false_per_window=0.1)
    false, search, each = 0, [], []
    for c in range(windows):
        found, a, b = run_cube(stack, [], WHOLE_PX, np.random.default_rng((9, n_stars, c)), n_stars)
        false += len(found)
        search.append(a)
        each.append(b)
        sys.stdout.write(f"window {c}: {[round(o.snr, 3) for o in found]}\n")
        sys.stdout.flush()
    return {
        "false_per_window": rate(false, float(windows), windows),
        "search_cpu_s": round(float(np.median(search)), 3),
        "frame_cpu_s": round(float(np.median(each)), 4),
    }


def completeness(frames: int, size: int, cubes: int, n_stars: int, box: str = "given") -> dict[str, Any]:
    """S50 per frame; places and S/N of what was found against the truth. Each cube has a box of its own where orbits give it."""
    seconds = PERIOD_S * (frames + WARM_UP)
    snr, seen, errors, ratios, false = [], [], [], [], 0
    ideals, sums, search, outside = [], [], [], 0
    for c in range(cubes):
        rng = np.random.default_rng((8, frames, c))
        moving = motions(box, frames, rng)
        stack = PieceStack(frames=frames, box=moving.box, false_per_window=0.1)
        ideal = half_point_sigma(stack.threshold((size, size), PERIOD_S, PSF_SIGMA_PX)) / frames**0.5
        truth = draw(max(6, size // 40), size, seconds, 0.7 * ideal, 1.6 * ideal, rng, moving)
        outside += sum(not _holds(moving.box, t.rate) for t in truth)
        found, took, _ = run_cube(stack, truth, size, rng, n_stars)
        ideals.append(ideal)
        sums.append(JointAndStackTracker(stack_frames=frames).sums(moving.box))
        search.append(took)
        for t in truth:
            mine = [f for f in found if near(f, t, seconds)]
            snr.append(t.snr)
            seen.append(bool(mine))
            if mine:
                middle = mine[0].middle_s
                errors.append((mine[0].at(middle) - t.start - t.rate * middle) * mine[0].snr / (2.0**0.5 * PSF_SIGMA_PX))
                ratios.append(mine[0].snr / (t.snr * frames**0.5))
        false += sum(not any(near(f, t, seconds) for t in truth) for f in found)
    return {
        "n": len(snr),
        "ideal": round(float(np.mean(ideals)), 3),
        "s50": half_point(snr, seen),
        "false": false,
        "outside_box": outside,
        "sums": [min(sums), max(sums)],
        "search_cpu_s_whole_frame": [round(t * (WHOLE_PX / size) ** 2, 2) for t in (min(search), float(np.median(search)))],
        "error_over_bound": np.round(np.sqrt(np.mean(np.square(errors), axis=0)), 2).tolist(),
        "snr_ratio_bright": round(float(np.median(np.array(ratios)[np.argsort(snr_of(ratios, snr, seen))[-20:]])), 3),
    }


def _holds(box: Box, rate: NDArray[np.float64]) -> bool:
    """Whether a box holds a rate."""
    apart = np.abs(rate - (box.row_px_s, box.col_px_s))
    return bool((apart <= (box.half_row_px_s, box.half_col_px_s)).all())


def snr_of(ratios: list[float], snr: list[float], seen: list[bool]) -> list[float]:
    """S/N of the objects that were found, in their order."""
    return [s for s, hit in zip(snr, seen, strict=True) if hit][: len(ratios)]


def figures(size: int, cubes: int, frames: int, n_stars: int, noise_cubes: int) -> dict[str, Any]:
    """Threshold of the whole sensor, noise against theory, completeness."""
    whole = independent_stacks(
        PERIOD_S * np.arange(frames, dtype=np.float64),
        area_px=WHOLE_PX**2,
        box_px2_s2=GEO.area_px2_s2,
        psf_sigma_px=PSF_SIGMA_PX,
    )
    return {
        "threshold": round(threshold_sigma(whole, 0.1), 3),
        "noise": noise(frames, size, noise_cubes, n_stars),
        "completeness": completeness(frames, size, cubes, n_stars),
    }


def main(quick: bool = False) -> dict[str, Any]:
    """Windows of 32 frames, and in the full form of 128, in noise and among stars."""
    out = {"noise_32": figures(256 if quick else 512, 4 if quick else 10, 32, 0, 4 if quick else 10)}
    return out if quick else out | {"stars_32": figures(512, 10, 32, STARS, 10), "noise_128": figures(512, 6, 128, 0, 6)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--cubes", type=int, default=10)
    parser.add_argument("--frames", type=int, default=32)
    parser.add_argument("--stars", action="store_true")
    parser.add_argument("--noise", type=int, default=0, help="cubes without objects; 0: as many as with them")
    parser.add_argument(
        "--box", choices=BOXES, default="given", help="objects in this box, and nothing else if it is not `given`"
    )
    parser.add_argument("--whole", type=int, default=0, help="windows of whole frames without objects, and nothing else")
    chosen = parser.parse_args()
    stars = STARS if chosen.stars else 0
    if chosen.whole:
        made = whole_windows(chosen.frames, chosen.whole, stars)
    elif chosen.box != "given":
        made = completeness(chosen.frames, chosen.size, chosen.cubes, stars, chosen.box)
    else:
        made = figures(chosen.size, chosen.cubes, chosen.frames, stars, chosen.noise or chosen.cubes)
    sys.stdout.write("\n".join(f"{key}: {json.dumps(value)}" for key, value in made.items()) + "\n")
