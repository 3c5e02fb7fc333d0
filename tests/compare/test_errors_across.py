"""Errors across the trail over their bounds, as a comparison shows them: those of the score."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.compare.compare import _cross_ratios
from sboc_e2e.score.bounds import TrailBounds
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.matching import TruthStreak
from sboc_e2e.score.trail import TruePath

HALF_PX = 60.0
SAGITTA_PX = 5.0
BOUND_PX = 0.05


def arc(index: int, snr: float) -> TruthStreak:
    """A parabola along the columns that its sagitta bends towards larger rows."""
    x = np.linspace(-1.0, 1.0, 201)
    path = TruePath(
        row=100.0 + SAGITTA_PX * (1.0 - x**2), col=200.0 + HALF_PX * x, flux_e_s=np.ones(len(x)), duration_s=1.0,
        sigma_px=0.9, edge0=False, edge1=False,
    )  # fmt: skip
    return TruthStreak(
        index=index, frame=0, object_id=index, path=path, snr=snr, length_px=2.0 * HALF_PX, rate_deg_s=1.0, attainable_end_px=0.1
    )


def evaluation(shift_px: list[float], sagitta_px: list[float], snr: list[float], accepted: list[int]) -> Any:
    n = len(shift_px)
    rows = [
        {"row0": 100.0 + d, "col0": 200.0 - HALF_PX, "row1": 100.0 + d, "col1": 200.0 + HALF_PX, "sagitta_px": s,
         "sigma_cross_px": BOUND_PX, "flags": 0}
        for d, s in zip(shift_px, sagitta_px, strict=True)
    ]  # fmt: skip
    bound = TrailBounds(cross_px=BOUND_PX, end0_px=0.1, end1_px=0.1, angle_rad=1e-3, flux_relative=0.05, attainable_end_px=0.1)
    made = SimpleNamespace(
        streaks=Table(rows=rows), pairs={k: arc(k, snr[k]) for k in range(n)}, bounds=dict.fromkeys(range(n), bound),
        accepted=accepted,
    )  # fmt: skip
    made.measured = Evaluation.measured.fget(made)  # type: ignore[attr-defined]
    return made


def test_a_perfect_fit_of_an_arc_has_no_error() -> None:
    assert _cross_ratios(evaluation([0.0], [SAGITTA_PX], [20.0], [0])) == pytest.approx([0.0], abs=1e-6)


def test_an_arc_moved_as_a_whole_is_off_by_its_shift() -> None:
    (ratio,) = _cross_ratios(evaluation([3.0 * BOUND_PX], [SAGITTA_PX], [20.0], [0]))
    assert abs(ratio) == pytest.approx(3.0, rel=1e-3)


def test_an_arc_fitted_as_its_chord_is_off_by_two_thirds_of_the_sagitta() -> None:
    (ratio,) = _cross_ratios(evaluation([0.0], [0.0], [20.0], [0]))
    assert abs(ratio) == pytest.approx(2.0 / 3.0 * SAGITTA_PX / BOUND_PX, rel=1e-3)


def test_vetoed_and_faint_streaks_do_not_count() -> None:
    e = evaluation([0.0, 1.0, 0.0], [SAGITTA_PX] * 3, [20.0, 20.0, 7.0], accepted=[0, 2])
    assert _cross_ratios(e) == pytest.approx([0.0], abs=1e-6)
