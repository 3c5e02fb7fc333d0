"""The page of published files is that of the stored cases, and its figures are what they are called."""

from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.bench.product_page import LINES, page, summary


def test_the_page_is_current() -> None:
    stored = Path(__file__).resolve().parents[2] / "docs" / "products.md"
    assert stored.read_text(encoding="utf-8") == page(), "run: python -m sboc_e2e.bench.product_page docs/products.md"


def test_coverage_counts_angles_and_resamples_objects() -> None:
    """Objects of 10 angles that share their error: 0.683 within one sigma, to what 80 objects tell; shares are put together."""
    rng = np.random.default_rng(1)
    part = {"value": 0.5, "n": 4}
    cases = [
        {
            "part": "nadir_rotation", "seed": seed, "linked": {"value": linked, "n": 4},
            "angles": [[k, z, z, 20.0, 1, z] for k, z in enumerate(rng.standard_normal(40)) for _ in range(10)],
            "differs": part, "along_rms": part, "streaks_along_rms": part, "velocity": part, "light": [0.1],
        }
        for seed, linked in ((20005, 1.0), (20006, 0.5))
    ]  # fmt: skip
    made = {row["name"]: row["figure"] for row in summary(cases)}
    coverage = made["`nadir_rotation`: TDM angles along the motion within one stated sigma"]
    assert coverage["n"] == 800
    assert coverage["value"] == pytest.approx(0.683, abs=0.15)
    assert coverage["high"] - coverage["low"] == pytest.approx(2 * 1.645 * np.sqrt(0.683 * 0.317 / 80), rel=0.3)
    assert made["`nadir_rotation`: objects linked"]["value"] == 0.75
    assert made["`nadir_rotation`: objects linked, worst run"]["value"] == 0.5
    assert len(made) == len(LINES)
