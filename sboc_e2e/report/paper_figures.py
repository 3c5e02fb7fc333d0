"""Figures 5 to 8 of the paper on the ART/SPOOK image simulator, remade: ``sboc figure 7``.

The paper says of figure 5 that a streak is curved and varies by 40 % in one exposure, and of figure 7 what seven streaks look
like under both shutters. Of figures 6 and 8 we know the subject of their sections only: rows that open one after the other,
and particle hits.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.report.pictures import stretch
from sboc_e2e.report.plots import BLUE, INK, ORANGE
from sboc_e2e.scenario import load
from simulator.chain import Simulator

_STYLE: Final[dict[Any, Any]] = {"font.size": 9, "axes.edgecolor": INK, "axes.titlesize": 10}
_DPI: Final = 110  # Dots per inch: a figure of nine inches is 990 px wide, a page of README.md. Chosen.
CURVED_FRAME: Final = 2  # Frame of `curved_streak` whose trail lies wholly inside; the scenario's seed is fixed.
_PROFILE_HALF_PX: Final = 5.0
"""Light within this distance of the path is summed: six PSF sigmas of `sboc_like`, all of a trail's light."""
_PROFILE_COLS: Final = 31
"""Light along a trail is summed over this many rows to both sides; its running median leaves out stars."""
PARTICLE_WINDOW_PX: Final = 256  # A part in which single tracks can be seen; a frame of 4096 px has 256 of them.


def simulator_of(scenario: str, *overrides: str) -> Simulator:
    """A simulator of a shipped scenario with keys changed, over the embedded catalogue."""
    made = load(scenario, registry=Registry(), overrides=overrides)
    return Simulator(made.simulator, seed=made.seed, catalogue=StarCatalogue.embedded())


def _show(ax: Any, image: NDArray[Any], title: str, first: tuple[int, int] = (0, 0), top_sigma: float = 60.0) -> None:
    """An image with its own rows and columns on the axes, row 0 at the top."""
    low, left = first[0] - 0.5, first[1] - 0.5
    extent = (left, left + image.shape[1], low + image.shape[0], low)
    ax.imshow(stretch(image.astype(np.float32), top_sigma=top_sigma), cmap="gray", extent=extent, interpolation="nearest")
    ax.set_title(title)
    ax.set_xlabel("column")


def curved() -> Canvas:
    """Figure 5: a trail that bends and varies by 40 %, and its light along the columns."""
    frame, truth = simulator_of("curved_streak").frame(CURVED_FRAME)
    streak = truth.streaks[0]
    low, high = sorted((int(streak["col0"]), int(streak["col1"])))
    middle = int(0.5 * (streak["row0"] + streak["row1"]))
    rows, cols = slice(middle - 60, middle + 60), slice(low - 60, high + 60)
    part = frame.pixels[rows, cols].astype(np.float64)
    figure = Canvas(figsize=(9.0, 4.6), layout="constrained")
    above, below = figure.subplots(2, 1)
    sagitta = abs(float(streak["sagitta_px"]))
    title = f"one exposure of 0.2 s: bends by {sagitta:.1f} px, brightness varies by 40 % of its mean"
    _show(above, part, title, (rows.start, cols.start), top_sigma=400.0)
    chord = np.interp(np.arange(cols.start, cols.stop), [streak["col0"], streak["col1"]], [streak["row0"], streak["row1"]])
    above.plot(np.arange(cols.start, cols.stop), chord - 12.0, color=ORANGE, linewidth=0.8, label="straight, shifted by 12 px")
    above.set_aspect("auto")
    above.set_ylabel("row")
    above.legend(loc="lower right", fontsize=8)
    path_row = np.interp(np.arange(cols.start, cols.stop), *(streak[f"path_{axis}"][_rising(streak)] for axis in ("col", "row")))
    near = np.abs(np.arange(rows.start, rows.stop)[:, None] - path_row) < _PROFILE_HALF_PX
    light = (frame.header.gain_e_adu or 1.0) * np.where(near, part - np.median(part), 0.0).sum(axis=0)
    below.plot(np.arange(cols.start, cols.stop), median_filter(light, _PROFILE_COLS), color=BLUE, linewidth=0.9)
    below.set_xlabel("column")
    below.set_ylabel("electrons per column\n(running median of 31)")
    below.set_xlim(above.get_xlim())
    return figure


