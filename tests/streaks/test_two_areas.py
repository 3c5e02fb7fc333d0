"""Lines along the border of two areas, and trails on skies that are not even."""

from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import TrailedPsfFitter
from ground.vetting.two_areas import is_border
from sboc_e2e.icd.products import StreakFit
from tests.streaks.impostors import draw
from tests.streaks.lit_lines import EVEN, METEOR, SHAPE, judged, lit, placed, tiles


@pytest.fixture(scope="module")
def fit() -> StreakFit:
    """A line of 330 px, 1.5 px wide."""
    shot = draw("real", np.random.default_rng(5))
    drawn = replace(TrailedPsfFitter().fit(shot.pixels, shot.detection), sagitta_px=0.0, chi2_nu=1.0)
    return placed(drawn, (100.0, 150.0, 180.0, 470.0), 1.5, 90.0)


def above_the_line(fit: StreakFit) -> np.ndarray:
    """Distance of each pixel from the line, px, positive on one side."""
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    d_row, d_col = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
    return np.asarray((row - fit.row0) * d_col - (col - fit.col0) * d_row)


def test_a_bright_edge_of_the_ground_is_a_border(fit: StreakFit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three horizons had steps of 2.0 to 2.5 of the height of the light along them. Such a line stands out of both areas."""
    edge = lit(fit, EVEN, 40.0) + 22.0 * (above_the_line(fit) > 0.0)
    assert is_border(fit, tiles(edge, fit))
    assert judged((0.99,), [fit], edge)[0] == 0.0
    monkeypatch.setattr("ground.vetting.look_alikes.is_border", lambda *_: False)
    assert judged((0.99,), [fit], edge)[0] > 0.5


@pytest.mark.parametrize("peak", [2.0, 10.0, 200.0])
@pytest.mark.parametrize("light", [EVEN, METEOR])
def test_trails_on_any_slope_are_none(fit: StreakFit, peak: float, light: np.ndarray) -> None:
    """An even sky, twilight of 1 ADU a px, and vignetting that bends; a trail of a tenth of what the sky changes by beside it."""
    away = above_the_line(fit)
    for sky in (0.0, 1.0 * away, 0.01 * away**2 + 0.5 * away):
        assert not is_border(fit, tiles(lit(fit, light, peak) + sky, fit))


def test_what_is_not_seen_tells_nothing(fit: StreakFit) -> None:
    short = placed(fit, (100.0, 150.0, 104.0, 166.0), 1.5, 90.0)
    edge = lit(short, EVEN, 10.0) + 20.0 * (above_the_line(short) > 0.0)
    assert not is_border(short, tiles(edge, short)), "too short"
    outside = placed(fit, (-90.0, 150.0, -10.0, 470.0), 1.5, 90.0)
    assert not is_border(outside, tiles(edge, outside))
    assert not is_border(replace(fit, row1=fit.row0, col1=fit.col0), tiles(edge, fit)), "no length"
