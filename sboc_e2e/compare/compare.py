"""Run each choice of a seam on the same frames and judge them together.

Simulated frames and downlinks are kept under the output folder by the content that decides them, so that a choice on
ground runs neither the simulator nor the on-board half again, and a second comparison starts where the first one ended.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sboc_e2e.compare.pages import completeness_plot, froc_plot, write_pages
from sboc_e2e.compare.paired import PAIR_SNR, Outcomes, difference, froc, mcnemar
from sboc_e2e.compare.questions import answers
from sboc_e2e.compare.splits import splits
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.results import LARGEST_SNR
from sboc_e2e.icd.signals import Detection
from sboc_e2e.registry import SEAMS, Registry
from sboc_e2e.report import pictures
from sboc_e2e.run.decoders import require_decoder
from sboc_e2e.run.ground_stage import require_files
from sboc_e2e.run.pipeline import KEEP_KEY, Run
from sboc_e2e.run.progress import Progress, Silent
from sboc_e2e.run.shared import SharedRuns
from sboc_e2e.scenario import Scenario, load
from sboc_e2e.score.astrometry import streak_astrometry
from sboc_e2e.score.detection import IMPOSTOR, LEAST_DETECTABLE_SNR
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.figures import absent, bootstrap, exact, half_point, proportion, pull_width, rate, rms
from sboc_e2e.score.ideal import ideal_snr50
from sboc_e2e.score.matching import SNR_IGNORED

MAX_GALLERY: Final = 24  # Cut-outs of a page, 96 px PNGs of some 10 kB each. Chosen: more make the page heavier, not clearer.
MAX_FALSE: Final = 8
"""False alarms shown of each choice."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """What to compare: choices of one seam, on one scenario, with one or more seeds."""

    scenario: str
    seam: str
    choices: tuple[str, ...]
    seeds: int = 1
    overrides: tuple[str, ...] = ()
    workers: int = 0


def _scenario(request: Request, registry: Registry, choice: str | None, seed: int | None) -> Scenario:
    """The scenario with a choice for the seam, keeping all frames."""
    use = {request.seam: choice} if choice else None
    return load(request.scenario, registry=registry, overrides=(*request.overrides, f"{KEEP_KEY}=1"), use=use, seed=seed)


def compare(
    request: Request, out: Path, registry: Registry | None = None, progress: Progress | None = None, *, force: bool = False
) -> dict[str, Any]:
    """Compare and write compare.json, compare.md and compare.html into `out`; returns what compare.json holds.

    force : run everything again, whatever earlier comparisons left in `out`.
    Raises UserError for an unknown seam or step, or fewer than two choices, before anything is simulated or written.
    """
    if request.seam not in SEAMS:
        raise UserError(f'--seam: there is no seam "{request.seam}"; allowed are {", ".join(SEAMS)}')
    if len(request.choices) < 2 or len(set(request.choices)) < len(request.choices):
        raise UserError("--use: give two or more choices to compare, each of them once")
    if request.seeds < 1:
        raise UserError(f"--seeds: expected 1 or more, got {request.seeds}")
    registry = registry or Registry()
    base_seed = _scenario(request, registry, None, None).seed
    # All of them before the first runs: a misspelt choice costs no simulation.
    scenarios = {
        (k, name): _scenario(request, registry, name, base_seed + k) for k in range(request.seeds) for name in request.choices
    }
    for scenario in scenarios.values():
        require_files(scenario)
        require_decoder(scenario)
    shared = SharedRuns(out=out, workers=request.workers, progress=progress or Silent())
    if force:
        shared.clear()
    runs: dict[str, list[tuple[Run, Evaluation]]] = {name: [] for name in request.choices}
    for k in range(request.seeds):
        for name in request.choices:
            made = shared.ground(scenarios[k, name])
            found = made.evaluation()
            made.score(found=found)
            made.report()
            runs[name].append((made, found))
    onboard = request.seam.startswith("onboard.")
    outcomes = _outcomes({name: [e for _, e in pairs] for name, pairs in runs.items()}, onboard)
    first = next(iter(runs.values()))
    n_frames = sum(e.n_frames for _, e in first)
    judged = outcomes.select(outcomes.snr >= PAIR_SNR)
    names = list(request.choices)
    curves = {name: _froc([e for _, e in pairs], onboard) for name, pairs in runs.items()}
    result = {
        "scenario": request.scenario,
        "seam": request.seam,
        "seeds": request.seeds,
        "n_frames": n_frames,
        "n_truth": len(outcomes.snr),
        "judged_on": "ROIs on board" if onboard else "measured streaks after vetting",
        "choices": {name: _choice(pairs, outcomes, name, onboard) for name, pairs in runs.items()},
        "pairs": [
            {
                "first": a,
                "second": b,
                "difference": difference(judged, a, b),
                "mcnemar": mcnemar(judged.found[a], judged.found[b], judged.cluster),
            }
            for i, a in enumerate(names)
            for b in names[i + 1 :]
        ],
        "questions": answers(request.seam, {name: [_score(made) for made, _ in pairs] for name, pairs in runs.items()}),
        "splits": splits(outcomes, names),
        "runs": {name: [made.directory.path.relative_to(out).as_posix() for made, _ in pairs] for name, pairs in runs.items()},
        "froc": curves,
    }
    write_pages(
        result,
        _curves([e for _, e in first], outcomes, curves),
        _gallery(runs, onboard),
        {} if onboard else _false_alarms(runs),
        out,
    )
    return result


def _curves(evaluations: Sequence[Evaluation], outcomes: Outcomes, free_response: dict[str, list[list[float]]]) -> dict[str, str]:
    """Titled SVGs; none of a blank sky, of which no share can be found. evaluations : of one choice, by seed."""
    if not len(outcomes.snr):
        return {}
    sigma_px = np.concatenate([np.asarray(e.truth_tables["streaks"]["psf_sigma_px"], float) for e in evaluations])
    ideal = ideal_snr50(0.1, *evaluations[0].shape, float(np.median(sigma_px)))
    return {
        "Completeness": completeness_plot(outcomes.snr, outcomes.found, ideal),
        "Free-response curve": froc_plot(free_response),
    }


def _score(made: Run) -> dict[str, Any]:
    """The score of a choice's run."""
    return dict(json.loads(made.directory.score.read_text(encoding="utf-8")))


