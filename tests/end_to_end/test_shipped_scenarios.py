"""Every scenario that comes with the project runs as shipped, and its score stays within stored bounds (slow).

Bounds are the ends of the 90 % intervals of the stored runs (docs/scenarios.md), except for those whose stars trail: theirs
are what is asked of them. They run in the order of their names, one process each.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from sboc_e2e.bench.scenario_page import STORED_RUNS, page
from tests.benchmarks.bench_scenarios import measured, shipped

BOUNDS: dict[str, dict[str, float]] = json.loads((Path(__file__).parent / "scenario_bounds.json").read_text())


def test_every_scenario_has_bounds_and_a_stored_run() -> None:
    assert set(BOUNDS) == set(shipped())
    assert set(json.loads(STORED_RUNS.read_text())) == set(shipped())


def test_the_page_of_scenarios_is_current() -> None:
    stored = Path(__file__).resolve().parents[2] / "docs" / "scenarios.md"
    assert stored.read_text(encoding="utf-8") == page(), "run: python -m sboc_e2e.bench.scenario_page docs/scenarios.md"


def within(figures: dict[str, Any], bounds: dict[str, float]) -> list[str]:
    """What is outside its bound, in words."""
    found = []
    for name, figure, sign in (
        ("least_completeness", "completeness", 1),
        ("most_false_per_frame", "false_per_frame", -1),
        ("least_linked", "linking_completeness", 1),
    ):
        value = figures[figure]["value"]
        if name in bounds and (value is None or sign * (value - bounds[name]) < 0):
            found.append(f"{figure} {value}, bound {bounds[name]}")
    return found


def test_a_figure_outside_its_bound_is_named() -> None:
    figures = {"completeness": {"value": 0.5}, "false_per_frame": {"value": 0.2}, "linking_completeness": {"value": None}}
    bounds = {"least_completeness": 0.6, "most_false_per_frame": 0.1}
    assert within(figures, bounds) == ["completeness 0.5, bound 0.6", "false_per_frame 0.2, bound 0.1"]
    assert within(figures, {"least_linked": 0.1}) == ["linking_completeness None, bound 0.1"]


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(BOUNDS))
def test_a_scenario_keeps_its_score(name: str) -> None:
    assert within(measured(name), BOUNDS[name]) == []
