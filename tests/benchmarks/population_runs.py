"""How often the published flux holds the truth, by pixels: ``python -m tests.benchmarks.population_runs FOLDER --runs 40``.

Each run is `smoke` with debris alone, Poisson numbers of each class, a median albedo drawn from what `population.ecsv` states of
the mean albedo and of the phase function, and albedos that scatter from object to object as it assumes. The true flux is nature's
at the camera, times what makes the expected number of a class. Every third frame comes down whole. One line of JSON for each run
stands in FOLDER/runs.jsonl; runs that have one are left out, so that the command goes on where it stopped.
"""

import argparse
import json
import math
import re
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from ground.population.flux import ALBEDO, ALBEDO_SIGMA_LN, MEAN_ALBEDO_SIGMA_LN, PHASE_SIGMA_LN
from sboc_e2e.registry import Registry
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.scenario import load

EDGES_MM: Final = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 3000.0)
FRAMES, EXPECTED = 24, 20.0
"""Of a run, and objects of each class that reach the least S/N: 2 to 10 tracklets of each. With a quarter of both, 0.4 to 3
tracklets, intervals hold the truth in 97 % of counts that are drawn from the product's own model, for a Poisson number so
small is known no better; with these in 90 %."""
LEAST_SNR: Final = 5.0
GREY: Final = (
    f"population.surface.albedo_scatter={ALBEDO_SIGMA_LN}", "population.surface.specular_share=0.0",
    "population.surface.reddening=0 mag", "population.surface.colour_scatter=0 mag", "population.surface.facet_share=0.0",
    "population.surface.glint_share=0.0",
)  # fmt: skip
"""Spheres of diffuse light: what their shine is off the assumed law by is in the median albedo."""


def drawn(seed: int) -> tuple[list[int], float]:
    """Numbers of each class and median albedo of a run."""
    rng = np.random.default_rng([9, seed])
    light = math.hypot(MEAN_ALBEDO_SIGMA_LN, PHASE_SIGMA_LN)
    counts = rng.poisson(EXPECTED, len(EDGES_MM) - 1)
    return [int(c) for c in counts], round(float(ALBEDO * np.exp(light * rng.standard_normal())), 5)


def scenario_text(counts: Sequence[int], albedo: float) -> str:
    """The scenario's file."""
    smoke = (Path(__file__).resolve().parents[2] / "scenarios/smoke.toml").read_text(encoding="utf-8")
    classes = ", ".join(
        f'{{from = "{low} mm", to = "{high} mm", count = {count}}}'
        for (low, high), count in zip(pairwise(EDGES_MM), counts, strict=True)
    )
    smoke = smoke.replace("keep_frames_every = 1", "keep_frames_every = 0").replace("\nframes = 6\n", f"\nframes = {FRAMES}\n")
    smoke = re.sub(r"\n\[population[^\[]*", "\n", smoke)
    return smoke + (
        "\n[onboard.downlink]\nwhole_frame_every = 3\n[objects]\npassing = []\n[population]\n"
        f'farthest = "11000 km"\nsnr_min = {LEAST_SNR}\nalbedo = {albedo}\nclasses = [{classes}]\n'
    )


def one_run(folder: Path, seed: int) -> dict[str, Any]:
    """Simulate, process and compare one run; its folder is removed. Ratios are published medians over the truth."""
    began, out = time.process_time(), folder / str(seed)
    counts, albedo = drawn(seed)
    out.mkdir(parents=True, exist_ok=True)
    file = folder / f"{seed}.toml"
    file.write_text(scenario_text(counts, albedo), encoding="utf-8")
    run = begin_or_continue(out, load(str(file), registry=Registry(), overrides=GREY, seed=seed), workers=1)
    run.simulate_and_onboard()
    run.ground()
    classes = json.loads((out / "truth/population.json").read_text(encoding="utf-8"))["classes"]
    # of a class that nature never shows brightly enough, the run says nothing
    flux = [EXPECTED / (c["natural_expected"] or math.nan) * c["flux_km2_year"] for c in classes]
    found = against(Table.read(out / "products/population.ecsv"), np.cumsum(flux[::-1])[::-1])
    shutil.rmtree(out)
    file.unlink()
    return {"seed": seed, "counts": counts, "albedo": albedo, **found, "cpu_s": round(time.process_time() - began, 1)}


def against(published: Table, larger: np.ndarray) -> dict[str, Any]:
    """A table of fluxes against the true ones of more than each edge but the last, per km^2 and year."""
    at = [int(np.argmin(np.abs(np.asarray(published["from_m"]) * 1e3 - edge))) for edge in EDGES_MM[:-1]]
    low, middle, high = (
        np.asarray(published[name], dtype=np.float64)[at] for name in ("larger_total_low", "larger", "larger_total_high")
    )
    return {
        "inside": [
            bool(a <= true <= b) if math.isfinite(b + true) else None for a, true, b in zip(low, larger, high, strict=True)
        ],
        "ln_ratio": [round(float(v), 3) if math.isfinite(v) else None for v in np.log(middle / larger)],
        "n_tracklets": [int(v) for v in published["n_tracklets"]],
        "lacks": str(published.meta["lacks"]),
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """Share of sizes that hold the truth, resampled by runs, and medians of the ratios."""
    held = [[v for v in row["inside"] if v is not None] for row in rows]
    rng = np.random.default_rng(0)
    each = np.array([[sum(h), len(h)] for h in held], dtype=np.float64)
    drawn_again = each[rng.integers(len(each), size=(2000, len(each)))].sum(axis=1)
    low, high = np.percentile(drawn_again[:, 0] / drawn_again[:, 1], [5.0, 95.0])
    ratios = np.array([[np.nan if v is None else v for v in row["ln_ratio"]] for row in rows])
    below = int(np.sum(np.nanmedian(ratios, axis=1) < 0.0))
    lines = [
        f"{len(rows)} runs: {int(each[:, 0].sum())} of {int(each[:, 1].sum())} sizes hold the truth, "
        f"{each[:, 0].sum() / each[:, 1].sum():.3f} [{low:.3f}, {high:.3f}]; medians low in {below} of {len(rows)} runs",
        f"ln(published / true) of more than {', '.join(f'{e:g}' for e in EDGES_MM[:-1])} mm: "
        + ", ".join(f"{v:+.2f}" for v in np.nanmedian(ratios, axis=0)),
    ]
    return "\n".join(lines)


def main() -> None:
    """Make what is missing, then sum up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--first", type=int, default=1, help="seed of the first run")
    wanted = parser.parse_args()
    wanted.folder.mkdir(parents=True, exist_ok=True)
    file = wanted.folder / "runs.jsonl"
    rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.is_file() else []
    for seed in sorted(set(range(wanted.first, wanted.first + wanted.runs)) - {row["seed"] for row in rows}):
        rows.append(one_run(wanted.folder, seed))
        with file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(rows[-1]) + "\n")
        sys.stdout.write(json.dumps(rows[-1]) + "\n")
        sys.stdout.flush()
    sys.stdout.write(summary(rows) + "\n")


if __name__ == "__main__":
    main()
