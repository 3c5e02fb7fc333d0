"""A sky without any object has no completeness; what the choices see falsely in it is compared all the same."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sboc_e2e.compare.compare import _curves
from sboc_e2e.compare.paired import Outcomes
from tests.end_to_end.conftest import TINY, command

NAMES = ("line_integral", "threshold")


def outcomes(snr: list[float]) -> Outcomes:
    """Streaks that each choice found."""
    n = len(snr)
    found = {name: np.ones(n, dtype=bool) for name in NAMES}
    return Outcomes(snr=np.array(snr), length_px=np.full(n, 20.0), cluster=np.arange(n), found=found)


def test_completeness_is_drawn_where_there_is_something_to_find() -> None:
    """Nothing found of nothing is no curve: the axis would have no limits."""
    for snr, titles in (([], []), ([9.0, 30.0], ["Completeness", "Free-response curve"])):
        e: Any = SimpleNamespace(shape=(64, 64), truth_tables={"streaks": {"psf_sigma_px": np.full(len(snr), 0.9)}})
        drawn = _curves([e], outcomes(snr), {name: [[0.5, 0.0]] for name in NAMES})
        assert list(drawn) == titles
        assert all(svg.startswith("<svg") and "nan" not in svg for svg in drawn.values())


def test_a_first_seed_without_a_streak_leaves_the_curves_to_the_others() -> None:
    skies: Any = [SimpleNamespace(shape=(64, 64), truth_tables={"streaks": {"psf_sigma_px": np.full(n, 0.9)}}) for n in (0, 2)]
    free_response = {name: [[0.5, 0.0]] for name in NAMES}
    assert _curves(skies, outcomes([9.0, 30.0]), free_response) == _curves(skies[1:], outcomes([9.0, 30.0]), free_response)


@pytest.mark.slow
def test_a_comparison_of_a_blank_sky_ends_with_its_page(tmp_path: Path) -> None:
    """Four small frames of stars and noise."""
    scenario, out = tmp_path / "blank.toml", tmp_path / "versus"
    scenario.write_text(TINY.replace("candidates = 2000", "classes = []") + "[objects]\npassing = []\norbit = []\n")
    choices = [word for name in NAMES for word in ("--use", name)]
    done = command("compare", str(scenario), "--seam", "onboard.detector", *choices, "--out", str(out))
    assert done.returncode == 0, done.stderr
    result = json.loads((out / "compare.json").read_text())
    assert result["n_truth"] == 0
    for choice in result["choices"].values():
        assert choice["completeness_snr8"]["value"] is None
        assert choice["false_per_frame"]["value"] is not None
    page = (out / "compare.html").read_text()
    assert "no truth streak; false per frame" in page
    assert "There is no truth streak." in page
