"""One run of the pixel chain as samples of the response: what became of each trail and of each object that it showed."""

import math
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ground.orbit.size import diameter_m, sun_direction
from ground.population.flux import ALBEDO
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.scenario import OutputOptions, Scenario
from sboc_e2e.score.astrometry import sky_paths, streak_astrometry
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.linking import linking
from sboc_e2e.score.photometry import mean_magnitudes
from sboc_e2e.survey.rows import LEAST_SNR


def sample_run(scenario: Scenario, folder: Path | None = None) -> dict[str, Any]:
    """Run a scenario and return its samples, JSON-able; the run's files are gone afterwards."""
    kept = replace(scenario, output=OutputOptions(keep_frames_every=0))
    with tempfile.TemporaryDirectory(prefix="sboc-response-", dir=folder, ignore_cleanup_errors=True) as made:
        run = begin_or_continue(Path(made) / "run", kept, workers=1)
        run.simulate_and_onboard()
        run.ground()
        return samples(run.evaluation())


def samples(e: Evaluation) -> dict[str, Any]:
    """Rows of trails (`STREAK_COLUMNS`) and objects (`OBJECT_COLUMNS`), and counts of what is false or lost."""
    streaks = e.truth_tables["streaks"]
    noise = {int(f["frame"]): float(f["noise_e"]) for f in e.truth_tables["frames"]}
    mags = mean_magnitudes(streaks, e.truth)
    accepted = set(e.accepted)
    row_of = {truth.index: row for row, truth in e.pairs.items() if row in accepted}
    sky = sky_paths(streaks, [t.index for t in e.truth])
    _, residuals = streak_astrometry(e.streaks, {row: t for row, t in e.pairs.items() if row in accepted}, e.bounds, sky)
    residual_of = {int(r["row"]): r for r in residuals}
    onboard = e.detected_onboard
    rows: list[list[Any]] = []
    for t in e.truth:
        if not t.snr >= LEAST_SNR:
            continue
        row = row_of.get(t.index)
        r = {} if row is None else residual_of.get(row, {})
        error = math.nan if row is None else float(e.streaks["mag"][row]) - mags[t.index]
        sigma = math.nan if row is None else float(e.streaks["mag_err"][row])
        rows.append(
            [t.object_id, t.frame, t.snr, t.length_px, noise[t.frame], int(t.path.edge0) + int(t.path.edge1),
             t.index in onboard, row is not None, mags[t.index], error, error / sigma if sigma > 0.0 else math.nan,
             *(r.get(name, math.nan) for name in
               ("cross_px", "cross_pull", "sky_cross_arcsec", "sky_along_arcsec", "along_pull"))]
        )  # fmt: skip
    objects = _objects(e, rows)
    linked = [int(t) for t in e.tracklets["tracklet_id"]] if len(e.tracklets) else []
    _, owner = linking(e.streaks, e.pairs, e.n_frames)
    duplicates = len([t for t in linked if owner.get(t, -1) >= 0]) - len({owner[t] for t in linked if owner.get(t, -1) >= 0})
    return {
        "streaks": [[_plain(v) for v in row] for row in rows],
        "objects": [[_plain(v) for v in row] for row in objects],
        "frames": e.n_frames,
        "frame_rate_hz": float(e.manifest["frame_rate_hz"]),
        "sky_e": float(np.mean(e.truth_tables["frames"]["sky_e_px"])),
        "noise_e": float(np.mean(list(noise.values()))),
        "false_streaks": len(e.false_rows),
        "false_tracklets": sum(owner.get(t, -1) < 0 for t in linked),
        "duplicate_tracklets": duplicates,
        "packets_lost": len(e.notes),
        "downlink_bytes": len(e.downlink),
    }


