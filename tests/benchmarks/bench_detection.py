"""Detection benchmark: snr50 by length, false detections per frame, what mimics trails, honesty of the statistic, CPU-seconds.

Frames are rendered by `detection_frames`, independently of the simulator. Run from the repository's root:

    python -m tests.benchmarks.bench_detection            # 4096 x 4096, minutes
    python -m tests.benchmarks.bench_detection --quick    # 2048 x 2048, about a minute
"""

import json
import math
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import beta, chi2

from onboard.detect import (
    BoundaryTensorDetector,
    DifferenceDetector,
    HoughDetector,
    LineIntegralDetector,
    LsdDetector,
    SegmentationDetector,
    ThresholdDetector,
)
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.icd.steps import Detector
from sboc_e2e.score.figures import half_point
from tests.benchmarks.detection_frames import (
    Artefact,
    StarTruth,
    Streak,
    add_artefacts,
    add_streak,
    exposure,
    random_artefacts,
    random_stars,
    random_streak,
    view_of,
)
from tests.benchmarks.detector_warm_up import warm_up

LENGTHS_PX = (4.0, 8.0, 15.0, 20.0, 40.0, 100.0, 300.0, 1000.0, 2500.0, 4000.0, 5700.0)
STARS = 25_000
"""Stars above S/N 8 per 4096 x 4096 px; about 37,000 above 5 and 71,000 above 2.5 come with them."""


