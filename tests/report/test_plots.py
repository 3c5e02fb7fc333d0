"""Plots of the report: what their axes say."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from astropy.table import Table
from matplotlib.figure import Figure

from sboc_e2e.report import plots
from sboc_e2e.score.astrometry import frame_astrometry

PIXEL_DEG = 5.0 / 3600.0


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [
        (8.0, 300.0, [10, 20, 50, 100, 200]),
        (4.0, 2000.0, [10, 30, 100, 300, 1000]),
        (2.0, 60000.0, [10, 100, 1000, 10000]),
        (150.0, 900.0, [200, 500]),
    ],
)
def test_a_logarithmic_axis_has_as_many_ticks_as_fit(low: float, high: float, wanted: list[int]) -> None:
    with plots.canvas() as (_, (ax,)):
        ax.set(xscale="log", xlim=(low, high))
        plots.plain_logarithmic(ax.xaxis)
        ticks = [tick for tick in ax.get_xticks() if low <= tick <= high]
        np.testing.assert_allclose(ticks, wanted)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Makes a plot and returns its figure, laid out, in place of its text."""
    figures: list[Figure] = []
    monkeypatch.setattr(plots, "svg", lambda figure: figures.append(figure) or "")

    def make(plot: Callable[..., str], *args: Any) -> Figure:
        plot(*args)
        figures[-1].draw_without_rendering()
        return figures[-1]

    return make


def _frame_of(number: int, scale: float, turn_deg: float) -> tuple[Table, Table]:
    """A solved frame and its truth: east is left and north up at 0 deg; the solution's field is larger by `scale`."""
    row, col = (g.ravel() for g in np.meshgrid(np.linspace(0.0, 800.0, 9), np.linspace(0.0, 800.0, 9), indexing="ij"))
    x, y = (400.0 - col) * PIXEL_DEG, (400.0 - row) * PIXEL_DEG
    turn = np.radians(turn_deg)
    east, north = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    truth, solved = (
        Table({"frame": [number], "flags": [0], "grid_row": [row], "grid_col": [col],
               "grid_ra_app_deg": [100.0 + by * east], "grid_dec_app_deg": [by * north]})
        for by in (1.0, scale)
    )  # fmt: skip
    return solved, truth


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 210.0])
@pytest.mark.parametrize("scale", [1.001, 0.999])
def test_a_wrong_scale_of_the_frame_solution_points_away_from_the_middle_of_the_picture(
    drawn: Callable[..., Any], scale: float, turn_deg: float
) -> None:
    """A solution that is too large has every star further out than it is: arrows point outwards, on the page as in the frame."""
    _, grids = frame_astrometry(*_frame_of(0, scale, turn_deg))
    (ax,) = drawn(plots.frame_vectors, grids).axes
    arrows = ax.collections[0]
    places = ax.transData.transform(np.stack([grids[0]["col"], grids[0]["row"]], axis=-1))
    outwards = places - ax.transData.transform((400.0, 400.0))
    tips = np.array([each.vertices[np.argmax(np.hypot(*each.vertices.T))] for each in arrows.get_paths()])
    away = np.hypot(*outwards.T) > 1.0
    cosine = np.einsum("ij,ij->i", outwards, tips)[away] / (np.hypot(*outwards.T) * np.hypot(*tips.T))[away]
    np.testing.assert_allclose(cosine, 1.0 if scale > 1.0 else -1.0, atol=0.01)


def test_offsets_of_the_frame_solution_are_those_along_row_and_col() -> None:
    """Of a solution too large by 0.1 % the offset along col is 0.1 % of the distance from the middle, 0 there."""
    _, (grid,) = frame_astrometry(*_frame_of(0, 1.001, 30.0))
    for name in ("row", "col"):
        np.testing.assert_allclose(
            grid[f"along_{name}_arcsec"], 0.001 * (grid[name] - 400.0) * PIXEL_DEG * 3600.0, atol=2e-4 * 0.4 * PIXEL_DEG * 3600.0
        )


def test_ranges_of_orbits_are_named_by_their_tracklets(drawn: Callable[..., Any]) -> None:
    ids = [3, 17, 40]
    samples = Table({"tracklet_id": np.repeat(ids, 2), "range_km": np.full(6, 900.0), "a_km": np.full(6, 7e3)})
    samples["i_deg"] = np.arange(6.0)
    orbits = Table({"tracklet_id": ids, "range_low_km": [800.0] * 3, "range_km": [900.0] * 3, "range_high_km": [1e3] * 3})
    ax = drawn(plots.orbit_spread, samples, orbits, {}).axes[2]
    assert ax.get_yticks().tolist() == [0, 1, 2]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["3", "17", "40"]


@pytest.mark.parametrize("with_frame", [True, False])
def test_streaks_on_both_sides_of_ra_0_lie_beside_each_other(drawn: Callable[..., Any], with_frame: bool) -> None:
    ra0 = np.array([359.8, 359.98, 0.1])
    streaks = Table({"ra0_deg": ra0, "ra1_deg": (ra0 + 0.05) % 360.0, "dec0_deg": np.zeros(3), "dec1_deg": np.zeros(3)})
    streaks["tracklet_id"] = [0, 0, -1]
    solved, _ = _frame_of(0, 1.0, 0.0)
    solved["grid_ra_app_deg"] = (solved["grid_ra_app_deg"] + 260.05) % 360.0
    (ax,) = drawn(plots.tracklets_on_sky, streaks, solved if with_frame else solved[:0]).axes
    drawn_ra = np.concatenate([line.get_xdata() for line in ax.lines])
    assert np.ptp(drawn_ra) < 3.0
    ends = np.array([line.get_xdata() for line in ax.lines[-3:]])
    np.testing.assert_allclose(np.diff(ends, axis=1), 0.05)
    np.testing.assert_allclose(np.diff(ends[:, 0]), [0.18, 0.12])


def test_completeness_holds_the_brightest_streaks(drawn: Callable[..., Any]) -> None:
    """Every counted streak is in a bin: the shares times the counts of the bins sum to what was found."""
    snr = np.array([3.0, 5.0, 299.0, 300.0, 310.0, 2500.0, 2600.0, np.nan])
    (ax,) = drawn(plots.completeness, {"all": (snr, np.ones(8, bool))}, None).axes
    (line,) = (c.lines[0] for c in ax.containers)
    edges = 3.0 * 10.0 ** (np.arange(30) / 7)
    bins = {int(np.searchsorted(edges, s, side="right")) for s in snr[:-1]}
    assert {int(np.searchsorted(edges, x, side="right")) for x in line.get_xdata()} == bins
    assert line.get_xdata().max() > 2000.0
