"""The response of a camera and its software: what was found of trails with known S/N, how well it was measured, what was false.

A file holds counts and residuals as they were measured, so that every figure has its n; the curve that surveys draw from is
fitted to them. Residuals of a tracklet stay together: a survey takes all of a neighbour's (in S/N, frames, arc, range), which
keeps their covariances and tails.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.scenario import Scenario
from sboc_e2e.scenario.toml_files import FOLDER
from sboc_e2e.score.figures import SEED, absent, proportion, rate
from sboc_e2e.survey import instrument
from sboc_e2e.survey.curve import HALF, LN_SPREAD, PARAMETERS, SHORTEST, WHEN_CUT, WITH_NOISE, Trails, fitted, mean_share
from sboc_e2e.survey.rows import OBJECT_COLUMNS, STREAK_COLUMNS, columns

Array = NDArray[np.float64]

VERSION: Final = 3
"""Of the file; another one is refused."""

SNR_EDGES: Final = (3.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 15.0, 20.0, 30.0, 1e9)
"""Of the table of trails: one S/N wide where the found share rises (half at 7.4), wider above."""
LENGTH_EDGES_PX: Final = (0.0, 10.0, 30.0, 100.0, 300.0, 1e9)
"""Of the table of trails: two a decade; what is longer than 300 px is one class."""
FRAME_EDGES: Final = (1, 2, 3, 4, 6, 11, 100000)
"""Cells of the tables: S/N, length, and frames in which a passage was found."""

PULL_POINTS: Final = (0.01, 0.05, 0.16, 0.5, 0.84, 0.95, 0.99)
"""Quantiles: median, one sigma (0.16, 0.84), both ends of the 90 % interval, and the tails."""
NEIGHBOURS: Final = 10  # Tracklets of 688 among which a survey draws: more blur S/N and arc, fewer repeat one another. Chosen.
RESIDUALS: Final = ("mag_error", "ln_rate_error", "ln_range_error", "ln_size_error", "i_error_deg")
PULLS: Final = ("mag_pull", "cross_pull", "along_pull")
BOOTSTRAPS: Final = 40
"""Of the runs, each with a fit of its own: an end of the 90 % interval is known to 0.33 of the standard error. Chosen."""
FEWEST_TRAILS: Final = 200  # Their found share is known to +- 0.06 at one half (Wilson, 90 %). Chosen.
FEWEST_TRACKLETS: Final = 30  # Three times `NEIGHBOURS`, so that neighbours are not always the same. Chosen.
SKY_SPREAD: Final = 1.05
"""Ratio of noises above which the samples tell how the half point goes with the sky."""
SKY_REDRAWS: Final = 4000  # of runs: an end of the 90 % interval is known to 0.03 of the standard error

OWN_SKY: Final = "as in the scenario"
"""Name of the sky of runs that are made below no other."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """A response as read from its file (`content`)."""

    content: Mapping[str, Any]

    @property
    def curve(self) -> Array:
        """Parameters of `curve.found_share`."""
        return np.array(self.content["detection"]["curve"])

    @property
    def curves(self) -> Array:
        """Parameters (b, 9) of bootstrap samples over runs."""
        return np.array(self.content["detection"]["curves"])

    def noise_ratio(self, noise_e: Array) -> Array:
        """Noise over that of the response's own sky, at most as far from it as was measured: a slope is not drawn on beyond."""
        low, high = self.content["detection"]["noise_e"]
        return np.asarray(np.clip(noise_e, low, high) / float(self.content["noise_e"]))

    @property
    def false_per_hour(self) -> float:
        """False tracklets in an hour."""
        return float(self.content["false"]["tracklets_per_hour"]["value"])

    def linked_share(self, frames_found: NDArray[np.int64]) -> Array:
        """Probability of a tracklet by frames in which a passage was found (n,): 0 for one or none."""
        tried, linked = np.array([(r["tried"], r["linked"]) for r in self.content["linking"]], dtype=float).T
        usual = (linked[1:].sum() + 0.5) / (tried[1:].sum() + 1.0)
        share = (linked + usual) / (tried + 1.0)
        cell = np.clip(np.searchsorted(FRAME_EDGES, frames_found, side="right") - 1, 0, len(share) - 1)
        return np.where(frames_found >= 2, share[cell], 0.0)

    def residuals(self, frames: Array, snr: Array, arc_deg: Array, range_km: Array, rng: np.random.Generator) -> dict[str, Array]:
        """Residuals (n,) of tracklets by name, all of one measured neighbour each; NaN where that had no orbit.

        frames, snr, arc_deg : frames linked, root of the summed squares of their S/N, angle between first and last. range_km :
        the true one. Sizes of near objects err by a factor, those of far ones by some per cent.
        """
        bank = columns(self.content["tracklets"], BANK_COLUMNS)
        known = _features(*(bank[name] for name in FEATURES))
        scale = np.std(known, axis=0) + 1e-9
        k = min(NEIGHBOURS, len(known))
        _, near = cKDTree(known / scale).query(_features(frames, snr, arc_deg, range_km) / scale, k=k)
        chosen = near.reshape(len(frames), k)[np.arange(len(frames)), rng.integers(k, size=len(frames))]
        return {name: bank[name][chosen] for name in RESIDUALS}


