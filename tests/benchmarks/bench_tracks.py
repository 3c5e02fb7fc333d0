"""Tracks over several frames: S50 per frame by number of frames and length, what is lost where, false tracks, CPU-seconds.

Cubes of noise (with stars on request) and straight tracks, rendered by `detection_frames` independently of the simulator. The
detector searches each frame as in the chain, the tracker what it leaves. Frames are pieces of a sensor of 4096 x 4096 px: joint
S/N and false tracks are asked as of whole ones. Particles of a storm are the simulator's. Run from the repository's root:

    python -m tests.benchmarks.bench_tracks            # 1024 x 1024, minutes
    python -m tests.benchmarks.bench_tracks --stars    # the same among stars
    python -m tests.benchmarks.bench_tracks --seed 93 --frames 8    # other cubes, objects of eight frames alone
    python -m tests.benchmarks.bench_tracks --storm 3000 --cubes 150    # false tracks with so many hits per whole frame
    python -m tests.benchmarks.bench_tracks --storm 3000 --size 4096 --seed 7 --cubes 20    # in 10 x 16 whole frames
"""

import argparse
import json
import math
import sys
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.detect import LineIntegralDetector
from onboard.image import registration
from onboard.track import climb, growth, trail_sums
from onboard.track.joint import JointTracker
from onboard.track.packed import packed
from sboc_e2e.icd.signals import DetectorView, Searched, Track, TrackerView
from sboc_e2e.score.figures import half_point, rate
from simulator.radiation import ParticleField, RadiationOptions
from tests.benchmarks.detection_frames import (
    PSF_SIGMA_PX,
    SIGMA,
    Scene,
    Streak,
    add_streak,
    bare_view,
    exposure,
    random_stars,
    view_of,
)

PERIOD = 1.25
"""Frames follow each other after so many exposures."""

LENGTHS_PX = (20.0, 50.0, 150.0, 400.0, 1000.0)
FRAMES = (2, 3, 4, 8)
STARS = 25_000

WHOLE_PX = 4096
"""Side of the sensor that frames are pieces of."""

SAA_HITS = 5100.0
"""Particles on it in 0.2 s in the simulator's environment `saa`."""

SEED_SHARE, SEED_PX = 0.25, 4.0
"""A seed is an object's where its ends are off by this share of the trail at most, and so little across."""


@dataclass(frozen=True, kw_only=True)
class PieceTracker(JointTracker):
    """Asks of the tracks in a piece of the sensor what it would ask in all of it."""

    def thresholds(self, shape: tuple[int, int], period_over_exposure: float, psf_sigma_px: float) -> NDArray[np.float64]:
        """Those of the whole sensor."""
        return super().thresholds((WHOLE_PX, WHOLE_PX), period_over_exposure, psf_sigma_px)


@dataclass(frozen=True, kw_only=True)
class Storm:
    """Particles on a piece of the sensor; hits : per whole frame of 0.2 s."""

    hits: float
    seed: int

    def field(self, size: int) -> ParticleField:
        """The simulator's, with as many hits as asked."""
        options = RadiationOptions(environment="saa")
        peak = options.saa_peak_omni_cm2_s * self.hits / SAA_HITS
        return ParticleField(replace(options, saa_peak_omni_cm2_s=peak), rows=size, cols=size, pitch_um=9.0, seed=self.seed)


@dataclass(frozen=True, kw_only=True)
class TrueTrack:
    """first : frame of its first trail; ends (n, 4) row0, col0, row1, col1 by growing time; snr : in each frame."""

    first: int
    ends: NDArray[np.float64]
    snr: float

    @property
    def length_px(self) -> float:
        return float(np.hypot(*(self.ends[0, 2:] - self.ends[0, :2])))


