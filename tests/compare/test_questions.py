"""Each seam is asked for the figures that its step decides; seeds are joined; verdicts of seams that find nothing."""

from typing import Any

import numpy as np
import pytest

from sboc_e2e.compare.pages import question_rows, seam_verdict
from sboc_e2e.compare.paired import Outcomes
from sboc_e2e.compare.questions import QUESTIONS, answers, joined
from sboc_e2e.compare.splits import splits
from sboc_e2e.registry import SEAMS
from sboc_e2e.score.figures import absent, figure, proportion


def test_every_seam_is_asked_something() -> None:
    assert set(QUESTIONS) == set(SEAMS)


def test_a_linker_is_asked_for_purity_completeness_and_fragments() -> None:
    score = {"linking": {name: figure(0.9, 10, 0.8, 1.0) for name in ("completeness", "purity", "fragments_per_object")}}
    asked = answers("ground.linker", {"motion": [score]})
    assert [q["figure"] for q in asked][:3] == ["linking.completeness", "linking.purity", "linking.fragments_per_object"]
    assert asked[0]["choices"]["motion"]["value"] == 0.9


def test_seeds_are_joined_by_n() -> None:
    """Two runs of the same size: the mean, and an interval narrower by the root of two."""
    both = joined([figure(1.0, 10, 0.9, 1.1), figure(2.0, 10, 1.9, 2.1)])
    assert (both["value"], both["n"]) == (1.5, 20)
    assert both["high"] - both["value"] == pytest.approx(0.1 / np.sqrt(2))
    assert joined([absent("why", 0), figure(2.0, 5, 1.0, 3.0)])["value"] == 2.0
    assert joined([absent("why"), absent("why")])["reason"] == "why"


def compared(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    cost = {"median_cpu_ms_per_frame": figure(10.0, 6, 10.0, 10.0)}
    return {
        "seam": "onboard.codec",
        "choices": {"a": cost, "b": cost},
        "pairs": [{"first": "a", "second": "b"}],
        "questions": [{"figure": "x", "label": "bits per streak", "choices": {"a": first, "b": second}}],
    }


def test_a_verdict_names_the_figure_that_tells_them_apart() -> None:
    apart = seam_verdict(compared(figure(4000.0, 9, 3900.0, 4100.0), figure(3000.0, 9, 2900.0, 3100.0)))
    assert apart == [
        "a and b differ: bits per streak 4,000  [3,900, 4,100] with a, 3,000  [2,900, 3,100] with b; "
        "CPU 10 against 10 ms in the median frame."
    ]
    alike = compared(figure(4000.0, 9, 3000.0, 5000.0), figure(3900.0, 9, 2900.0, 4900.0))
    assert seam_verdict(alike)[0].startswith("No figure of this step tells a from b")
    missing = compared(absent("no streak"), absent("no streak"))
    assert seam_verdict(missing) == ["a and b: no figure of this step could be measured here."]
    assert question_rows(missing) == [["bits per streak", "- (no streak)", "- (no streak)"]]


def test_a_third_choice_without_a_figure_silences_no_other_pair() -> None:
    result = compared(figure(4000.0, 9, 3900.0, 4100.0), figure(3000.0, 9, 2900.0, 3100.0))
    result["choices"]["c"] = result["choices"]["a"]
    result["questions"][0]["choices"]["c"] = absent("no streak")
    result["pairs"] = [{"first": x, "second": y} for x, y in (("a", "b"), ("a", "c"), ("b", "c"))]
    assert [line.partition(":")[0] for line in seam_verdict(result)] == ["a and b differ", "a and c", "b and c"]


def test_completeness_is_split_by_snr_and_length() -> None:
    outcomes = Outcomes(
        snr=np.array([4.0, 7.0, 30.0, 30.0]),
        length_px=np.array([5.0, 5.0, 30.0, 200.0]),
        cluster=np.arange(4),
        found={"a": np.array([False, False, True, True]), "b": np.array([True, True, True, False])},
    )
    found = {(s["quantity"][:3], s["bin"]): s for s in splits(outcomes, ["a", "b"])}
    assert found["S/N", "25 to 100"]["choices"]["b"] == proportion(1, 2)
    assert found["S/N", "3 to 6"]["n"] == 1
    assert found["len", "0 to 10"]["n"] == 1  # the streak of S/N 4 is not judged by length
    assert found["len", "above 150"]["choices"]["a"]["value"] == 1.0