FEATURES: Final = ("linked", "snr_all", "arc_deg", "range_km")
BANK_COLUMNS: Final = (*FEATURES, *RESIDUALS)
LEAST: Final = (1.0, 1.0, 0.01, 0.01)
"""Frames, S/N, arc (deg) and range (km) below which all count as these in the search of neighbours."""


def _features(*values: Array) -> Array:
    """What neighbours are near in (n, 4): logarithms of `FEATURES`."""
    return np.log(np.stack([np.maximum(v, least) for v, least in zip(values, LEAST, strict=True)], axis=1))


def made_of(
    scenario: Scenario, samples: Sequence[Mapping[str, Any]], code: str, commit: str, seeds: Sequence[int]
) -> dict[str, Any]:
    """The content of a response file. Raises `UserError` for too few samples.

    Trails of a run's first frame are left out: it has no predecessor, and a survey has one first frame in its life.
    """
    runs = [columns(s["streaks"], STREAK_COLUMNS) for s in samples]
    below = [str(s.get("sky", OWN_SKY)) for s in samples]
    for run, sample in zip(runs, samples, strict=True):
        # objects that the scenario placed are no debris: two far ones would hold a third of all trails
        debris = columns(sample["objects"], OBJECT_COLUMNS)["object"]
        kept = (run["frame"] > 0) & np.isin(run["object"], debris)
        run.update({name: values[kept] for name, values in run.items()})
    trails = {name: np.concatenate([run[name] for run in runs]) for name in STREAK_COLUMNS}
    objects = {name: np.concatenate([columns(s["objects"], OBJECT_COLUMNS)[name] for s in samples]) for name in OBJECT_COLUMNS}
    linked = objects["linked"] >= 2
    if len(trails["snr"]) < FEWEST_TRAILS or int(linked.sum()) < FEWEST_TRACKLETS:
        raise UserError(
            f"response of {scenario.name}: {len(trails['snr'])} trails and {int(linked.sum())} tracklets are too few; "
            f"needed are {FEWEST_TRAILS} and {FEWEST_TRACKLETS}: raise --runs"
        )
    own = [run["noise_e"] for run, sky in zip(runs, below, strict=True) if sky == OWN_SKY]
    noise = float(np.median(np.concatenate(own or [trails["noise_e"]])))
    described = instrument.description(scenario)
    hours = sum(s["frames"] / s["frame_rate_hz"] for s in samples) / 3600.0
    n_false = int(sum(s["false_tracklets"] for s in samples))
    bank = np.stack([objects[name][linked] for name in BANK_COLUMNS], axis=1)
    return {
        "version": VERSION,
        "instrument": described,
        "instrument_fingerprint": instrument.fingerprint(described),
        "scenario": scenario.name,
        "code": code,
        "commit": commit,
        "runs": len(samples),
        "seeds": [int(s) for s in seeds],
        "frames": int(sum(s["frames"] for s in samples)),
        "hours": hours,
        "noise_e": noise,
        "detection": (detection := _detection(runs, below, trails, noise)),
        "skies": _skies(samples, runs, below, np.array(detection["curve"]), noise),
        "linking": _linking(objects),
        "tracklets": [[_rounded(v) for v in row] for row in bank.tolist()],
        "tracklet_columns": list(BANK_COLUMNS),
        "residuals": _residual_words(objects, linked),
        "pulls": _pulls(trails),
        "false": {
            "tracklets_per_hour": rate(n_false, hours, n_false),
            "streaks_per_frame": rate(
                int(sum(s["false_streaks"] for s in samples)),
                float(sum(s["frames"] for s in samples)),
                int(sum(s["frames"] for s in samples)),
            ),
            "duplicate_tracklets": int(sum(s["duplicate_tracklets"] for s in samples)),
        },
        "downlink": {
            "bytes_per_frame": float(sum(s["downlink_bytes"] for s in samples) / sum(s["frames"] for s in samples)),
            "lost_between_board_and_ground": proportion(
                int(((trails["onboard"] > 0.5) & (trails["ground"] < 0.5)).sum()), int((trails["onboard"] > 0.5).sum())
            ),
            "packets_lost": int(sum(s["packets_lost"] for s in samples)),
        },
    }


