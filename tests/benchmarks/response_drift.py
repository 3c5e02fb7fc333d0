"""What the code of today makes of the frames that a response was measured on: tracklets of the same seeds side by side.

``python -m tests.benchmarks.response_drift SAMPLES [RESPONSE]`` reads the samples that ``sboc response ... --out DIR`` has left
in ``DIR/samples`` so far, in the order of the response's seeds, and the response (default: the shipped one of `sso_antisun`).
The seeds are the same, so that a difference is one of code and no scatter of the draw. It judges no response: that takes other
seeds (``--judge``).
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from sboc_e2e.scenario.toml_files import FOLDER
from sboc_e2e.survey.curve import mean_share
from sboc_e2e.survey.response import RESIDUALS, Response
from sboc_e2e.survey.rows import OBJECT_COLUMNS, STREAK_COLUMNS, columns

SAME_ARC = SAME_SNR = 2e-3  # tracklets of one object: its arc and S/N are true ones, so that code hardly changes them
REDRAWS = 4000  # of runs, for intervals of 90 %


def main(samples: Path, shipped: Path) -> None:
    """Print the comparison."""
    content = json.loads(shipped.read_text(encoding="utf-8"))
    files = [samples / f"{seed:015d}.json" for seed in content["seeds"]]
    count = next((k for k, file in enumerate(files) if not file.is_file()), len(files))
    runs = [json.loads(file.read_text(encoding="utf-8")) for file in files[:count]]
    if not runs:
        sys.exit(f"{samples}: holds no sample of the first seed of {shipped}")
    objects = [columns(run["objects"], OBJECT_COLUMNS) for run in runs]
    found_and_expected(runs, objects, Response(content=content))
    linked = {name: np.concatenate([o[name][o["linked"] >= 2] for o in objects]) for name in OBJECT_COLUMNS}
    rows = columns(content["tracklets"], tuple(content["tracklet_columns"]))
    pairs: list[tuple[int, int]] = []
    for k in range(len(linked["arc_deg"])):
        near = np.abs(rows["arc_deg"] - linked["arc_deg"][k]) <= SAME_ARC * (1.0 + linked["arc_deg"][k])
        near &= np.abs(rows["snr_all"] / linked["snr_all"][k] - 1.0) <= SAME_SNR
        free = np.setdiff1d(np.flatnonzero(near), [j for _, j in pairs])
        if len(free):
            pairs.append((k, int(free[0])))
    now, then = (list(side) for side in zip(*pairs, strict=True))
    # the rows of a response stand in the order of its runs
    say(f"{len(runs)} runs: {len(linked['arc_deg'])} tracklets, {max(then) + 1} in the response, {len(pairs)} in both")
    say(f"frames linked: {linked['linked'][now].sum():.0f}, {rows['linked'][then].sum():.0f} in the response")
    for name in RESIDUALS:
        new, old = np.abs(linked[name][now]), np.abs(rows[name][then])
        both = np.isfinite(new) & np.isfinite(old)
        change = (new - old)[both]
        say(
            f"|{name}|: median {np.median(new[both]):.4f}, {np.median(old[both]):.4f} in the response; "
            f"mean change {change.mean():.4f} +- {change.std(ddof=1) / np.sqrt(len(change)):.4f} (n = {len(change)})"
        )


def found_and_expected(runs: list[dict[str, Any]], objects: list[dict[str, Any]], response: Response) -> None:
    """Print trails found against those that the response's curve expects."""
    counts = []
    for run, mine in zip(runs, objects, strict=True):
        t = columns(run["streaks"], STREAK_COLUMNS)
        kept = (t["frame"] > 0) & np.isin(t["object"], mine["object"])
        ratio = t["noise_e"] / response.content["noise_e"]
        share = mean_share(response.curve, t["snr"], t["length_px"], ratio, t["edges"] > 0.0)
        counts.append((kept.sum(), t["ground"][kept].sum(), share[kept].sum()))
    table = np.array(counts)
    pick = np.random.default_rng(1).integers(len(table), size=(REDRAWS, len(table)))
    ratios = table[pick, 1].sum(axis=1) / table[pick, 2].sum(axis=1)
    n, found, expected = table.sum(axis=0)
    low, high = np.quantile(ratios, [0.05, 0.95])
    say(f"{n:.0f} trails: {found:.0f} found, {expected:.1f} expected, ratio {found / expected:.3f} [{low:.3f}, {high:.3f}]")


def say(line: str) -> None:
    """Write a line now."""
    print(line, flush=True)  # noqa: T201 - the script's result


if __name__ == "__main__":
    default = FOLDER / "data" / "responses" / "sso_antisun.json"
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else default)