def _rising(streak: np.void) -> NDArray[np.intp]:
    """Order of a streak's path points by column."""
    return np.argsort(streak["path_col"])


def row_times() -> Canvas:
    """Figure 6: when each row is open, and where streaks 6 and 7 of the next figure stand then."""
    simulator = simulator_of("shutter_seven_streaks")
    options = simulator.options
    rows = np.arange(options.instrument.rows)
    exposure_ms = 1e3 * options.shutter.exposure_s
    delay_ms = 1e-3 * options.shutter.line_time_us * (rows - 0.5 * (rows.size - 1))
    figure = Canvas(figsize=(9.0, 4.0), layout="constrained")
    panels = (("global shutter", 0.0 * delay_ms), ("rolling shutter", delay_ms))
    for ax, (title, opens) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
        ax.fill_betweenx(rows, opens, opens + exposure_ms, color=INK, alpha=0.25, linewidth=0.0, label="row is open")
        for thing, colour in zip(options.objects.pixel_path[5:], (BLUE, ORANGE), strict=True):
            time_ms = np.linspace(-80.0, 280.0, 4000)
            row = thing.row_px + thing.row_rate_px_s * 1e-3 * time_ms
            open_ms = np.interp(row, rows, opens)
            lit = (time_ms >= open_ms) & (time_ms <= open_ms + exposure_ms) & (row >= 0.0) & (row <= rows[-1])
            ax.plot(time_ms, row, color=colour, linewidth=0.7, alpha=0.6)
            ax.plot(time_ms[lit], row[lit], color=colour, linewidth=2.2, label=f"{thing.name}: {np.ptp(row[lit]):.0f} rows")
        ax.set_xlim(-80.0, 280.0)
        ax.set_ylim(rows[-1], 0)
        ax.set_title(title)
        ax.set_xlabel("ms after the middle row opens")
        ax.legend(loc="upper right", fontsize=7)
    figure.axes[0].set_ylabel("row")
    return figure


def seven_streaks() -> Canvas:
    """Figure 7: the same seven movers under a global and a rolling shutter."""
    figure = Canvas(figsize=(9.0, 4.8), layout="constrained")
    panels = (("global shutter", ('shutter.line_time="0 us"',)), ("rolling shutter, 100 us a row", ()))
    for ax, (title, overrides) in zip(figure.subplots(1, 2), panels, strict=True):
        frame, truth = simulator_of("shutter_seven_streaks", *overrides).frame(0)
        _show(ax, frame.pixels, title)
        for number, streak in enumerate(truth.streaks, start=1):
            ax.text(streak["col1"] + 12.0, streak["row1"], str(number), color=ORANGE, fontsize=8, va="center")
    figure.axes[0].set_ylabel("row")
    return figure


def particles() -> Canvas:
    """Figure 8: particle hits of one exposure over the pole, in the anomaly, and in the electron belt's horn."""
    figure = Canvas(figsize=(9.0, 3.7), layout="constrained")
    places = (
        ("pole, 10 mm of Al", 'radiation.environment="polar"', 'radiation.shield="10 mm"'),
        ("anomaly, 10 mm of Al", 'radiation.environment="saa"', 'radiation.shield="10 mm"'),
        ("electron belt, 3 mm of Al", 'radiation.environment="horn"', 'radiation.shield="3 mm"'),
    )
    for ax, (title, *overrides) in zip(figure.subplots(1, 3), places, strict=True):
        frame, truth = simulator_of("sso_antisun", "psf.preset=ideal", *overrides).frame(0)
        part = frame.pixels[:PARTICLE_WINDOW_PX, :PARTICLE_WINDOW_PX]
        _show(ax, part, f"{title}\n{int(truth.frame['n_cosmics'][0]):,} tracks in the frame")
    figure.axes[0].set_ylabel("row (one of 256 such parts)")
    return figure


FIGURES: Final[dict[int, Callable[[], Canvas]]] = {5: curved, 6: row_times, 7: seven_streaks, 8: particles}


def write_figure(number: int, folder: Path) -> Path:
    """One figure as a PNG file, `figure_<number>.png`; the folder is made if it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"figure_{number}.png"
    with mpl.rc_context(_STYLE):
        FIGURES[number]().savefig(path, dpi=_DPI, metadata={"Software": None})
    return path