def _objects(e: Evaluation, rows: list[list[Any]]) -> list[list[Any]]:
    """One row for each sampled object that left a trail."""
    _, owner = linking(e.streaks, e.pairs, e.n_frames)
    mine: dict[int, list[list[Any]]] = defaultdict(list)
    for row in rows:
        mine[int(row[0])].append(row)
    tracklets: dict[int, Any] = {}
    for t in e.tracklets:
        o = owner.get(int(t["tracklet_id"]), -1)
        if o >= 0 and (o not in tracklets or int(t["n_frames"]) > int(tracklets[o]["n_frames"])):
            tracklets[o] = t
    orbits = {int(o["tracklet_id"]): o for o in e.orbits}
    truth = e.truth_tables["streaks"]
    ids = np.asarray(truth["object_id"], int)
    out = []
    for o in e.truth_tables["objects"]:
        key = int(o["object_id"])
        if str(o["kind"]) != "population" or key not in mine:
            continue
        trails = mine[key]
        brightest = int(np.flatnonzero(ids == key)[np.argmax(np.asarray(truth["snr"], float)[ids == key])])
        snr = np.array([t[2] for t in trails])
        found = int(sum(bool(t[7]) for t in trails))
        light = float(np.mean([10.0 ** (-0.4 * t[8]) for t in trails]))
        rate = float(truth["rate_deg_s"][brightest])
        span = (max(t[1] for t in trails) - min(t[1] for t in trails)) / float(e.manifest["frame_rate_hz"])
        known = tracklets.get(key)
        errors = [math.nan] * 7
        if known is not None:
            errors = _errors(e, known, orbits.get(int(known["tracklet_id"])), o, key, -2.5 * math.log10(light))
        out.append(
            [key, float(o["size_m"]), float(o["albedo"]), float(o["a_km"]), float(o["e"]), float(o["i_deg"]),
             float(o["weight"]), float(truth["range_km"][brightest]), rate, _altitude_km(e, brightest), len(trails),
             float(snr.max()), float(np.sqrt(np.sum(snr**2))), rate * span, -2.5 * math.log10(light), found,
             0 if known is None else int(known["n_frames"]), bool(np.isfinite(errors[2])), *errors,
             _light_size_m(e, brightest, -2.5 * math.log10(light))]
        )  # fmt: skip
    return out


def _errors(e: Evaluation, known: Any, orbit: Any, o: Any, key: int, true_mag: float) -> list[float]:
    """Measured less true for a tracklet: magnitude, ln rate, ln range, ln size, altitude, inclination; the size itself.

    ln size : against `_light_size_m`, so that what the object's own albedo does is not in it.
    """
    truth = e.truth_tables["streaks"]
    ids = np.asarray(truth["object_id"], int)
    at = np.flatnonzero(ids == key)
    when = np.asarray(truth["path_t_tai_ns"], np.int64)[at, 0]
    nearest = int(at[np.argmin(np.abs(when - int(known["t_ref_tai_ns"])))])
    rate = float(truth["rate_deg_s"][nearest])
    out = [float(known["mag"]) - true_mag, math.log(max(float(known["rate_deg_s"]), 1e-9) / rate)]
    if orbit is None or not np.isfinite([float(orbit[c]) for c in ("range_km", "size_m", "i_deg", "altitude_km")]).all():
        return [*out, *[math.nan] * 5]
    size = float(orbit["size_m"])
    return [
        *out,
        math.log(float(orbit["range_km"]) / float(truth["range_km"][nearest])),
        math.log(size / _light_size_m(e, nearest, true_mag)),
        float(orbit["altitude_km"]) - _altitude_km(e, nearest),
        float(orbit["i_deg"]) - float(o["i_deg"]),
        size,
    ]


def _light_size_m(e: Evaluation, row: int, true_mag: float) -> float:
    """Diameter that an object's true light gives with ground's albedo and phase, at its range and direction in a trail."""
    truth = e.truth_tables["streaks"]
    direction = _unit(float(truth["ra_app_deg"][row]), float(truth["dec_app_deg"][row]))
    when = int(np.asarray(truth["path_t_tai_ns"][row], np.int64)[0])
    phase = math.acos(float(np.clip(-direction @ sun_direction(when), -1.0, 1.0)))
    return float(diameter_m(true_mag, float(truth["range_km"][row]), ALBEDO, phase))


def _altitude_km(e: Evaluation, row: int) -> float:
    """Height of an object over a sphere of 6378.137 km at a trail: observer plus range times direction."""
    truth, frames = e.truth_tables["streaks"], e.truth_tables["frames"]
    place = int(np.flatnonzero(np.asarray(frames["frame"], int) == int(truth["frame"][row]))[0])
    observer = np.asarray(frames["position_m"][place], float) * 1e-3
    direction = _unit(float(truth["ra_app_deg"][row]), float(truth["dec_app_deg"][row]))
    return float(np.linalg.norm(observer + float(truth["range_km"][row]) * direction)) - 6378.137


def _unit(ra_deg: float, dec_deg: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    ra, dec = math.radians(ra_deg), math.radians(dec_deg)
    return np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])


def _plain(value: Any) -> Any:
    """As JSON knows it: five digits are more than any of them means."""
    if isinstance(value, bool | np.bool_):
        return int(value)
    if isinstance(value, int | np.integer):
        return int(value)
    number = float(value)
    return float(f"{number:.6g}") if math.isfinite(number) else None