def matches(found: Detection, truth: Streak) -> bool:
    """The rule of the score: midpoint across, angle, overlap by half of the longer one; below 10 px by centroid."""
    length = truth.length_px
    u_row, u_col = (truth.row1 - truth.row0) / max(length, 1e-9), (truth.col1 - truth.col0) / max(length, 1e-9)
    d_row = 0.5 * (found.row0 + found.row1 - truth.row0 - truth.row1)
    d_col = 0.5 * (found.col0 + found.col1 - truth.col0 - truth.col1)
    along, across = d_row * u_row + d_col * u_col, d_row * u_col - d_col * u_row
    if length < 10.0:
        return math.hypot(along, across) <= 3.0 + 0.25 * length
    angle = math.atan2(found.row1 - found.row0, found.col1 - found.col0) - math.atan2(u_row, u_col)
    angle = abs((angle + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    overlap = min(0.5 * length, along + 0.5 * found.length_px) - max(-0.5 * length, along - 0.5 * found.length_px)
    limit = max(3.0, min(10.0, 3.0 * math.sqrt(2.0) * 0.85 / truth.snr + 6.0 * abs(along) / length))
    return (
        abs(across) <= limit
        and angle <= max(math.radians(3.0), math.atan(6.0 / length))
        and overlap >= 0.5 * max(length, found.length_px)
    )


def overlaps(found: Detection, truth: Streak) -> bool:
    """Whether a detection lies on the truth at all: such a one is a fragment, not a false alarm."""
    length = max(truth.length_px, 1e-9)
    u_row, u_col = (truth.row1 - truth.row0) / length, (truth.col1 - truth.col0) / length
    ends = ((found.row0, found.col0), (found.row1, found.col1))
    along = [(row - truth.row0) * u_row + (col - truth.col0) * u_col for row, col in ends]
    across = [abs((row - truth.row0) * u_col - (col - truth.col0) * u_row) for row, col in ends]
    return min(across) < 10.0 and max(along) > -5.0 and min(along) < truth.length_px + 5.0


def score(found: Sequence[Detection], truth: Sequence[Streak]) -> tuple[list[Detection | None], int, int]:
    """For each truth the detection that matches it (or None); numbers of fragments and of false detections left over."""
    left = [d for d in found if not d.flags & StreakFlag.COSMIC_LIKE]
    paired: list[Detection | None] = []
    for streak in truth:
        hit = next((d for d in left if matches(d, streak)), None)
        paired.append(hit)
        if hit is not None:
            left.remove(hit)
    fragments = sum(any(overlaps(d, streak) for streak in truth) for d in left)
    return paired, fragments, len(left) - fragments


def history_of(size: int, stars: StarTruth, rng: np.random.Generator) -> DetectorView:
    """The preceding frame: the same stars, other noise, the pointing a fraction of a pixel away."""
    shift = rng.normal(0.0, 0.4, 2)
    return view_of(exposure(size, stars, rng, shift_px=(float(shift[0]), float(shift[1]))))


def blank_frames(detector: Detector, size: int, n: int, seed: int, n_stars: int = STARS) -> dict[str, Any]:
    """False detections per frame of noise and stars, with the 95 % upper limit, and the CPU time of detect()."""
    false, cpu = 0, []
    for k in range(n):
        rng = np.random.default_rng((seed, k))
        stars = random_stars(size, n_stars, rng)
        view = view_of(exposure(size, stars, rng), frame=1, history=(history_of(size, stars, rng),))
        start = time.process_time()
        found = detector.detect(view)
        cpu.append(time.process_time() - start)
        false += sum(not d.flags & StreakFlag.COSMIC_LIKE for d in found)
    # 95 % upper limit of a Poisson mean, Wilson-Hilferty approximation of the chi-square quantile
    upper = (false + 1) * (1.0 - 1.0 / (9 * (false + 1)) + 1.645 / (3.0 * math.sqrt(false + 1))) ** 3
    return {
        "false_per_frame": round(false / n, 3),
        "upper95": round(upper / n, 3),
        "n": n,
        "cpu_s_median": round(float(np.median(cpu)), 3),
    }


def roc(
    detector: Detector,
    size: int,
    n_frames: int,
    seed: int,
    *,
    lengths: Sequence[float] = LENGTHS_PX,
    snr_range: tuple[float, float] = (5.0, 11.0),
    each: int = 4,
    n_stars: int = STARS,
) -> dict[str, Any]:
    """snr50 by length, false and fragment counts, mean S/N against truth, over frames that hold `each` streaks of each length."""
    usable = [length for length in lengths if length < 1.41 * size]
    snr: dict[float, list[float]] = {length: [] for length in usable}
    hit: dict[float, list[bool]] = {length: [] for length in usable}
    ratio: dict[float, list[float]] = {length: [] for length in usable}
    false, fragments = 0, 0
    for k in range(n_frames):
        rng = np.random.default_rng((seed, k))
        stars = random_stars(size, n_stars, rng)
        earlier = history_of(size, stars, rng)
        scene = exposure(size, stars, rng)
        # corner-to-corner streaks share two lines: one a frame, or they cover each other
        drawn = [length for length in usable for _ in range(1 if length > 1.3 * size else each)]
        for length in drawn:
            add_streak(scene, random_streak(size, length, float(rng.uniform(*snr_range)), rng), rng)
        found = detector.detect(view_of(scene, frame=1, history=(earlier,)))
        paired, n_fragments, n_false = score(found, scene.streaks)
        false, fragments = false + n_false, fragments + n_fragments
        for length, streak, detection in zip(drawn, scene.streaks, paired, strict=True):
            snr[length].append(streak.snr)
            hit[length].append(detection is not None)
            if detection is not None and streak.snr > 9.0:
                ratio[length].append(detection.snr / streak.snr)
    near_10 = {length: [h for s, h in zip(snr[length], hit[length], strict=True) if s >= 9.5] for length in usable}
    return {
        "snr50_by_length": {f"{length:g}": half_point(snr[length], hit[length]) for length in usable},
        "completeness_snr_9.5_to_max": {f"{x:g}": [round(float(np.mean(v)), 3), len(v)] for x, v in near_10.items() if v},
        "snr_ratio": {f"{x:g}": [round(float(np.mean(v)), 3), len(v)] for x, v in ratio.items() if v},
        "false_per_frame": round(false / n_frames, 3),
        "fragments_per_frame": round(fragments / n_frames, 3),
        "n_frames": n_frames,
    }


def trail_beside(artefact: Artefact, size: int, rng: np.random.Generator) -> Streak:
    """A trail of 100 to 300 px at S/N 12 that passes an artefact at 10 to 60 px."""
    while True:
        angle, length = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(100.0, 300.0))
        apart, along = float(rng.uniform(10.0, 60.0)), float(rng.uniform(-0.4, 0.4)) * length
        row = artefact.row + apart * math.cos(angle) + along * math.sin(angle)
        col = artefact.col - apart * math.sin(angle) + along * math.cos(angle)
        half = (0.5 * length * math.sin(angle), 0.5 * length * math.cos(angle))
        ends = (row - half[0], col - half[1], row + half[0], col + half[1])
        if min(ends) > 5.0 and max(ends) < size - 6.0:
            return Streak(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=12.0)


def kind_of(found: Detection, artefacts: Sequence[Artefact]) -> str:
    """The kind of the artefact that a false detection's nearer end lies closest to, in units of its reach; else "sky"."""
    best, kind = 1.0, "sky"
    for artefact in artefacts:
        ends = ((found.row0, found.col0), (found.row1, found.col1))
        apart = min(math.hypot(row - artefact.row, col - artefact.col) for row, col in ends) / artefact.reach_px
        if apart < best:
            best, kind = apart, artefact.kind
    return kind


def rate(count: int, n: int) -> dict[str, Any]:
    """A rate per frame with its 90 % interval (Garwood)."""
    low = float(chi2.ppf(0.05, 2 * count)) / 2.0 if count else 0.0
    return {
        "value": round(count / n, 3),
        "low": round(low / n, 3),
        "high": round(float(chi2.ppf(0.95, 2 * count + 2)) / 2.0 / n, 3),
        "n": n,
    }


def share(count: int, n: int) -> dict[str, Any]:
    """A share with its 90 % interval (Clopper-Pearson)."""
    low = float(beta.ppf(0.05, count, n - count + 1)) if count else 0.0
    high = float(beta.ppf(0.95, count + 1, n - count)) if count < n else 1.0
    return {"value": round(count / n, 3), "low": round(low, 3), "high": round(high, 3), "n": n}


def artefacts(detector: Detector, size: int, n_frames: int, seed: int) -> dict[str, Any]:
    """False detections at spikes, bleeding columns, halos, pairs and chains of stars, and what is found of trails beside them.

    Frames hold the numbers of `random_artefacts`. Each is looked at with its predecessor and alone (the first of a run);
    detections flagged SPIKE_LIKE, which ground vets by it, are counted apart. Trails are added in a second pass: one
    beside each bright star, half as many anywhere.
    """
    kinds = ("spikes", "column", "halo", "pair", "chain", "sky")
    false = {way: dict.fromkeys(kinds, 0) for way in ("with_history", "alone")}
    flagged = dict.fromkeys(false, 0)
    bright = kinds[:3]
    hits, drawn = dict.fromkeys((*bright, "elsewhere"), 0), dict.fromkeys((*bright, "elsewhere"), 0)
    for k in range(n_frames):
        rng = np.random.default_rng((seed, k))
        stars = random_stars(size, STARS, rng)
        things, more = random_artefacts(size, rng)
        every = StarTruth(
            row=np.concatenate([stars.row, more.row]),
            col=np.concatenate([stars.col, more.col]),
            snr=np.concatenate([stars.snr, more.snr]),
        )
        shift = tuple(float(x) for x in rng.normal(0.0, 0.4, 2))
        before = exposure(size, every, rng, shift_px=shift)
        add_artefacts(before, things, rng, shift_px=shift)
        scene = exposure(size, every, rng)
        add_artefacts(scene, things, rng)
        history = (view_of(before),)
        for way, past in (("with_history", history), ("alone", ())):
            for d in detector.detect(view_of(scene, frame=1, history=past)):
                if d.flags & StreakFlag.SPIKE_LIKE:
                    flagged[way] += 1
                elif not d.flags & StreakFlag.COSMIC_LIKE:
                    false[way][kind_of(d, things)] += 1
        near = [thing for thing in things if thing.kind in bright]
        trails = [(thing.kind, trail_beside(thing, size, rng)) for thing in near]
        trails += [("elsewhere", random_streak(size, float(rng.uniform(100.0, 300.0)), 12.0, rng)) for _ in near[::2]]
        for _, trail in trails:
            add_streak(scene, trail, rng)
        paired, _, _ = score(detector.detect(view_of(scene, frame=1, history=history)), scene.streaks)
        for (kind, _), hit in zip(trails, paired, strict=True):
            drawn[kind] += 1
            hits[kind] += hit is not None
    return {
        **{way: {f"false_{kind}": rate(counts[kind], n_frames) for kind in kinds} for way, counts in false.items()},
        "spike_like": {way: rate(flagged[way], n_frames) for way in flagged},
        "completeness_beside": {kind: share(hits[kind], drawn[kind]) for kind in hits},
        "n_frames": n_frames,
    }


def shapes(detector: Detector, size: int, n_frames: int, seed: int) -> dict[str, Any]:
    """Completeness at S/N 12 of curved, varying, edge-cut, parallel and crossing streaks, and their S/N against straight ones."""
    rows: dict[str, list[tuple[bool, float]]] = {
        name: [] for name in ("straight", "curved", "varying", "edge", "parallel", "crossing")
    }
    for k in range(n_frames):
        rng = np.random.default_rng((seed, k))
        stars = random_stars(size, STARS, rng)
        earlier = history_of(size, stars, rng)
        scene = exposure(size, stars, rng)
        names: list[str] = []

        def draw(name: str, streak: Streak, scene: Any = scene, rng: np.random.Generator = rng, names: list[str] = names) -> None:
            add_streak(scene, streak, rng)
            names.append(name)

        for _ in range(3):
            draw("straight", random_streak(size, 400.0, 12.0, rng))
            base = random_streak(size, 400.0, 12.0, rng)
            draw("curved", Streak(**{**base.__dict__, "sagitta_px": 3.0 * float(rng.choice([-1.0, 1.0]))}))
            base = random_streak(size, 400.0, 12.0, rng)
            draw("varying", Streak(**{**base.__dict__, "brightness_change": 0.4}))
            col, angle = float(rng.uniform(0.2, 0.8) * size), float(rng.uniform(0.4, 2.7))
            draw(
                "edge",
                Streak(row0=-80.0, col0=col, row1=-80.0 + 300 * math.sin(angle), col1=col + 300 * math.cos(angle), snr=12.0),
            )
            base = random_streak(size, 300.0, 12.0, rng)
            u = ((base.row1 - base.row0) / 300.0, (base.col1 - base.col0) / 300.0)
            draw("parallel", base)
            other = (8.0 * u[1], -8.0 * u[0])
            draw(
                "parallel",
                Streak(
                    row0=base.row0 + other[0],
                    col0=base.col0 + other[1],
                    row1=base.row1 + other[0],
                    col1=base.col1 + other[1],
                    snr=12.0,
                ),
            )
            base = random_streak(size, 300.0, 12.0, rng)
            middle, half = (0.5 * (base.row0 + base.row1), 0.5 * (base.col0 + base.col1)), 120.0
            turn = math.atan2(base.row1 - base.row0, base.col1 - base.col0) + math.radians(50.0)
            draw("crossing", base)
            draw(
                "crossing",
                Streak(
                    row0=middle[0] - half * math.sin(turn),
                    col0=middle[1] - half * math.cos(turn),
                    row1=middle[0] + half * math.sin(turn),
                    col1=middle[1] + half * math.cos(turn),
                    snr=12.0,
                ),
            )
        paired, _, _ = score(detector.detect(view_of(scene, frame=1, history=(earlier,))), [clip(s, size) for s in scene.streaks])
        for name, detection in zip(names, paired, strict=True):
            rows[name].append((detection is not None, detection.snr / 12.0 if detection is not None else math.nan))
    return {
        name: {
            "completeness": round(float(np.mean([r[0] for r in found])), 3),
            "n": len(found),
            "snr_ratio": round(float(np.nanmean([r[1] for r in found])), 3) if any(r[0] for r in found) else None,
        }
        for name, found in rows.items()
    }


def clip(streak: Streak, size: int) -> Streak:
    """The part of a streak inside the frame."""
    u0, u1 = 0.0, 1.0
    for start, stop in ((streak.row0, streak.row1), (streak.col0, streak.col1)):
        for limit, sign in ((-0.5, 1.0), (size - 0.5, -1.0)):
            a, b = sign * (start - limit), sign * (stop - limit)
            if a < 0.0 < b:
                u0 = max(u0, a / (a - b))
            elif b < 0.0 < a:
                u1 = min(u1, a / (a - b))
    d_row, d_col = streak.row1 - streak.row0, streak.col1 - streak.col0
    return Streak(
        row0=streak.row0 + u0 * d_row,
        col0=streak.col0 + u0 * d_col,
        row1=streak.row0 + u1 * d_row,
        col1=streak.col0 + u1 * d_col,
        snr=streak.snr,
    )


PEERS = (
    DifferenceDetector(), BoundaryTensorDetector(), ThresholdDetector(), LsdDetector(), HoughDetector(), SegmentationDetector()
)  # fmt: skip


def peers(size: int, n_frames: int, seed: int) -> dict[str, Any]:
    """The published detectors on the same frames: snr50 by length (wide S/N range), false per frame, CPU time."""
    out: dict[str, Any] = {}
    for detector in PEERS:
        result = roc(detector, size, n_frames, seed, lengths=(20.0, 100.0, 400.0, 1200.0), snr_range=(5.0, 100.0), each=10)
        blank = blank_frames(detector, size, 2, seed)
        out[type(detector).__name__] = {**result, "blank": blank}
    return out


def main(quick: bool) -> dict[str, Any]:
    """All figures of this benchmark, JSON-able."""
    warm_up()
    detector = LineIntegralDetector()
    size, n = (2048, 4) if quick else (4096, 8)
    result: dict[str, Any] = {"size_px": size, "stars_above_snr8": int(STARS * (size / 4096) ** 2)}
    result["blank"] = blank_frames(detector, size, n, seed=11)
    result["noise_only"] = blank_frames(detector, size, n, seed=12, n_stars=0)
    result["roc"] = roc(detector, size, n, seed=13, each=3 if quick else 4)
    result["shapes"] = shapes(detector, size, max(1, n // 4), seed=14)
    result["artefacts"] = artefacts(detector, 2048, 1 if quick else 48, seed=46)
    if not quick:
        result["peers"] = peers(2048, 3, seed=15)
    return result


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main("--quick" in sys.argv), indent=1) + "\n")
