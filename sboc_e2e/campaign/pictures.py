"""Pictures of a campaign: completeness over size and range, headline figures over the varied keys, N(> d)."""

from collections.abc import Sequence
from typing import Any, Final

import astropy.units as u
import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.campaign.aggregate import RANGE_EDGES_KM, SIZE_EDGES_M
from sboc_e2e.report import plots
from sboc_e2e.report.words import number
from sboc_e2e.score.matching import SNR_IGNORED

HEADLINES: Final = (
    ("completeness_snr8", "completeness, S/N >= 8"),
    ("false_per_frame", "false per frame"),
    ("downlink_bytes_per_frame", "bytes per frame"),
)
LEAST_IN_CELL: Final = 1
"""A cell with one streak is shown: its number is written into it, so that the reader sees how little it says."""


def heat_map(shards: list[Table]) -> str:
    """Completeness of streaks with S/N >= 3 over size and range, cells with the number of streaks behind them."""
    all_n, hit_n = _counts(shards)
    with plots.canvas(5.6, 4.0) as (figure, (ax,)):
        ax.grid(visible=False)
        share = np.where(all_n >= LEAST_IN_CELL, hit_n / np.maximum(all_n, 1), np.nan)
        mesh = ax.pcolormesh(RANGE_EDGES_KM, SIZE_EDGES_M, share, vmin=0, vmax=1, cmap="viridis", rasterized=True)
        figure.colorbar(mesh, ax=ax, label="share of truth streaks detected")
        for i, j in np.argwhere(all_n >= LEAST_IN_CELL):
            x = np.sqrt(RANGE_EDGES_KM[j] * RANGE_EDGES_KM[j + 1])
            y = np.sqrt(SIZE_EDGES_M[i] * SIZE_EDGES_M[i + 1])
            ink = "white" if share[i, j] < 0.6 else "black"
            ax.text(x, y, f"{int(all_n[i, j])}", ha="center", va="center", fontsize=7, color=ink)
        ax.set(xscale="log", yscale="log", xlabel="range (km)", ylabel="size (m)")
        return plots.svg(figure)