def random_track(size: int, length_px: float, n: int, n_frames: int, snr: float, rng: np.random.Generator) -> TrueTrack | None:
    """A track whose n trails all lie wholly inside the frame; None where no such one fits."""
    whole = length_px * (1.0 + PERIOD * (n - 1))
    if whole > 1.3 * (size - 8):
        return None
    while True:
        angle = rng.uniform(0.0, 2.0 * math.pi)
        u = np.array([math.sin(angle), math.cos(angle)])
        room = size - 8 - np.abs(whole * u)
        if (room > 0.0).all():
            corner = 4 + rng.random(2) * room + np.maximum(0.0, -whole * u)
            starts = corner + (PERIOD * length_px * np.arange(n))[:, None] * u
            return TrueTrack(
                first=int(rng.integers(0, n_frames - n + 1)), ends=np.hstack([starts, starts + length_px * u]), snr=snr
            )


def drawn_in(size: int, length_px: float) -> int:
    """Objects of a length that a cube is given: a whole sensor has room for equally many of each."""
    if size >= WHOLE_PX:
        return 6
    return 3 if length_px < 300.0 else 1


def hit(track: Track, truth: TrueTrack) -> float:
    """In how many frames of a true track a found one lies on it: middle within 3 px across and half a length, share of them."""
    found = {member.frame: member.detection for member in track.members}
    good = 0
    for k, (row0, col0, row1, col1) in enumerate(truth.ends):
        d = found.get(truth.first + k)
        if d is None:
            continue
        u = np.array([row1 - row0, col1 - col0]) / truth.length_px
        off = 0.5 * np.array([d.row0 + d.row1 - row0 - row1, d.col0 + d.col1 - col0 - col1])
        forward = float(np.array([d.row1 - d.row0, d.col1 - d.col0]) @ u) > 0.0
        good += forward and abs(off @ u) < max(3.0, 0.5 * truth.length_px) and abs(off[0] * u[1] - off[1] * u[0]) < 3.0
    return good / len(truth.ends)