def _detected(e: Evaluation, onboard: bool) -> set[int]:
    return e.detected_onboard if onboard else e.detected_ground


def _outcomes(evaluations: dict[str, list[Evaluation]], onboard: bool) -> Outcomes:
    first = next(iter(evaluations.values()))
    kept = [[t for t in e.truth if t.snr >= SNR_IGNORED] for e in first]
    found = {
        name: np.array([t.index in _detected(e, onboard) for e, truth in zip(es, kept, strict=True) for t in truth], dtype=bool)
        for name, es in evaluations.items()
    }
    truth = [t for each in kept for t in each]
    cluster = [1_000_000 * seed + t.object_id for seed, each in enumerate(kept) for t in each]
    return Outcomes(
        snr=np.array([t.snr for t in truth]),
        length_px=np.array([t.length_px for t in truth]),
        cluster=np.array(cluster, dtype=np.int64),
        found=found,
    )


def _rank(detection: Detection) -> float:
    """Detections fall behind all others, in the order of their S/N, once flagged as no debris: so they are sent."""
    return detection.snr - (LARGEST_SNR if detection.flags & IMPOSTOR else 0.0)


def _froc(evaluations: Sequence[Evaluation], onboard: bool) -> list[list[float]]:
    """Curve over the rank of ROI groups for the on-board half, over the measured S/N of streaks for ground."""
    hits: list[float] = []
    false: list[float] = []
    n_truth = n_frames = 0
    for e in evaluations:
        n_truth += sum(t.snr >= SNR_IGNORED for t in e.truth)
        n_frames += e.n_frames
        if onboard:
            rank = {(f.header.frame, g.roi_id): _rank(g.detection) for f in e.downlink_frames for g in f.rois}
            bad = set(e.footprints.false_groups)
            false += [r for key, r in rank.items() if key in bad]
            by_frame: dict[int, list[float]] = {}
            for (frame, roi), r in rank.items():
                if (frame, roi) not in bad:
                    by_frame.setdefault(frame, []).append(r)
            # The ROI that holds a truth streak is not stored with it. The most significant true ROI of the frame is used instead.
            for t in e.truth:
                if t.index in e.detected_onboard and t.snr >= SNR_IGNORED and by_frame.get(t.frame):
                    near = np.array(by_frame[t.frame])
                    hits.append(float(near[np.argmin(np.abs(near - t.snr))]))
        else:
            accepted = set(e.accepted)
            hits += [float(e.streaks["snr"][row]) for row, t in e.pairs.items() if row in accepted and t.snr >= SNR_IGNORED]
            false += [float(e.streaks["snr"][row]) for row in e.false_rows]
    return froc(np.array(hits), np.array(false), n_truth, n_frames)


