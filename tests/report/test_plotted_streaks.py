"""Plots of a report show the streaks that the figures beside them count, and no others."""

from pathlib import Path
from typing import Any

import pytest

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.report import plots
from sboc_e2e.report.write import html
from sboc_e2e.score import score_evaluation
from tests.score.conftest import Synthetic


def test_vetoed_streaks_are_in_no_plot_as_in_no_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of twelve streaks on their trails two are vetoed: ten magnitudes, ten residuals, and none of the two."""
    synthetic, vetoed = Synthetic(4), {0, 5}
    streaks = synthetic.perfect_streaks()
    streaks["flags"][sorted(vetoed)] |= int(StreakFlag.VETOED)
    for end in ("0", "1"):
        streaks[f"ra{end}_deg"], streaks[f"dec{end}_deg"] = streaks["ra_mid_deg"], streaks["dec_mid_deg"]
    plotted: dict[str, list[dict[str, Any]]] = {}
    for name in ("residuals", "magnitudes"):
        monkeypatch.setattr(plots, name, lambda rows, name=name: plotted.update({name: rows}) or "")
    evaluation = synthetic.evaluation(streaks)
    score = score_evaluation(evaluation)
    html(score, evaluation, tmp_path)
    for rows in plotted.values():
        assert {int(row["row"]) for row in rows} == set(range(12)) - vetoed
    assert len(plotted["magnitudes"]) == score["photometry"]["bias_mag"]["n"]
    assert len(plotted["residuals"]) == score["astrometry"]["cross_rms_px"]["n"]