def joint_snr(truth: TrueTrack, searched: list[Searched]) -> float:
    """Joint S/N that the filter puts at a true track when it starts from the truth. searched : frames of the cube."""
    n = len(truth.ends)
    images = tuple(packed(each.smooth) for each in searched[truth.first : truth.first + n])
    row0, col0, row1, col1 = truth.ends[n // 2]
    steep, sense = abs(row1 - row0) >= abs(col1 - col0), 1.0
    if (row1 < row0) if steep else (col1 < col0):
        row0, col0, row1, col1, sense = row1, col1, row0, col0, -1.0
    length = truth.length_px
    per_lane = max(abs(row1 - row0), abs(col1 - col0)) / length
    seed, transforms = np.array([row0, col0, row1, col1, 0.0]), np.repeat(registration.IDENTITY[None], n, axis=0)
    taus, corridors, place = PERIOD * (np.arange(n) - n // 2), trail_sums.work_space(n), np.empty(4)
    for k in range(n):
        middle, half = (0.5 + sense * taus[k]) * length, (0.9 + 0.12 * abs(taus[k])) * length
        piece = max(1.0, length / growth.FINE)
        trail_sums.collect(images, k, seed, transforms, middle - half, middle + half, piece, corridors, place)
    span = float(np.abs(taus).max())
    best, steps = np.array([0.0, length, 0.0, 0.0]), np.array([length / 8.0, length / 8.0 / span, 0.6, 1.2 / span])
    look = trail_sums.look_of(taus, sense, length, per_lane, PSF_SIGMA_PX)
    return float(climb.climb(corridors, look, 0, n - 1, best, steps, 5, np.empty(4)))


def n_seeded(truth: TrueTrack, searched: list[Searched]) -> int:
    """In how many of its frames a true track has a seed."""
    n = 0
    for k, (row0, col0, row1, col1) in enumerate(truth.ends):
        seeds, length = searched[truth.first + k].seeds, truth.length_px
        u = np.array([row1 - row0, col1 - col0]) / length
        away = seeds[:, :4].reshape(-1, 2, 2) - np.array([row0, col0])
        along, across = np.sort(away @ u, axis=1), np.abs(away[..., 0] * u[1] - away[..., 1] * u[0]).max(axis=1)
        near = SEED_SHARE * length + SEED_PX
        n += bool(((np.abs(along - np.array([0.0, length])) < near).all(axis=1) & (across < SEED_PX)).any())
    return n


def run_cube(
    tracker: JointTracker,
    truth: list[TrueTrack],
    size: int,
    n_frames: int,
    rng: np.random.Generator,
    n_stars: int = 0,
    *,
    storm: Storm | None = None,
    left: list[Searched] | None = None,
) -> tuple[list[Track], float, float]:
    """Tracks found in a cube; CPU-seconds per frame of the search and of the tracker. left : what the searches left is added."""
    detector = LineIntegralDetector()
    stars = random_stars(size, n_stars, rng) if n_stars else None
    particles = None if storm is None else storm.field(size)
    state, found, history, before = tracker.initial_state(), [], (), None
    search_s = track_s = 0.0
    for k in range(n_frames):
        if stars is None:
            scene = Scene(image=rng.standard_normal((size, size), dtype=np.float32) * np.float32(SIGMA))
        else:
            shift = rng.normal(0.0, 0.4, 2)
            scene = exposure(size, stars, rng, shift_px=(float(shift[0]), float(shift[1])))
        offset = np.zeros(2) if stars is None else shift
        for t in truth:
            if t.first <= k < t.first + len(t.ends):
                row0, col0, row1, col1 = t.ends[k - t.first] + np.tile(offset, 2)
                add_streak(scene, Streak(row0=row0, col0=col0, row1=row1, col1=col1, snr=t.snr), rng)
        if particles is not None:
            hits = particles.hits(k, 0.2, None)
            np.add.at(scene.image, (hits.row, hits.col), hits.charge_e)
        view: DetectorView = bare_view(scene, frame=k) if stars is None else view_of(scene, frame=k, history=history)
        view = replace(view, header=replace(view.header, line_time_ns=0))
        start = time.process_time()
        detections, searched = detector.search(view, tracker.seed_sigma)
        middle = time.process_time()
        transform = None
        if k:
            transform = np.eye(2, 3) if stars is None else registration.register(before, view.stars, reach_px=300.0)
        state, tracks = tracker.track(
            state, TrackerView(view=view, detections=detections, searched=searched, transform=transform)
        )
        track_s += time.process_time() - middle
        search_s += middle - start
        found += tracks
        if left is not None:
            left.append(searched)
        if stars is not None:
            history, before = (detector.remembered(view),), view.stars
    found += tracker.finish(state)
    return found, search_s / n_frames, track_s / n_frames


def noise(
    tracker: JointTracker, size: int, cubes: int, n_frames: int, seed: int, n_stars: int = 0, hits: float = 0.0
) -> dict[str, Any]:
    """False tracks (by number of the object) per whole frame, and CPU-seconds of a piece."""
    numbers, search, track, snrs = 0, [], [], []
    for c in range(cubes):
        storm = Storm(hits=hits, seed=1000 * seed + c) if hits else None
        found, a, b = run_cube(tracker, [], size, n_frames, np.random.default_rng((seed, c)), n_stars, storm=storm)
        numbers += len({t.number for t in found})
        snrs += [(round(t.snr, 2), len(t.members)) for t in found]
        search.append(a)
        track.append(b)
    whole = cubes * n_frames * (size / WHOLE_PX) ** 2
    return {
        "false_tracks": numbers, "frames": cubes * n_frames, "false_per_whole_frame": rate(numbers, whole, cubes * n_frames),
        "search_cpu_s": round(float(np.median(search)), 4), "track_cpu_s": round(float(np.median(track)), 4),
        "snr_and_frames": snrs[:20],
    }  # fmt: skip


def completeness(
    tracker: JointTracker,
    size: int,
    cubes: int,
    seed: int,
    spread: float = 2.0,
    n_stars: int = 0,
    numbers: tuple[int, ...] = FRAMES,
) -> dict[str, Any]:
    """S50 per frame by number of frames and length; `cubes` cubes for each number of frames, all lengths in each.

    Without stars, also what perfect seeds would give (`statistic`: the filter started from the truth), and what seeds as they are
    would give with a perfect search from them (`statistic_and_seeds`).
    """
    out: dict[str, Any] = {}
    thresholds = replace(tracker, window=max(FRAMES)).thresholds((size, size), PERIOD, PSF_SIGMA_PX)
    for n in numbers:
        snr: dict[float, list[float]] = {length: [] for length in LENGTHS_PX}
        seen: dict[float, list[bool]] = {length: [] for length in LENGTHS_PX}
        bound: list[tuple[bool, bool]] = []
        drawn: list[TrueTrack] = []
        false, frames = 0, 0
        for c in range(cubes):
            rng = np.random.default_rng((seed, n, c))
            n_frames = n + 2 * (2 if n < 8 else 1)
            guess = {2: 5.4, 3: 4.6, 4: 4.1, 8: 3.2}[n]
            truth = []
            for length in LENGTHS_PX:
                for _ in range(drawn_in(size, length)):
                    t = random_track(size, length, n, n_frames, float(rng.uniform(guess - spread / 2, guess + spread / 2)), rng)
                    truth += [] if t is None else [t]
            if n_stars:  # the first frame has none before it to tell its stars by: nothing is searched in it
                truth = [replace(t, first=t.first + 1) for t in truth]
            drawn += truth
            n_run = n_frames + (tracker.window - 1) // 2 + bool(n_stars)
            left: list[Searched] = []
            found, _, _ = run_cube(tracker, truth, size, n_run, rng, n_stars, left=left)
            matched = set()
            if not n_stars:
                reached = [joint_snr(t, left) >= thresholds[n] for t in truth]
                bound += [(r, r and n_seeded(t, left) > 0) for r, t in zip(reached, truth, strict=True)]
            for t in truth:
                key = min(LENGTHS_PX, key=lambda length, t=t: abs(length - t.length_px))
                good = [f.number for f in found if hit(f, t) >= 0.5]
                matched |= set(good)
                snr[key].append(t.snr)
                seen[key].append(bool(good))
            false += len({f.number for f in found} - matched)
            frames += n_run
        every = [s for values in snr.values() for s in values], [h for values in seen.values() for h in values]
        own = [t.snr for t in drawn]
        out[f"n={n}"] = {
            "all": half_point(*every),
            **({"statistic": half_point(own, [b[0] for b in bound])} if bound else {}),
            **({"statistic_and_seeds": half_point(own, [b[1] for b in bound])} if bound else {}),
            **{f"{length:g}": half_point(snr[length], seen[length]) for length in LENGTHS_PX if len(snr[length]) > 10},
            "false": false, "frames": frames,
        }  # fmt: skip
    return out


def figures(size: int, cubes: int, n_stars: int, storm: float, seed: int = 2) -> dict[str, Any]:
    """Thresholds, false tracks in noise, and, without a storm, completeness."""
    tracker = PieceTracker()
    return {
        "thresholds": tracker.thresholds((size, size), PERIOD, PSF_SIGMA_PX).round(2).tolist(),
        "noise": noise(tracker, size, max(1, cubes // 2), 16, seed if storm else 1, n_stars, storm),
        **({} if storm else completeness(tracker, size, cubes, seed, n_stars=n_stars)),
    }


def main() -> dict[str, Any]:
    """Cubes in noise and among stars."""
    return {"noise": figures(1024, 20, 0, 0.0), "stars": figures(1024, 20, STARS, 0.0)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--cubes", type=int, default=20)
    parser.add_argument("--stars", action="store_true")
    parser.add_argument("--storm", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=2, help="of the cubes with objects or with a storm")
    parser.add_argument(
        "--frames", type=int, choices=FRAMES, help="objects of so many frames alone, and no cubes without objects"
    )
    chosen = parser.parse_args()
    stars = STARS if chosen.stars or chosen.storm else 0
    if chosen.frames:
        made = completeness(PieceTracker(), chosen.size, chosen.cubes, chosen.seed, n_stars=stars, numbers=(chosen.frames,))
    else:
        made = figures(chosen.size, chosen.cubes, stars, chosen.storm, chosen.seed)
    sys.stdout.write("\n".join(f"{key}: {json.dumps(value)}" for key, value in made.items()) + "\n")
