"""Comparison, campaign and benchmark pages in a real Chromium: they fit a phone and a wide screen, light and dark."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.bench.entries import Entry
from sboc_e2e.bench.pages import write_pages as write_bench
from sboc_e2e.campaign.engine import CampaignResult
from sboc_e2e.campaign.pages import write_results
from sboc_e2e.campaign.plan import Campaign
from sboc_e2e.compare.pages import write_pages as write_compare
from sboc_e2e.score.figures import figure
from sboc_e2e.score.recovery import Counted
from tests.browser import SCHEMES, WIDTHS, excess_and_errors

PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA="


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = tmp_path_factory.mktemp("pages")
    value = figure(0.5, 20, 0.4, 0.6)
    names = ("line_integral", "my_lab.nets:StreakNetWithALongName")
    names_of = (
        "completeness_snr8", "snr50", "false_per_frame", "false_unflagged_per_frame", "cross_crlb_ratio", "cross_crlb_robust",
        "median_cpu_ms_per_frame",
    )  # fmt: skip
    choice: dict[str, Any] = dict.fromkeys(names_of, value) | {
        "cpu_ms_per_frame": 10.0, "downlink_bits_per_frame": 5e4, "notes": []
    }  # fmt: skip
    result = {
        "scenario": "smoke", "seam": "onboard.detector", "seeds": 1, "n_frames": 6, "n_truth": 20,
        "choices": dict.fromkeys(names, choice),
        "pairs": [
            {
                "first": names[0], "second": names[1], "difference": figure(-0.2, 20, -0.3, -0.1),
                "mcnemar": {"only_second": 1, "only_first": 5, "objects_disagreeing": 4, "p_value": 0.03},
            }
        ],
        "questions": [{"figure": "x", "label": "completeness", "choices": dict.fromkeys(names, value)}],
        "splits": [{"quantity": "S/N", "bin": "3 to 6", "n": 20, "choices": dict.fromkeys(names, value)}],
        "runs": {name: ["runs/0123456789abcdef"] for name in names},
    }  # fmt: skip
    case = {"picture": PIXEL, "snr": 9.0, "length_px": 20.0, "frame": 1}
    gallery = [case | {"found": names[0], "lost": names[1]}]
    write_compare(result, {}, gallery, {names[0]: [case], names[1]: []}, out)
    entries = [
        Entry(name=f"smoke.detection.ground.figure_{k}", value=float(k), n=6, low=k - 1.0, high=k + 1.0) for k in range(20)
    ]
    environment = {"python": "3", "machine": "x", "processors": 2, "quick": True, "wall_s": 1.0}
    write_bench(entries, {"smoke": 1.0}, environment, [], out)
    campaign = Campaign(
        name="thresholds", scenario="smoke", vary={"onboard.detector.n_sigma": [6.0, 7.0, 8.0]}, description="Three thresholds."
    )
    tasks = campaign.tasks()
    shards = tuple(shard(out / f"{k}.ecsv", dict(task.point), n_found=30 - 8 * k) for k, task in enumerate(tasks[:2]))
    failed = ((tasks[2], "RuntimeError: " + "a reason without a space to break at ".replace(" ", "_") * 4),)
    write_results(campaign, CampaignResult(done=2, skipped=0, failed=failed, shards=shards, wall_s=1.0), out)
    return {"compare": out / "compare.html", "campaign": out / "campaign.html", "bench": out / "report.html"}


def shard(path: Path, point: dict[str, Any], n_found: int) -> Path:
    """Table of a task: 40 objects with a trail each, the brightest found."""
    n = 40
    size_m = np.geomspace(2e-3, 0.4, n)
    found = np.arange(n) >= n - n_found
    table = Table({"frame": np.arange(n) % 4, "object_id": np.arange(n), "snr": np.geomspace(4.0, 80.0, n)})
    table["length_px"], table["rate_deg_s"], table["range_km"], table["mag"] = 100.0, 1.0, np.geomspace(2.0, 900.0, n), 12.0
    table["size_m"], table["weight"], table["kind"], table["detected_onboard"] = size_m, 0.01, "population", found
    table["detected_ground"] = found
    none = np.zeros(0)
    counted = Counted(
        size_m=size_m, weight=np.full(n, 0.01), range_km=np.asarray(table["range_km"]), category=np.where(found, 3, -1),
        surplus=none.astype(int), surplus_frame=none.astype(int), n_frames=4,
    )  # fmt: skip
    table.meta = {
        "frames": "one", "point": json.dumps(point), "n_frames": 4, "frame_rate_hz": 4.0, "n_false_ground": 1,
        "downlink_bytes": 40_000, "field_deg": 10.0, "notes": ["a note"], "found": found.tolist(), "counted": counted.as_lists(),
    }  # fmt: skip
    table.write(path, format="ascii.ecsv")
    return path


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["compare", "campaign", "bench"])
@pytest.mark.slow
def test_pages_fit(chromium: Any, pages: dict[str, Path], name: str, width: int, scheme: str) -> None:
    assert excess_and_errors(chromium, pages[name], width, scheme) == (0, [])


def test_a_comparison_begins_with_its_verdict(chromium: Any, pages: dict[str, Path]) -> None:
    tab = chromium.new_page()
    tab.goto(pages["compare"].as_uri())
    first = tab.locator("main > *").first.inner_text()
    assert first.startswith("line_integral finds 20 of 100 streaks with S/N >= 5 more than my_lab.nets:StreakNetWithALongName")
    assert tab.locator("a[href='runs/0123456789abcdef/report.html']").count() == 2
    assert "False alarms of line_integral" in tab.inner_text("main")
    tab.close()


def test_a_campaign_shows_its_points_and_failures(chromium: Any, pages: dict[str, Path]) -> None:
    tab = chromium.new_page()
    tab.goto(pages["campaign"].as_uri())
    assert tab.locator("main svg").count() >= 5  # over the key once; completeness and N(> d) of both points
    assert "onboard.detector.n_sigma = 7.0" in tab.inner_text("main")
    assert "a_reason_without" in tab.locator("h2:has-text('Failed tasks') + *").inner_text()
    tab.close()
