"""bench/out: report.json, report.md, report.html, a file for github-action-benchmark, and the history with its plot."""

import fnmatch
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from sboc_e2e.bench.entries import HIGHER, LOWER, Entry
from sboc_e2e.bench.quoted import QUOTED_PEERS
from sboc_e2e.bench.scenario_page import TABLE_HEAD, table_rows
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

BIN_RATIO: Final = 0.02
"""Width of a bin of latencies, in their logarithm."""

SIZED: Final = (
    ("without a detector", "chain_without_detector", "none"),
    ("threshold", "chain_threshold", "threshold"),
    ("line_integral", "chain_line_integral", "line_integral"),
)
"""Rows of the on-board sizing: label, and the names under `onboard.` of its times and of its process's memory."""

SIZES: Final = (
    ("CPU ms / Mpx", "onboard.{0}.cpu_ms_per_mpx"),
    ("cycles / px", "onboard.{0}.cycles_per_px"),
    ("MB / Mpx beside libraries", "onboard.process.{1}.peak_above_libraries_and_kernels_rss_mb_per_mpx"),
    ("MB at the peak of the process", "onboard.process.{1}.peak_rss_mb"),
)


def _words(e: Entry, baseline: Mapping[str, Any]) -> tuple[str, ...]:
    """Name, value with interval, baseline, change against it, unit, n or the reason of absence."""
    stored = baseline.get(e.name, {}).get("value")
    before = "-" if stored is None else number(stored)
    if e.value is None:
        return e.name, "-", before, "", e.unit, e.reason
    value = number(e.value) if e.low == e.high else f"{number(e.value)} [{number(e.low)}, {number(e.high)}]"
    return e.name, value, before, _change(e, stored), e.unit, f"n = {e.n:,}" if e.n > 1 else ""


def _change(e: Entry, stored: float | None) -> str:
    """By how much a figure departs from its baseline, in percent, and whether that is better or worse."""
    if stored is None or e.value is None or stored == e.value:
        return ""
    relative = f"{100.0 * (e.value - stored) / abs(stored):+.1f} %" if stored else f"{e.value - stored:+.3g}"
    if e.better not in (HIGHER, LOWER) or e.unit in ("s", "ms", "MB/s"):
        return relative  # seconds of another machine say nothing by themselves; --check weighs them with the yardstick
    return f"{relative}, {'better' if (e.value > stored) == (e.better == HIGHER) else 'worse'}"


def write_pages(
    entries: Sequence[Entry],
    costs: dict[str, float],
    environment: dict[str, Any],
    regressions: Sequence[str],
    out: Path,
    baseline: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """All files of the report. baseline : stored figures by name, shown beside the new ones."""
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
    head = ("figure", "value [90 %]", "baseline", "change", "unit", "n or reason")
    rows = [_words(e, baseline) for e in entries]
    quick = "quick" if environment["quick"] else "full"
    took = (
        f"{quick} benchmark, {environment['wall_s']} s, Python {environment['python']}, {environment['processors']} processors."
    )
    lines = ["# Benchmark report", "", took, ""]
    lines += [f"- regression: {r}" for r in regressions] + ([""] if regressions else [])
    lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(r) + " |" for r in rows)]
    lines += ["", "Peers that are not on the package index, as their sources quote them:", ""]
    lines += ["| peer | figure | source |", "|---|---|---|", *("| " + " | ".join(q) + " |" for q in QUOTED_PEERS)]
    write_text(out / "report.md", "\n".join(lines) + "\n")
    body = [f"<p>{took}</p>"]
    if regressions:
        body += ["<h2>Regressions</h2>", "<ul>", *(f"<li>{r}</li>" for r in regressions), "</ul>"]
    body += ["<h2>Figures</h2>", table(head, rows)]
    body += _scenarios(out / "bench_scenarios.json")
    body += _onboard_sizing(entries, out / "bench_onboard.json")
    body += ["<h2>Peers, quoted</h2>", table(("peer", "figure", "source"), QUOTED_PEERS)]
    body += ["<h2>Wall seconds of each bench</h2>", table(("bench", "s"), [(k, f"{v:.1f}") for k, v in costs.items()])]
    body += ["<h2>History</h2>", f"<figure>{history_plot(out / HISTORY)}</figure>"]
    write_text(out / "report.html", simple_page("Benchmark report", body))


def _scenarios(result: Path) -> list[str]:
    """One table of all scenarios; nothing if they were not measured."""
    if not result.is_file():
        return []
    runs = json.loads(result.read_text(encoding="utf-8"))
    return ["<h2>All scenarios</h2>", table(TABLE_HEAD, table_rows(runs))]


def _onboard_sizing(entries: Sequence[Entry], result: Path) -> list[str]:
    """What the on-board chain asks of a processor for each Mpx, and how its latencies are spread; nothing if not measured."""
    values = {e.name: e.value for e in entries}
    rows = []
    for label, chain, process in SIZED:
        found = [values.get(name.format(chain, process)) for _, name in SIZES]
        if any(value is not None for value in found):
            rows.append((label, *("-" if value is None else number(value) for value in found)))
    if not rows:
        return []
    note = (
        "Operations are given as processor cycles, CPU time times clock: the work of one core with its vector units, "
        "which holds however many instructions it retires in a cycle."
    )
    body = ["<h2>On-board sizing</h2>", table(("chain", *(title for title, _ in SIZES)), rows), f"<p>{note}</p>"]
    return [*body, f"<figure>{latency_plot(json.loads(result.read_text(encoding='utf-8')))}</figure>"]


def latency_plot(onboard: dict[str, Any]) -> str:
    """Histograms of CPU time of single frames, by chain; bins of 2 %."""
    with plots.canvas(10.0, 2.8) as (figure, (ax,)):
        for (label, chain, _), colour in zip(SIZED, plots.SERIES, strict=False):
            latencies = np.array(onboard[chain]["latencies_cpu_s"])
            n_bins = max(1, math.ceil(math.log(latencies.max() / latencies.min()) / BIN_RATIO))
            bins = latencies.min() * np.exp(BIN_RATIO * np.arange(n_bins + 1))
            ax.hist(latencies, bins, histtype="stepfilled", alpha=0.7, color=colour, label=f"{label}, n = {latencies.size}")
        ax.set(xscale="log", xlabel="CPU s per frame", ylabel="frames")
        plots.plain_logarithmic(ax.xaxis)
        figure.legend(loc="outside upper center", ncols=len(SIZED))
        return plots.svg(figure)


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