def _skies(
    samples: Sequence[Mapping[str, Any]], runs: Sequence[Mapping[str, Array]], below: Sequence[str], curve: Array, noise: float
) -> list[dict[str, Any]]:
    """What each sky shows of the curve: trails found over those that it expects of their S/N, length and noise."""
    rng = np.random.default_rng(SEED)
    out = []
    for sky in dict.fromkeys(below):
        mine = [k for k, name in enumerate(below) if name == sky]
        found = np.array([runs[k]["ground"].sum() for k in mine])
        expected = np.array(
            [
                mean_share(curve, runs[k]["snr"], runs[k]["length_px"], runs[k]["noise_e"] / noise, runs[k]["edges"] > 0).sum()
                for k in mine
            ]
        )
        pick = rng.integers(len(mine), size=(SKY_REDRAWS, len(mine)))
        low, high = np.quantile(found[pick].sum(axis=1) / np.maximum(expected[pick].sum(axis=1), 1e-9), [0.05, 0.95])
        out.append(
            {
                "sky": sky,
                "runs": len(mine),
                "trails": sum(len(runs[k]["snr"]) for k in mine),
                "noise_ratio": _rounded(np.median(np.concatenate([runs[k]["noise_e"] for k in mine])) / noise),
                "found": int(found.sum()),
                "expected": _rounded(expected.sum()),
                "found_over_expected": [_rounded(v) for v in (found.sum() / max(expected.sum(), 1e-9), low, high)],
                "false_streaks": int(sum(samples[k]["false_streaks"] for k in mine)),
                "false_tracklets": int(sum(samples[k]["false_tracklets"] for k in mine)),
            }
        )
    return out


def _detection(
    runs: Sequence[Mapping[str, Array]], below: Sequence[str], trails: Mapping[str, Array], noise: float
) -> dict[str, Any]:
    """The curve, curves of resampled runs (as many below each sky), and the table that they stand for."""
    ratio, cut = trails["noise_e"] / noise, trails["edges"] > 0
    sky = bool(ratio.max() / ratio.min() > SKY_SPREAD)
    curve = fitted(trails_of(runs, noise), sky=sky)
    rng = np.random.default_rng(SEED)
    skies = [np.flatnonzero(np.array(below) == name) for name in dict.fromkeys(below)]
    curves = []
    for _ in range(BOOTSTRAPS):
        pick = np.concatenate([rng.choice(group, size=len(group)) for group in skies])
        curves.append(fitted(trails_of([runs[k] for k in pick], noise), sky=sky, start=curve))
    table: list[dict[str, Any]] = []
    for low, high in pairwise(SNR_EDGES):
        for short, long in pairwise(LENGTH_EDGES_PX):
            inside = (trails["snr"] >= low) & (trails["snr"] < high) & (trails["length_px"] >= short)
            inside &= trails["length_px"] < long
            n = int(inside.sum())
            if n:
                share = mean_share(curve, trails["snr"][inside], trails["length_px"][inside], ratio[inside], cut[inside])
                table.append(
                    {
                        "snr": [low, min(high, 1e6)],
                        "length_px": [short, min(long, 1e6)],
                        "found": proportion(int(trails["ground"][inside].sum()), n),
                        "found_on_board": int(trails["onboard"][inside].sum()),
                        "curve": float(share.mean()),
                    }
                )
    expected = np.array([t["curve"] * t["found"]["n"] for t in table])
    counted = np.array([t["found"]["value"] * t["found"]["n"] for t in table])
    spread = np.array([max(t["curve"] * (1.0 - t["curve"]) * t["found"]["n"], 0.25) for t in table])

    def figure(place: int) -> dict[str, Any]:
        low, high = np.percentile([c[place] for c in curves], [5.0, 95.0])
        return {"value": float(curve[place]), "n": len(trails["snr"]), "low": float(low), "high": float(high)}

    return {
        "curve": [_rounded(v) for v in curve],
        "curves": [[_rounded(v) for v in c] for c in curves],
        "parameters": list(PARAMETERS),
        "snr50_30px": figure(HALF),
        "slope_with_log10_noise": figure(WITH_NOISE) if sky else absent("one sky only", len(trails["snr"])),
        "when_cut": figure(WHEN_CUT) | {"n": int(cut.sum())},
        "shortest_px": figure(SHORTEST) | {"n": int((trails["length_px"] < LENGTH_EDGES_PX[2]).sum())},
        "ln_spread_of_objects": figure(LN_SPREAD),
        "noise_e": [float(trails["noise_e"].min()), float(trails["noise_e"].max())],
        "chi2": float(np.sum((counted - expected) ** 2 / spread)),
        "cells": len(table),
        "table": table,
    }  # fmt: skip