def _choice(pairs: Sequence[tuple[Run, Evaluation]], outcomes: Outcomes, name: str, onboard: bool) -> dict[str, Any]:
    evaluations = [e for _, e in pairs]
    found = outcomes.found[name]
    bright = outcomes.snr >= LEAST_DETECTABLE_SNR
    frames = sum(e.n_frames for e in evaluations)
    false = sum(len(e.footprints.false_groups) if onboard else len(e.false_rows) for e in evaluations)
    unflagged = sum(e.footprints.n_false_unflagged for e in evaluations)
    stage = "onboard" if onboard else "ground"
    costs = [run.manifest.stages[stage] for run, _ in pairs]
    cross = [ratio for e in evaluations for ratio in _cross_ratios(e)]
    return {
        "completeness_snr8": proportion(int(found[bright].sum()), int(bright.sum()), "no truth streak with S/N >= 8"),
        "snr50": half_point(outcomes.snr, found),
        "false_per_frame": rate(false, frames, frames),
        "false_unflagged_per_frame": rate(unflagged, frames, frames) if onboard else absent("ground has left flagged ones out"),
        "cross_crlb_ratio": bootstrap(cross, rms),
        "cross_crlb_robust": bootstrap(cross, pull_width),
        "median_cpu_ms_per_frame": _median_cpu_ms(costs),
        "cpu_ms_per_frame": 1000.0 * sum(cost["cpu_s"] for cost in costs) / max(frames, 1),
        "notes": sorted({note for e in evaluations for note in e.notes}),
        "downlink_bits_per_frame": 8.0 * sum(len(e.downlink) for e in evaluations) / max(frames, 1),
    }


def _median_cpu_ms(costs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Median over runs of the CPU time of their median frame."""
    timed = [cost for cost in costs if "median_frame_cpu_s" in cost]
    if not timed:
        return absent("frames were not timed one by one")
    return exact(1000.0 * float(np.median([cost["median_frame_cpu_s"] for cost in timed])), sum(c["timed_frames"] for c in timed))


def _cross_ratios(e: Evaluation) -> list[float]:
    """Errors across over their bounds of the streaks that the score's own figure counts."""
    _, residuals = streak_astrometry(e.streaks, e.measured, e.bounds, {})
    return [r["cross_ratio"] for r in residuals if not r["snr"] < LEAST_DETECTABLE_SNR and math.isfinite(r["cross_ratio"])]


def _gallery(runs: dict[str, list[tuple[Run, Evaluation]]], onboard: bool) -> list[dict[str, Any]]:
    """Cut-outs of truth streaks that some choices found and others lost, most significant first."""
    items = []
    names = list(runs)
    for seed in range(len(runs[names[0]])):
        made, e = runs[names[0]][seed]
        detected = {name: _detected(runs[name][seed][1], onboard) for name in names}
        for t in e.truth:
            found = [name for name in names if t.index in detected[name]]
            if t.snr >= PAIR_SNR and 0 < len(found) < len(names):
                lost = [name for name in names if name not in found]
                items.append((t, made, found, lost))
    items.sort(key=lambda item: -item[0].snr)
    out = []
    for t, made, found, lost in items[:MAX_GALLERY]:
        image = pictures.read_pixels(made.directory.frame_file(t.frame))
        picture, _, _ = pictures.cutout(image, float(t.ends[:, 0].mean()), float(t.ends[:, 1].mean()))
        out.append(
            {"picture": picture, "snr": t.snr, "length_px": t.length_px, "frame": t.frame,
             "found": ", ".join(found), "lost": ", ".join(lost)}
        )  # fmt: skip
    return out


def _false_alarms(runs: dict[str, list[tuple[Run, Evaluation]]]) -> dict[str, list[dict[str, Any]]]:
    """Cut-outs of what each choice published without a truth streak, most significant first."""
    out: dict[str, list[dict[str, Any]]] = {}
    for name, pairs in runs.items():
        found = [(float(e.streaks["snr"][row]), row, made, e) for made, e in pairs for row in e.false_rows]
        found.sort(key=lambda item: -item[0])
        out[name] = []
        for snr, row, made, e in found[:MAX_FALSE]:
            s = e.streaks[row]
            image = pictures.read_pixels(made.directory.frame_file(int(s["frame"])))
            picture, _, _ = pictures.cutout(image, float(s["row_mid"]), float(s["col_mid"]))
            out[name].append({"picture": picture, "snr": snr, "length_px": float(s["length_px"]), "frame": int(s["frame"])})
    return out
