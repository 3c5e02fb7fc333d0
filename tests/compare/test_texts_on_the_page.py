"""Names and notes of the user stand on the page of a comparison as they are written."""

from pathlib import Path
from typing import Any

from sboc_e2e.compare.pages import write_pages
from sboc_e2e.score.figures import absent, figure

NAMES = ("my_lab:Net<A>", "my_lab:Net<B>")


def test_names_of_choices_are_no_tags(tmp_path: Path) -> None:
    value = figure(0.5, 20, 0.4, 0.6)
    names_of = ("completeness_snr8", "snr50", "false_per_frame", "false_unflagged_per_frame", "cross_crlb_ratio",
                "cross_crlb_robust", "median_cpu_ms_per_frame")  # fmt: skip
    choice: dict[str, Any] = dict.fromkeys(names_of, value)
    choice |= {"cpu_ms_per_frame": 10.0, "downlink_bits_per_frame": 5e4, "notes": ["<i>why</i>"]}
    first, second = NAMES
    mcnemar = {"only_second": 0, "only_first": 1, "objects_disagreeing": 1, "p_value": 1.0}
    result = {
        "scenario": "smoke", "seam": "onboard.detector", "seeds": 1, "n_frames": 6, "n_truth": 20, "splits": [],
        "choices": dict.fromkeys(NAMES, choice), "runs": {name: ["runs/0123456789abcdef"] for name in NAMES},
        "pairs": [{"first": first, "second": second, "difference": absent("no truth streak"), "mcnemar": mcnemar}],
        "questions": [{"figure": "x", "label": "completeness", "choices": dict.fromkeys(NAMES, value)}],
    }  # fmt: skip
    case = {"picture": "data:,", "snr": 9.0, "length_px": 20.0, "frame": 1, "found": first, "lost": second}
    write_pages(result, {}, [case], {first: [], second: []}, tmp_path)
    page = (tmp_path / "compare.html").read_text()
    assert "found by my_lab:Net&lt;A&gt;, lost by my_lab:Net&lt;B&gt;" in page
    assert not [tag for tag in ("<A>", "<B>", "<i>") if tag in page]
