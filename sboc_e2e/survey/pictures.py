"""Pictures of what a survey teaches."""

import io
from collections.abc import Sequence
from itertools import groupby
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sboc_e2e.survey.block import ALTITUDE_EDGES_KM, CLASS_EDGES_M, INCLINATION_EDGES_DEG
from sboc_e2e.survey.estimate import Flux
from sboc_e2e.survey.sensitivity import GROUPS, Setting

Array = NDArray[np.float64]

_STYLE: Final = {"font.size": 8, "axes.grid": True, "grid.alpha": 0.25}
SHOWN_EDGES: Final = (2, 3, 4)
"""Of the classes: larger than 1, 3 and 10 cm."""

HIGHEST_SHOWN_KM: Final = 2000.0  # The last shell reaches to 60,000 km; drawn so far it would leave no room for the others.
FEW: Final = 0.5
"""Half widths of intervals above this share of the value are drawn faintly."""


def flux_png(whole: Flux, altitude: Flux, inclination: Flux, shell: str) -> bytes:
    """N(> d) at the camera's height, and flux by altitude and inclination."""
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib's names of settings are a literal type
        figure = Figure(figsize=(11.0, 3.6), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        size_mm = 1e3 * np.array(CLASS_EDGES_M[:-1])
        _bars(left, size_mm, whole.total[:, 0], "0.65", None, 4.0)
        _bars(left, size_mm, whole.larger[:, 0], "C0", "survey, counting", 1.5)
        left.plot(size_mm, whole.true[:, 0], "k_", ms=10, label="injected")
        left.plot([], [], color="0.65", lw=4, label="with systematic term")
        left.set(xscale="log", yscale="log", xlabel="diameter d (mm)", ylabel="larger than d, per km2 and year", title=shell)
        left.legend(fontsize=7)
        for axes, flux, edges, label in (
            (middle, altitude, ALTITUDE_EDGES_KM, "altitude (km)"),
            (right, inclination, INCLINATION_EDGES_DEG, "inclination (deg)"),
        ):
            low = np.maximum(np.array(edges[:-1]), 300.0 if label.startswith("alt") else 0.0)
            high = np.minimum(np.array(edges[1:]), HIGHEST_SHOWN_KM)
            at = 0.5 * (low + high)
            for number, k in enumerate(SHOWN_EDGES):
                shift = (number - 1) * 0.12 * (high - low)
                _bars(axes, at + shift, flux.larger[k], f"C{number}", f"> {100 * CLASS_EDGES_M[k]:g} cm", 1.5)
                axes.hlines(flux.true[k], low, high, colors=f"C{number}", lw=0.8, alpha=0.6)
            axes.set(yscale="log", xlabel=label, title="lines: injected")
            axes.legend(fontsize=7)
        return _png(figure)


def _bars(axes: Any, at: Array, flux: Array, colour: str, label: str | None, width: float) -> None:
    """Intervals (n, 3) as bars."""
    known = np.isfinite(flux[:, 1]) & (flux[:, 1] > 0.0)
    low, middle, high = flux[known].T
    axes.errorbar(
        at[known], middle, (np.maximum(middle - low, 0.0), np.maximum(high - middle, 0.0)), fmt="o", ms=3, lw=width, color=colour,
        label=label,
    )  # fmt: skip


def convergence_png(curves: Sequence[tuple[str, float, float]], days: float) -> bytes:
    """Half widths of 90 % intervals over time. curves : name, relative half width of a survey of `days`, systematic floor."""
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib's names of settings are a literal type
        figure = Figure(figsize=(5.5, 3.6), layout="constrained")
        axes = figure.subplots()
        time = np.geomspace(0.5, 365.0, 100)
        for number, (name, width, floor) in enumerate(curves):
            counting = width * np.sqrt(days / time)
            axes.plot(time, 100.0 * counting, color=f"C{number}", label=name)
            axes.plot(time, 100.0 * np.hypot(counting, floor), ":", color=f"C{number}", lw=1)
        axes.axhline(10.0, color="k", lw=0.6)
        axes.set(xscale="log", yscale="log", xlabel="days", ylabel="half width of the 90 % interval (%)",
                 title="full: counting; dotted: with the systematic term")  # fmt: skip
        axes.legend(fontsize=7)
        return _png(figure)


def sensitivity_png(settings: Sequence[Setting]) -> bytes:
    """Tracklets a day over each key, on one page."""
    groups = [(key, list(items)) for key, items in groupby(settings, key=lambda s: s.key)]
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib's names of settings are a literal type
        figure = Figure(figsize=(11.0, 5.6), layout="constrained")
        for axes, (key, items) in zip(figure.subplots(2, (len(groups) + 1) // 2).ravel(), groups, strict=False):
            done = [s for s in items if s.per_day]
            for g, (low, high) in enumerate(GROUPS):
                axes.errorbar(
                    range(len(done)), [s.per_day[g] for s in done], [1.645 * s.error[g] for s in done], fmt="o-", ms=3, lw=1,
                    label=f"{1e3 * low:g} to {1e3 * high:g} mm",
                )  # fmt: skip
            axes.set(yscale="log", title=key, ylim=(5.0, 3e4))
            axes.set_xticks(range(len(done)), [s.value for s in done], rotation=20, fontsize=7)
        figure.axes[0].legend(fontsize=7)
        figure.axes[0].set_ylabel("tracklets a day")
        for axes in figure.axes[len(groups) :]:
            axes.set_axis_off()
        return _png(figure)


def _png(figure: Figure) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110, metadata={"Software": None})
    return data.getvalue()