def trails_of(runs: Sequence[Mapping[str, Array]], noise: float) -> Trails:
    """Trails of runs, the same run drawn twice being two; noise : of the scenario's own sky."""
    every = {n: np.concatenate([run[n] for run in runs]) for n in ("snr", "length_px", "noise_e", "edges", "ground", "object")}
    first = np.cumsum([0, *(1.0 + np.max(run["object"], initial=0.0) for run in runs[:-1])])
    return Trails(
        snr=every["snr"],
        length_px=every["length_px"],
        noise_ratio=every["noise_e"] / noise,
        cut=every["edges"] > 0,
        found=every["ground"] > 0.5,
        owner=(every["object"] + np.repeat(first, [len(run["object"]) for run in runs])).astype(np.int64),
    )


def _linking(objects: Mapping[str, Array]) -> list[dict[str, Any]]:
    """Tracklets by frames in which an object was found."""
    rows = []
    for low, high in pairwise(FRAME_EDGES):
        inside = (objects["detected"] >= low) & (objects["detected"] < high)
        n, k = int(inside.sum()), int((objects["linked"][inside] >= 2).sum())
        rows.append({"frames": [low, high - 1], "tried": n, "linked": k, "share": proportion(k, n, "none was found so often")})
    return rows


def _residual_words(objects: Mapping[str, Array], linked: NDArray[np.bool_]) -> dict[str, Any]:
    """Points of the distribution of each residual, and their correlations, for readers; surveys draw from the rows."""
    values = np.stack([objects[name][linked] for name in RESIDUALS], axis=1)
    whole = values[np.isfinite(values).all(axis=1)]
    ranks = np.argsort(np.argsort(whole, axis=0), axis=0).astype(float)
    return {
        "names": list(RESIDUALS),
        "n": len(whole),
        "quantiles": {str(q): [_rounded(v) for v in np.nanquantile(values, q, axis=0)] for q in PULL_POINTS},
        "rank_correlations": [[_rounded(v) for v in row] for row in np.corrcoef(ranks.T)],
        "without_orbit": proportion(int(np.isnan(values[:, 2]).sum()), len(values)),
    }


def _pulls(trails: Mapping[str, Array]) -> dict[str, Any]:
    """Points of the distributions of (measured - true) / stated error of trails: 1 at 84 %, 2.33 at 99 % of a normal one."""
    out: dict[str, Any] = {}
    for name in PULLS:
        values = trails[name][np.isfinite(trails[name])]
        out[name] = (
            {
                "n": len(values),
                "quantiles": {str(q): _rounded(v) for q, v in zip(PULL_POINTS, np.quantile(values, PULL_POINTS), strict=True)},
            }
            if len(values) > 2
            else absent("too few trails", len(values))
        )
    return out


def write(path: Path, content: Mapping[str, Any]) -> None:
    """Write a response file: one key on a line, and one row of its tables."""
    lines = []
    for key, value in content.items():
        if isinstance(value, list) and value and isinstance(value[0], list | dict):
            rows = ",\n  ".join(json.dumps(row) for row in value)
            lines.append(f"{json.dumps(key)}: [\n  {rows}\n ]")
        elif isinstance(value, dict):
            rows = ",\n  ".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in value.items())
            lines.append(f"{json.dumps(key)}: {{\n  {rows}\n }}")
        else:
            lines.append(f"{json.dumps(key)}: {json.dumps(value)}")
    write_text(path, "{\n " + ",\n ".join(lines) + "\n}\n")


def shipped(scenario: Scenario) -> Path:
    """File of the response that comes with the project for a scenario's name. `UserError` where there is none."""
    path = FOLDER / "data" / "responses" / f"{scenario.name}.json"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.json")))
        raise UserError(
            f"scenario {scenario.name}: no response comes with it (there are: {known}); `sboc response {scenario.name}` measures "
            "one, and --response takes its file"
        )
    return path


def read(path: Path, scenario: Scenario) -> Response:
    """The response of a file, for a scenario. Raises `UserError` of one line when it is none or another instrument's."""
    if not path.is_file():
        raise UserError(f"{path}: no such response; `sboc response {scenario.name}` measures one")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version, theirs = content["version"], content["instrument"]
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not a response file ({type(error).__name__})") from error
    if version != VERSION:
        raise UserError(f"{path}: a response of version {version}; this program reads version {VERSION}: measure it again")
    mine = json.loads(json.dumps(instrument.description(scenario)))
    difference = instrument.first_difference(mine, theirs, json.loads(json.dumps(instrument.camera_defaults())))
    if difference is not None:
        raise UserError(f"{path}: measured with another instrument than that of {scenario.name}: {difference}")
    return Response(content=content)


def _rounded(value: Any) -> Any:
    """Six digits; None for NaN."""
    return float(f"{float(value):.6g}") if np.isfinite(value) else None
