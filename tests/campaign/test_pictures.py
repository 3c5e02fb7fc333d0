"""Axes of a campaign's pictures, what its map counts, and texts of the user on its page."""

import json
from pathlib import Path
from typing import Any

import pytest
from astropy.table import Table

from sboc_e2e.campaign import CampaignResult, pages, read_campaign
from sboc_e2e.campaign.pictures import _counts, _measured, over_keys

NONE: dict[str, Any] = {"completeness_snr8": 0.5, "false_per_frame": 0.1, "downlink_bytes_per_frame": 1e4}


@pytest.mark.parametrize(
    ("values", "numbers", "unit"),
    [
        (["50 cm", "1 m", "200 mm"], [50.0, 100.0, 20.0], "cm"),
        (["5 min", "30 s"], [5.0, 0.5], "min"),
        (["0.05 Mbit / s", "100 kbit / s"], [0.05, 0.1], "Mbit / s"),
        ([6, 7.5], [6.0, 7.5], ""),
        (["6", 7.5], [6.0, 7.5], ""),
    ],
)
def test_values_are_drawn_in_the_unit_of_the_first(values: list[Any], numbers: list[float], unit: str) -> None:
    measured = _measured(values)
    assert measured is not None
    assert measured[0] == pytest.approx(numbers, rel=1e-12)
    assert measured[1] == unit


@pytest.mark.parametrize(
    "values",
    [
        ["50 cm", "1 s"],
        ["50 cm", 2.0],
        [True, False],
        [1, True],
        ["line_integral", "lsd"],
        [[1, 2], [3]],
        [[3], [4]],
        [1.0, float("inf")],
    ],
)
def test_values_of_no_common_dimension_are_categories(values: list[Any]) -> None:
    assert _measured(values) is None
    assert (over_keys([({"key": value}, NONE) for value in values]) or "").startswith("<svg")


def test_lists_and_truth_values_have_cells_of_their_own() -> None:
    points = [({"a": a, "b": b}, NONE) for a in ([1, 2], [3]) for b in (1, True)]
    assert (over_keys(points) or "").startswith("<svg")


def test_a_map_without_any_value_says_so() -> None:
    """As where no point has an object of S/N 8: NaN has neither a least value nor a scale, and numpy warns of it."""
    nothing = {"value": None, "low": None, "high": None, "n": 0}
    points = [({"a": a, "b": b}, dict.fromkeys(NONE, nothing)) for a in (1, 2) for b in (3, 4)]
    empty = over_keys(points)
    full = over_keys([(values, NONE) for values, _ in points])
    assert empty is not None
    assert full is not None
    assert (empty.count("nothing measured"), full.count("nothing measured")) == (3, 0)


def test_streaks_that_nobody_can_see_do_not_count_as_missed() -> None:
    """Three streaks of one cell: S/N 2 missed, 4 found, 9 missed."""
    table = Table({"snr": [2.0, 4.0, 9.0], "size_m": [0.03] * 3, "range_km": [200.0] * 3})
    table["detected_ground"] = [False, True, False]
    all_n, hit_n = _counts([table])
    assert (all_n.sum(), all_n.max(), hit_n.sum()) == (2, 2, 1)


def test_texts_of_the_user_are_shown_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "campaign.toml"
    path.write_text('scenario = "smoke"\ndescription = "S/N < 3 & <script>a</script>"\n[vary]\nx = ["<b>", "c"]\n')
    summary = NONE | {
        "notes": ["<i>why</i>"], "snr50": {"value": None, "n": 0}, "completeness_snr8": {"value": None, "n": 0},
        "false_per_frame": {"value": None, "n": 0},
        "per_day": {"size_classes": [], "larger_than": [], "false_per_day": {"value": None, "n": 0}}
        | {name: {"value": None, "n": 0} for name in ("injected_slope", "recovered_slope")},
    }  # fmt: skip
    points = {json.dumps({"x": x}): [] for x in ("<b>", "c")}
    monkeypatch.setattr(pages, "read_shards", lambda shards: points)
    monkeypatch.setattr(pages, "summarise", lambda shards: summary)
    monkeypatch.setattr(pages, "against_first", lambda found: {})
    monkeypatch.setattr(pages, "heat_map", lambda shards: "")
    pages.write_results(read_campaign(path), CampaignResult(done=2, skipped=0, failed=(), shards=(), wall_s=1.0), tmp_path)
    page = (tmp_path / "campaign.html").read_text()
    body = page[page.index("<main>") : page.index("</main>")]
    assert "<p>S/N &lt; 3 &amp; &lt;script&gt;a&lt;/script&gt;</p>" in body
    assert "<h2>x = &lt;b&gt;</h2>" in body
    assert "&lt;i&gt;why&lt;/i&gt;" in body
    assert not [tag for tag in ("<script>", "<b>", "<i>") if tag in body]
