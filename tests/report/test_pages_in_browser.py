"""Comparison, campaign and benchmark pages in a real Chromium: they fit a phone and a wide screen, light and dark."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sboc_e2e.bench.entries import Entry
from sboc_e2e.bench.pages import write_pages as write_bench
from sboc_e2e.compare.pages import write_pages as write_compare
from sboc_e2e.score.figures import figure

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA="


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("no Chromium installed (package chromium)")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"])
        yield made
        made.close()


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
    return {"compare": out / "compare.html", "bench": out / "report.html"}


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1000, 1600])
@pytest.mark.parametrize("name", ["compare", "bench"])
def test_pages_fit(browser: Any, pages: dict[str, Path], name: str, width: int, scheme: str) -> None:
    tab = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(pages[name].as_uri())
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert errors == []
    tab.close()


def test_a_comparison_begins_with_its_verdict(browser: Any, pages: dict[str, Path]) -> None:
    tab = browser.new_page()
    tab.goto(pages["compare"].as_uri())
    first = tab.locator("main > *").first.inner_text()
    assert first.startswith("line_integral finds 20 of 100 streaks with S/N >= 5 more than my_lab.nets:StreakNetWithALongName")
    assert tab.locator("a[href='runs/0123456789abcdef/report.html']").count() == 2
    assert "False alarms of line_integral" in tab.inner_text("main")
    tab.close()
