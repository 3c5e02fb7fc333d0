"""The benchmark page shows what the on-board chain asks of a processor, and how its latencies are spread."""

import json
from pathlib import Path

from sboc_e2e.bench.entries import Entry, flatten
from sboc_e2e.bench.pages import SIZED, write_pages

ENVIRONMENT = {"quick": True, "wall_s": 1.0, "python": "3.11", "processors": 2}


def test_sizing_and_latencies_are_on_the_page(tmp_path: Path) -> None:
    figures = {"cpu_ms_per_mpx": 6.25, "cycles_per_px": 17.5, "latencies_cpu_s": [0.10, 0.11, 0.12]}
    chains = {chain: figures for _, chain, _ in SIZED}
    memory = {"process": {name: {"peak_rss_mb": 374.0} for _, _, name in SIZED}}
    (tmp_path / "bench_onboard.json").write_text(json.dumps(chains | memory))
    write_pages(flatten("onboard", chains | memory), {"onboard": 1.0}, ENVIRONMENT, [], tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<td>line_integral</td><td>6.250</td><td>17.50</td><td>-</td><td>374</td>" in page
    assert "line_integral, n = 3" in page


def test_a_page_without_the_onboard_bench_has_no_sizing(tmp_path: Path) -> None:
    write_pages(flatten("smoke", {"snr50": 7.5}), {}, ENVIRONMENT, [], tmp_path)
    assert "On-board sizing" not in (tmp_path / "report.html").read_text()


def test_the_baseline_stands_beside_each_figure(tmp_path: Path) -> None:
    entries = [
        Entry(name="a.completeness", value=0.9, n=10, low=0.85, high=0.95),
        Entry(name="a.false_per_frame", value=0.2, n=10, low=0.1, high=0.3),
        Entry(name="a.cpu_s", value=2.0, n=1, low=2.0, high=2.0),
        Entry(name="a.new", value=1.0, n=1, low=1.0, high=1.0),
    ]
    stored = {"a.completeness": {"value": 0.8}, "a.false_per_frame": {"value": 0.1}, "a.cpu_s": {"value": 1.0}}
    environment = {"python": "3", "machine": "x", "processors": 1, "quick": True, "wall_s": 1.0}
    write_pages(entries, {}, environment, [], tmp_path, stored)
    rows = [line.split(" | ") for line in (tmp_path / "report.md").read_text().splitlines() if line.startswith("| a.")]
    assert [row[2:4] for row in rows] == [
        ["0.8000", "+12.5 %, better"],
        ["0.1000", "+100.0 %, worse"],
        ["1", "+100.0 %"],
        ["-", ""],
    ]
