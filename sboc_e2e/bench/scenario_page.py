"""One table of all scenarios: completeness, false alarms, linking and CPU by stage, from stored runs.

``python -m sboc_e2e.bench.scenario_page docs/scenarios.md`` writes the page from bench/scenarios.json; a test holds it there.
"""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from sboc_e2e.bench.parts import STORED
from sboc_e2e.report.words import figure_words, number
from sboc_e2e.scenario import available

STORED_RUNS: Final = STORED / "scenarios.json"
FIGURES: Final = (
    ("completeness", "detection.ground.completeness_snr8", "completeness, S/N >= 8"),
    ("false_per_frame", "detection.ground.false_per_frame", "false per frame"),
    ("linking_completeness", "linking.completeness", "objects linked"),
    ("linking_purity", "linking.purity", "purity"),
)
STAGES: Final = ("simulate", "onboard", "ground")

HEAD_TEXT: Final = """# All scenarios in one table

Generated from `bench/scenarios.json` by `python -m sboc_e2e.bench.scenario_page docs/scenarios.md`.

Each row is one run of a shipped scenario, with one seed. Judge it by its 90 % interval (in brackets).
`python -m tests.benchmarks.bench_scenarios` measures the runs again. A slow test runs every scenario and compares its score with
the bounds in `tests/end_to_end/scenario_bounds.json`.

CPU seconds are of the median frame of each stage, without compilation, start-up, linking and orbits. The machine was shared with
other work, so compare them with each other only.
"""


def row_of(run: Path) -> dict[str, Any]:
    """The figures of a finished run."""
    score = json.loads((run / "score.json").read_text(encoding="utf-8"))
    manifest = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    found: dict[str, Any] = {"frames": score["detection"]["ground"]["false_per_frame"]["n"]}
    for name, path, _ in FIGURES:
        node: Any = score
        for key in path.split("."):
            node = node[key]
        found[name] = node
    for stage in STAGES:
        figures = manifest["stages"][stage]
        found[f"{stage}_cpu_s"] = {
            "value": figures["median_frame_cpu_s"], "low": figures["median_frame_cpu_s"],
            "high": figures["median_frame_cpu_s"], "n": figures["timed_frames"],
        }  # fmt: skip
    return found


def table_rows(runs: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """A row of words for each scenario."""
    rows = []
    for name, run in runs.items():
        words = [figure_words(run[figure]) for figure, _, _ in FIGURES]
        cells = [value if value != "-" else f"- ({note})" for value, note in words]
        cells[0] += f" ({run['completeness']['n']})" if run["completeness"]["value"] is not None else ""
        costs = [number(run[f"{stage}_cpu_s"]["value"]) for stage in STAGES]
        rows.append([name, str(run["frames"]), *cells, *costs])
    return rows


TABLE_HEAD: Final = (
    "scenario",
    "frames",
    f"{FIGURES[0][2]} (n)",
    *(label for _, _, label in FIGURES[1:]),
    *(f"{stage}, CPU-s" for stage in ("simulate", "on board", "ground")),
)


def page() -> str:
    """The whole page."""
    runs = json.loads(STORED_RUNS.read_text(encoding="utf-8"))
    descriptions = available()
    lines = [HEAD_TEXT, "| " + " | ".join(TABLE_HEAD) + " |", "|" + "---|" * len(TABLE_HEAD)]
    lines += ["| " + " | ".join([f"`{row[0]}`", *row[1:]]) + " |" for row in table_rows(runs)]
    lines += ["", *(f"- `{name}`: {descriptions[name]}" for name in runs if name in descriptions)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.bench.scenario_page", description="Write the page of scenarios.")
    parser.add_argument("page", type=Path, help="the page's file, docs/scenarios.md")
    parser.parse_args().page.write_text(page(), encoding="utf-8")
