"""bench/out: report.json, report.md, report.html, a file for github-action-benchmark, and the history with its plot."""

import fnmatch
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from sboc_e2e.bench.entries import HIGHER, LOWER, Entry
from sboc_e2e.bench.quoted import QUOTED_PEERS
from sboc_e2e.files.atomic import write_text
from sboc_e2e.report import plots
from sboc_e2e.report.page import simple_page, table
from sboc_e2e.report.words import number

HISTORY: Final = "history.jsonl"
TRENDS: Final = (
    "sso_antisun*.detection.ground.completeness_snr8",
    "sso_antisun*.detection.ground.false_per_frame",
    "sso_antisun*.timing.onboard_cpu_s_per_frame",
    "sso_antisun*.compression.reduction",
)


def _words(e: Entry) -> tuple[str, str, str, str]:
    if e.value is None:
        return e.name, "-", e.unit, e.reason
    value = number(e.value) if e.low == e.high else f"{number(e.value)} [{number(e.low)}, {number(e.high)}]"
    return e.name, value, e.unit, f"n = {e.n:,}" if e.n > 1 else ""


def write_pages(
    entries: Sequence[Entry], costs: dict[str, float], environment: dict[str, Any], regressions: Sequence[str], out: Path
) -> None:
    """All files of the report."""
    figures = [vars(e) | {"better": e.better, "unit": e.unit} for e in entries]
    summary = {"environment": environment, "wall_s": costs, "regressions": list(regressions), "figures": figures}
    write_text(out / "report.json", json.dumps(summary, indent=1))
    for way, name in ((LOWER, "benchmark-action-smaller.json"), (HIGHER, "benchmark-action-bigger.json")):
        items = [
            {"name": e.name, "unit": e.unit or "1", "value": e.value, "range": f"{e.low:.4g} to {e.high:.4g}"}
            for e in entries
            if e.better == way and e.value is not None
        ]
        write_text(out / name, json.dumps(items, indent=1))
    earlier = (out / HISTORY).read_text(encoding="utf-8") if (out / HISTORY).exists() else ""
    line = json.dumps({"environment": environment, "values": {e.name: e.value for e in entries}})
    write_text(out / HISTORY, f"{earlier}{line}\n")
    head = ("figure", "value [90 %]", "unit", "n or reason")
    rows = [_words(e) for e in entries]
    quick = "quick" if environment["quick"] else "full"
    took = (
        f"{quick} benchmark, {environment['wall_s']} s, Python {environment['python']}, {environment['processors']} processors."
    )
    lines = ["# Benchmark report", "", took, ""]
    lines += [f"- regression: {r}" for r in regressions] + ([""] if regressions else [])
    lines += ["| " + " | ".join(head) + " |", "|---|---|---|---|", *("| " + " | ".join(r) + " |" for r in rows)]
    lines += ["", "Peers that are not on the package index, as their sources quote them:", ""]
    lines += ["| peer | figure | source |", "|---|---|---|", *("| " + " | ".join(q) + " |" for q in QUOTED_PEERS)]
    write_text(out / "report.md", "\n".join(lines) + "\n")
    body = [f"<p>{took}</p>"]
    if regressions:
        body += ["<h2>Regressions</h2>", "<ul>", *(f"<li>{r}</li>" for r in regressions), "</ul>"]
    body += ["<h2>Figures</h2>", table(head, rows)]
    body += ["<h2>Peers, quoted</h2>", table(("peer", "figure", "source"), QUOTED_PEERS)]
    body += ["<h2>Wall seconds of each bench</h2>", table(("bench", "s"), [(k, f"{v:.1f}") for k, v in costs.items()])]
    body += ["<h2>History</h2>", f"<figure>{history_plot(out / HISTORY)}</figure>"]
    write_text(out / "report.html", simple_page("Benchmark report", body))


def history_plot(path: Path) -> str:
    """Headline figures of all stored reports, in the order they were made."""
    reports = [json.loads(line)["values"] for line in path.read_text().splitlines() if line.strip()]
    with plots.canvas(10.0, 2.8, columns=len(TRENDS)) as (figure, axes):
        for ax, pattern in zip(axes, TRENDS, strict=True):
            points = []
            for k, values in enumerate(reports):
                names = fnmatch.filter(values, pattern)
                if names and values[names[0]] is not None:
                    points.append((k + 1, values[names[0]]))
            if points:
                ax.plot(*zip(*points, strict=True), "o-", color=plots.BLUE, ms=4)
            ax.set(title=pattern.rsplit(".", 1)[-1], xlabel="report")
            ax.title.set_fontsize(8)
        return plots.svg(figure)
