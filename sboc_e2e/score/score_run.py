"""score.json: every section of docs/scoring.md from one evaluation."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table

from sboc_e2e.score.astrometry import frame_astrometry, sky_paths, streak_astrometry
from sboc_e2e.score.compression import compression
from sboc_e2e.score.detection import MAX_AREA_FRACTION, detection_figures, lost_to_budget
from sboc_e2e.score.evaluation import Evaluation, evaluate
from sboc_e2e.score.figures import absent, bootstrap, exact, rate
from sboc_e2e.score.linking import linking
from sboc_e2e.score.lossless import lossless_check
from sboc_e2e.score.orbit import orbit
from sboc_e2e.score.photometry import mean_magnitudes, photometry
from sboc_e2e.score.population import detections_per_day, not_of_nature, published_flux, with_models
from sboc_e2e.score.published import published_products
from sboc_e2e.score.recovery import counted, field_deg, recovery
from sboc_e2e.score.timing import timing
from sboc_e2e.score.tracking import tracking

SCORE_VERSION = "1.1"


def score_run(run_dir: Path, truth: Path | None = None) -> dict[str, Any]:
    """Score a run directory; truth from elsewhere (see `evaluate`) may stand in for its own.

    Raises UserError when a table is missing or lacks a column.
    """
    return score_evaluation(evaluate(run_dir, truth), run_dir)


def score_evaluation(e: Evaluation, run_dir: Path | None = None) -> dict[str, Any]:
    """All sections of score.json from an evaluation; `run_dir` gives the frames that the lossless check reads."""
    sigma_px = float(np.median(e.truth_tables["streaks"]["psf_sigma_px"])) if e.truth else 0.85
    onboard = detection_figures(e.truth, e.detected_onboard, len(e.footprints.false_groups), e.n_frames, e.shape, sigma_px)
    area = e.footprints.area_fraction
    onboard["false_unflagged_per_frame"] = rate(e.footprints.n_false_unflagged, e.n_frames, e.n_frames)
    onboard["roi_area_fraction"] = bootstrap(area, lambda v: float(v.mean()), "fewer than three frames")
    records = {f.header.frame: f.housekeeping for f in e.downlink_frames if f.housekeeping is not None}
    onboard["lost_to_budget"] = lost_to_budget(e.truth, e.detected_onboard, records)
    ground = detection_figures(e.truth, e.detected_ground, len(e.false_rows), e.n_frames, e.shape, sigma_px)

    wanted = sorted({t.index for t in e.pairs.values()})
    streak_figures, _ = streak_astrometry(e.streaks, e.measured, e.bounds, sky_paths(e.truth_tables["streaks"], wanted))
    frame_figures, _ = frame_astrometry(e.frames, e.truth_tables["frames"])
    truth_mag = mean_magnitudes(e.truth_tables["streaks"], e.truth)
    magnitudes, _ = photometry(e.streaks, e.measured, truth_mag, e.bounds, e.frames, e.truth_tables["frames"])
    links, owner = linking(e.streaks, e.pairs, e.n_frames)

    frame_rate_hz = float(e.manifest.get("frame_rate_hz") or 1.0)
    span_s = e.n_frames / frame_rate_hz
    captured = [e.footprints.captured[i] for i in sorted(e.detected_onboard)]
    lossless_bits, bit_exact = lossless_check(run_dir) if run_dir else (absent("no frames"), absent("no frames"))
    n_stars = sum(len(f.stars) + len(f.remembered) for f in e.downlink_frames)
    groups = {f.header.frame: f.rois for f in e.downlink_frames}
    area_mean = float(np.mean(area)) if area else 0.0
    return {
        "score_version": SCORE_VERSION,
        "notes": list(e.notes),
        "passed": exact(float(area_mean <= MAX_AREA_FRACTION), e.n_frames),
        "detection": {"onboard": onboard, "ground": ground},
        "astrometry": streak_figures | frame_figures,
        "photometry": magnitudes,
        "linking": links,
        "tracking": tracking(e.truth, e.downlink_frames, e.detected_ground, e.n_frames),
        "orbit": orbit(e.orbits, owner, e.truth_tables["streaks"], e.truth_tables["objects"]),
        "products": published_products(
            run_dir / "products" if run_dir else None, e.streaks, e.tracklets, e.truth_tables, owner, truth_mag
        ),
        "population": _population(e, owner, span_s, frame_rate_hz, _true_population(run_dir))
        | {"published": _published(run_dir, not_of_nature(e, owner))},
        "compression": compression(
            e.downlink, e.n_frames, e.shape, n_stars, groups, captured, lossless_bits, bit_exact,
            np.asarray(e.truth_tables["frames"]["entropy_bits"], float),
        ),
        "timing": timing(e.manifest, e.n_frames, frame_rate_hz),
    }  # fmt: skip


def _published(run_dir: Path | None, placed: list[float]) -> dict[str, Any]:
    """The published flux of a run directory against its truth."""
    product = run_dir / "products" / "population.ecsv" if run_dir else None
    found = Table.read(product, format="ascii.ecsv") if product and product.is_file() else None
    return published_flux(found, _true_population(run_dir), placed)


def _true_population(run_dir: Path | None) -> dict[str, Any]:
    """truth/population.json; empty where a run has none."""
    truth = run_dir / "truth" / "population.json" if run_dir else None
    return dict(json.loads(truth.read_text())) if truth and truth.is_file() else {}


def _population(
    e: Evaluation, owner: Mapping[int, int], span_s: float, frame_rate_hz: float, truth: Mapping[str, Any]
) -> dict[str, Any]:
    """Injected, detected and recovered debris, class by class."""
    objects, accepted = e.truth_tables["objects"], set(e.accepted)
    found = Counter(truth.object_id for row, truth in e.pairs.items() if row in accepted)
    direct = detections_per_day(objects, found, span_s, len(e.false_rows), e.n_frames, frame_rate_hz)
    sample = counted(objects, e.streaks, e.orbits, e.pairs, owner, e.n_frames)
    inferred = recovery(sample, span_s, field_deg(e.truth_tables["frames"]))
    classes = with_models([a | b for a, b in zip(direct["size_classes"], inferred["size_classes"], strict=True)], truth)
    return inferred | {"size_classes": classes, "false_per_day": direct["false_per_day"]}