def _counts(shards: list[Table]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Truth streaks that count, and those of them that ground found, by size and range; (sizes, ranges) each."""
    snr, size, distance = (np.concatenate([np.asarray(s[name], float) for s in shards]) for name in ("snr", "size_m", "range_km"))
    counted = snr >= SNR_IGNORED
    found = counted & np.concatenate([np.asarray(s["detected_ground"], bool) for s in shards])
    edges = (SIZE_EDGES_M, RANGE_EDGES_KM)
    all_n, hit_n = (np.histogram2d(size[chosen], distance[chosen], edges)[0] for chosen in (counted, found))
    return all_n, hit_n


def over_keys(points: Sequence[tuple[dict[str, Any], dict[str, Any]]]) -> str | None:
    """Headline figures over one varied key as curves with intervals, over two as heat maps; None for other campaigns.

    points : (values of the varied keys, summary) of each point.
    """
    keys = list(points[0][0]) if points else []
    if len(points) < 2 or not 1 <= len(keys) <= 2:
        return None
    with plots.canvas(10.0, 3.2, columns=len(HEADLINES)) as (figure, axes):
        for ax, (name, label) in zip(axes, HEADLINES, strict=True):
            if len(keys) == 1:
                _curve(ax, keys[0], [(values[keys[0]], summary[name]) for values, summary in points], label)
            else:
                cells = [(values[keys[0]], values[keys[1]], _value(summary[name])) for values, summary in points]
                _grid(figure, ax, keys, cells, label)
        return plots.svg(figure)


def larger_than(per_day: dict[str, Any]) -> str | None:
    """N(> d) a day, injected and recovered with intervals; None where nothing could be recovered."""
    rows = [r for r in per_day["larger_than"] if r["recovered_per_day"]["value"] is not None]
    if not rows:
        return None
    size = np.array([r["larger_than_m"] for r in rows])
    with plots.canvas(4.8, 3.4) as (figure, (ax,)):
        for name, colour, shift in (("injected", plots.INK, 1.0), ("recovered", plots.BLUE, 1.03)):
            cells = [r[f"{name}_per_day"] for r in rows]
            value = np.array([c["value"] for c in cells])
            ends = np.array([[max(c["value"] - c["low"], 0.0), max(c["high"] - c["value"], 0.0)] for c in cells]).T
            ax.errorbar(size * shift, value, yerr=ends, fmt="o-", ms=4, lw=1.2, capsize=2, color=colour, label=name)
        ax.set(xscale="log", yscale="log", xlabel="diameter d (m)", ylabel="objects larger than d, a day")
        ax.set_xlim(SIZE_EDGES_M[0] / 1.5, SIZE_EDGES_M[-1] * 1.5)
        ax.legend()
        return plots.svg(figure)


def _value(item: Any) -> float:
    value = item["value"] if isinstance(item, dict) else item
    return float("nan") if value is None else float(value)


def _measured(values: Sequence[Any]) -> tuple[NDArray[np.float64], str] | None:
    """Values of a key as (n,) numbers in the unit of the first, and this unit; None for what has no common dimension."""
    if any(isinstance(value, bool | list) for value in values):
        return None
    try:
        quantities = [u.Quantity(value) for value in values]
        numbers = np.array([float(each.to_value(quantities[0].unit)) for each in quantities])
    except (TypeError, ValueError, u.UnitsError):
        return None
    return (numbers, str(quantities[0].unit)) if np.isfinite(numbers).all() else None


def _curve(ax: Any, key: str, cells: list[tuple[Any, Any]], label: str) -> None:
    measured = _measured([value for value, _ in cells])
    x, unit = measured or (np.arange(len(cells), dtype=float), "")
    y = np.array([_value(item) for _, item in cells])
    ends = [(item["low"], item["high"]) if isinstance(item, dict) and item["value"] is not None else (v, v)
            for v, (_, item) in zip(y, cells, strict=True)]  # fmt: skip
    error = np.array([[max(v - low, 0.0), max(high - v, 0.0)] for v, (low, high) in zip(y, ends, strict=True)]).T
    order = np.argsort(x)
    ax.errorbar(x[order], y[order], yerr=error[:, order], fmt="o-", ms=4, lw=1.2, capsize=2, color=plots.BLUE)
    if measured and x.min() > 0 and x.max() > 8 * x.min():
        ax.set_xscale("log")
    if not measured:
        ax.set_xticks(x, [str(value) for value, _ in cells])
    ax.set(xlabel=f"{key} ({unit})" if unit else key, title=label)
    ax.title.set_fontsize(9)


def _grid(figure: Any, ax: Any, keys: list[str], cells: list[tuple[Any, Any, float]], label: str) -> None:
    # By their texts: a list cannot be a key, and true is not 1.
    first, second = (list(dict.fromkeys(str(cell[axis]) for cell in cells)) for axis in (0, 1))
    table = np.full((len(second), len(first)), np.nan)
    for a, b, value in cells:
        table[second.index(str(b)), first.index(str(a))] = value
    ax.grid(visible=False)
    image = ax.imshow(table, origin="lower", aspect="auto", cmap="viridis")
    known = table[np.isfinite(table)]
    if not len(known):
        # a bar of colours would show numbers that nobody measured
        ax.text(0.5, 0.5, "nothing measured", transform=ax.transAxes, ha="center", va="center", fontsize=8)
    else:
        figure.colorbar(image, ax=ax)
    for (j, i), value in np.ndenumerate(table):
        if np.isfinite(value):
            ink = "white" if value < known.min() + 0.6 * (known.max() - known.min()) else "black"
            ax.text(i, j, number(float(f"{value:.3g}")), ha="center", va="center", fontsize=8, color=ink)
    ax.set_xticks(range(len(first)), first)
    ax.set_yticks(range(len(second)), second)
    ax.set(xlabel=keys[0], ylabel=keys[1], title=label)
    ax.title.set_fontsize(9)
