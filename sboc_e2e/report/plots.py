"""Plots of a report as SVG text, drawn without a display; neutral ink that reads on light and dark pages."""

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from astropy.table import Table
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from sboc_e2e.score.figures import proportion

MAX_ORBITS: Final = 12
"""Tracklets in the picture of orbits; more would hide each other."""

LOWEST_SNR: Final = 3.0
"""Where the bins of completeness begin: fainter truth is not counted (`sboc_e2e.score.matching.SNR_IGNORED`)."""

BINS_PER_DECADE: Final = 7
"""Bins of completeness in a factor of ten of S/N. Chosen, not measured."""

INK: Final = "#7a7f87"
BLUE, ORANGE, GREEN, RED = "#3b82c4", "#d9822b", "#3a9d5d", "#c8453b"
SERIES: Final = (BLUE, ORANGE, GREEN, RED, "#8a63b8", "#3aa6a6", "#a07a3a")

_STYLE: Final[dict[Any, Any]] = {
    "svg.hashsalt": "sboc",
    "svg.fonttype": "none",
    "font.size": 9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


@contextmanager
def canvas(width_in: float = 5.6, height_in: float = 3.6, columns: int = 1) -> Iterator[tuple[Canvas, NDArray[Any]]]:
    """A transparent figure with a row of axes, under the house style; as it is, for half the width of a page."""
    with mpl.rc_context(_STYLE):
        figure = Canvas(figsize=(width_in, height_in), layout="constrained")
        figure.patch.set_alpha(0.0)
        axes = np.atleast_1d(figure.subplots(1, columns))
        for ax in axes:
            ax.patch.set_alpha(0.0)
        yield figure, axes


def plain_logarithmic(axis: Axis) -> None:
    """Ticks at 1, 2 and 5 times powers of ten, as plain numbers, or fewer where more decades would make them overlap.

    It counts the decades of what is drawn already.
    """
    low, high = axis.get_view_interval()
    decades = math.log10(high / low) if high > low > 0.0 else 1.0
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.0 else (1.0, 3.0) if decades < 3.5 else (1.0,)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def svg(figure: Canvas) -> str:
    """The figure as an SVG element without dates, so that the same run gives the same page."""
    out = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def _bin_edges(snr: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seven bins a decade of S/N from 3, to 300 at least, and as many more as hold the brightest."""
    brightest = max(snr[np.isfinite(snr)].max(initial=LOWEST_SNR), 299.0)
    n_bins = math.floor(BINS_PER_DECADE * math.log10(brightest / LOWEST_SNR)) + 1
    return LOWEST_SNR * 10.0 ** (np.arange(n_bins + 1) / BINS_PER_DECADE)


def completeness(series: dict[str, tuple[NDArray[np.float64], NDArray[np.bool_]]], ideal_snr50: float | None) -> str:
    """Share detected against true S/N, in bins with Wilson intervals, for each named half or detector."""
    edges = _bin_edges(np.concatenate([snr for snr, _ in series.values()]))
    with canvas() as (figure, (ax,)):
        for k, (name, (snr, found)) in enumerate(series.items()):
            x, y, low, high = [], [], [], []
            for a, b in pairwise(edges):
                inside = (snr >= a) & (snr < b)
                if inside.any():
                    share = proportion(int(found[inside].sum()), int(inside.sum()))
                    x.append(np.sqrt(a * b) * (1 + 0.015 * k))
                    y.append(share["value"])
                    low.append(share["low"])
                    high.append(share["high"])
            y_array = np.array(y)
            error = np.array([y_array - low, np.array(high) - y_array]).clip(0)
            ax.errorbar(x, y, yerr=error, marker="o", ms=4, lw=1.2, capsize=2, color=SERIES[k % len(SERIES)], label=name)
        if ideal_snr50 is not None:
            ax.axvline(ideal_snr50, color=INK, ls="--", lw=1, label="ideal half point")
        ax.set(xscale="log", ylim=(-0.03, 1.05), xlabel="true matched-filter S/N", ylabel="share detected")
        plain_logarithmic(ax.xaxis)
        figure.legend(loc="outside upper center", ncols=3)
        return svg(figure)


def residuals(rows: list[dict[str, float]]) -> str:
    """Cross-track residual over its bound, end residual over the attainable bound, and pulls with the unit normal."""
    with canvas(10.0, 3.2, columns=3) as (figure, axes):
        snr = np.array([r["snr"] for r in rows])
        axes[0].plot(snr, [r["cross_ratio"] for r in rows], ".", color=BLUE, ms=4)
        for which, colour in (("end0_attainable", ORANGE), ("end1_attainable", GREEN)):
            chosen = [(r["snr"], r[which]) for r in rows if which in r]
            if chosen:
                axes[1].plot(*zip(*chosen, strict=True), ".", color=colour, ms=4, label=which[:4])
        for ax, name in ((axes[0], "cross-track / CRLB"), (axes[1], "ends / attainable bound")):
            ax.axhspan(-1, 1, color=INK, alpha=0.12, lw=0)
            ax.set(xscale="log", xlabel="true S/N", ylabel=name, ylim=(-5, 5))
            plain_logarithmic(ax.xaxis)
        bins = np.linspace(-5, 5, 31)
        for name, colour in (("cross_pull", BLUE), ("along_pull", ORANGE)):
            values = np.array([r[name] for r in rows if name in r and np.isfinite(r[name])])
            if len(values):
                axes[2].hist(values.clip(-5, 5), bins, histtype="step", density=True, color=colour, label=name.replace("_", " "))
        axes[2].plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=INK, lw=1, ls="--")
        axes[2].set(xlabel="residual / its own sigma", ylabel="density")
        axes[2].legend(fontsize=7)
        return svg(figure)


def magnitudes(rows: list[dict[str, float]]) -> str:
    """Magnitude residuals against S/N."""
    with canvas() as (figure, (ax,)):
        ax.plot([r["snr"] for r in rows], [r["residual_mag"] for r in rows], ".", color=BLUE, ms=4)
        ax.axhline(0, color=INK, lw=1)
        ax.set(xscale="log", xlabel="true S/N", ylabel="measured - true V (mag)", ylim=(-0.6, 0.6))
        plain_logarithmic(ax.xaxis)
        return svg(figure)


def frame_vectors(grids: list[dict[str, Any]]) -> str:
    """Solved minus true direction over the field, mean of all frames, along the axes of the frame."""
    with canvas() as (figure, (ax,)):
        along_col, along_row = (np.mean([g[name] for g in grids], axis=0) for name in ("along_col_arcsec", "along_row_arcsec"))
        ax.margins(0.2, 0.35)
        # "xy": an arrow of growing row points down, as the axis does.
        arrows = ax.quiver(
            grids[0]["col"], grids[0]["row"], along_col, along_row, color=BLUE, angles="xy", width=0.004, clip_on=False
        )
        size = float(np.hypot(along_col, along_row).max())
        ax.quiverkey(arrows, 1.06, 0.96, size, f'{size:.3f}"', labelpos="S", coordinates="axes")
        ax.set(xlabel="col", ylabel="row", aspect="equal")
        ax.invert_yaxis()
        return svg(figure)


def tracklets_on_sky(streaks: Table, frames: Table) -> str:
    """Measured streaks of each tracklet on the sky, unlinked ones in grey, and the outlines and middles of the solved frames."""
    with canvas() as (figure, (ax,)):
        reference: float | None = None

        def near(ra_deg: NDArray[np.float64]) -> NDArray[np.float64]:
            """Right ascensions within 180 deg of the first one drawn, so that nothing jumps at 0."""
            nonlocal reference
            reference = float(ra_deg[ra_deg.size // 2]) if reference is None else reference
            return reference + (ra_deg - reference + 180.0) % 360.0 - 180.0

        for s in frames:
            if "grid_ra_app_deg" not in frames.colnames or not np.isfinite(s["grid_ra_app_deg"]).all():
                continue
            grid_ra, grid_dec = (np.asarray(s[name], float).reshape(-1) for name in ("grid_ra_app_deg", "grid_dec_app_deg"))
            side, middle = math.isqrt(grid_ra.size), grid_ra.size // 2
            grid_ra = near(grid_ra)
            index = np.arange(grid_ra.size).reshape(side, side)
            border = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2::-1, 0]])
            ax.plot(grid_ra[border], grid_dec[border], color=INK, lw=0.6, alpha=0.5)
            ax.plot(grid_ra[middle], grid_dec[middle], "+", color=INK, ms=5)
        for s in streaks:
            ra, dec = [s["ra0_deg"], s["ra1_deg"]], [s["dec0_deg"], s["dec1_deg"]]
            if not np.all(np.isfinite([*ra, *dec])):
                continue
            tracklet = int(s["tracklet_id"])
            colour = INK if tracklet < 0 else SERIES[tracklet % len(SERIES)]
            ax.plot(near(np.array(ra)), dec, color=colour, lw=0.8 if tracklet < 0 else 1.8)
        if reference is not None:
            ax.set_aspect(1.0 / max(math.cos(math.radians(float(np.mean(ax.get_ylim())))), 0.05), adjustable="datalim")
        ax.set(xlabel="right ascension (deg)", ylabel="declination (deg)")
        ax.invert_xaxis()
        return svg(figure)


def orbit_spread(samples: Table, orbits: Table, true_range_km: dict[int, float]) -> str:
    """Posterior samples of each tracklet's orbit: range against semi-major axis and inclination, medians with 90 % intervals.

    true_range_km : by tracklet, where the truth is known; drawn as a cross.
    """
    with canvas(10.0, 3.4, columns=3) as (figure, axes):
        shown = sorted({int(t) for t in samples["tracklet_id"]})[:MAX_ORBITS]
        for k, tracklet in enumerate(shown):
            mine = samples[samples["tracklet_id"] == tracklet]
            colour = SERIES[k % len(SERIES)]
            for ax, name in ((axes[0], "a_km"), (axes[1], "i_deg")):
                ax.scatter(mine["range_km"], mine[name], s=2, alpha=0.35, color=colour, lw=0)
            row = orbits[orbits["tracklet_id"] == tracklet]
            if len(row):
                low, middle, high = (float(row[f"range{part}_km"][0]) for part in ("_low", "", "_high"))
                axes[2].errorbar(middle, k, xerr=[[max(middle - low, 0)], [max(high - middle, 0)]], fmt="o", ms=4, color=colour)
            if np.isfinite(true_range_km.get(tracklet, np.nan)):
                axes[2].plot(true_range_km[tracklet], k, "x", color=INK, ms=7)
        for ax, label in zip(axes, ("semi-major axis (km)", "inclination (deg)", "tracklet"), strict=True):
            ax.set(xscale="log", xlabel="range (km)", ylabel=label)
            plain_logarithmic(ax.xaxis)
        axes[0].set_yscale("log")
        plain_logarithmic(axes[0].yaxis)
        axes[2].set_yticks(range(len(shown)), [str(tracklet) for tracklet in shown])
        return svg(figure)


def larger_than(rows: list[dict[str, Any]]) -> str:
    """Objects larger than d that cross the field in a day: injected, and recovered with their intervals."""
    with canvas() as (figure, (ax,)):
        size_mm = np.array([1000.0 * r["larger_than_m"] for r in rows])
        ax.plot(size_mm, [r["injected_per_day"]["value"] for r in rows], "s-", color=INK, ms=4, lw=1, label="injected")
        value, low, high = (np.array([r["recovered_per_day"][k] for r in rows]) for k in ("value", "low", "high"))
        ax.errorbar(size_mm * 1.04, value, (value - low, high - value), fmt="o", color=BLUE, ms=4, capsize=2, label="recovered")
        ax.set(xscale="log", yscale="log", xlabel="diameter d (mm)", ylabel="objects larger than d, per day")
        for axis in (ax.xaxis, ax.yaxis):
            plain_logarithmic(axis)
        ax.legend(fontsize=7)
        return svg(figure)


def detected_per_day(rows: list[dict[str, Any]]) -> str:
    """Debris detected a day in each class of size: the interval of counting, and with models of albedo and population."""
    with canvas() as (figure, (ax,)):
        size_mm = np.array([1000.0 * np.sqrt(r["from_m"] * r["to_m"]) for r in rows])
        for key, colour, width, label in (
            ("models_per_day", INK, 1.0, "with albedo and population models"),
            ("detected_per_day", BLUE, 2.2, "counting"),
        ):
            value, low, high = (np.array([r[key][k] for r in rows]) for k in ("value", "low", "high"))
            error = (np.maximum(value - low, 0.0), np.maximum(high - value, 0.0))
            ax.errorbar(size_mm, value, error, fmt="o", color=colour, ms=4, capsize=2, lw=width, label=label)
        ax.set(xscale="log", yscale="log", xlabel="diameter (mm)", ylabel="detections per day in the class")
        plain_logarithmic(ax.xaxis)
        ax.legend(fontsize=7)
        return svg(figure)


def published_flux(rows: list[dict[str, Any]]) -> str:
    """Objects larger than d per km^2 and year: the true flux and the published one with its total interval."""
    with canvas() as (figure, (ax,)):
        size_mm = np.array([1000.0 * r["larger_than_m"] for r in rows])
        ax.plot(size_mm, [r["true_per_km2_year"] for r in rows], "s-", color=INK, ms=4, lw=1, label="true")
        value, low, high = (np.array([r["published_per_km2_year"][k] for r in rows]) for k in ("value", "low", "high"))
        error = (np.maximum(value - low, 0.0), np.maximum(high - value, 0.0))
        ax.errorbar(size_mm * 1.04, value, error, fmt="o", color=BLUE, ms=4, capsize=2, label="published")
        ax.set(xscale="log", yscale="log", xlabel="diameter d (mm)", ylabel="objects larger than d, per km$^2$ and year")
        ax.legend(fontsize=7)
        return svg(figure)


def downlink_bars(bytes_by_kind: dict[str, int], n_frames: int) -> str:
    """Kilobytes per frame of each kind of packet."""
    kinds = {k: v for k, v in bytes_by_kind.items() if v}
    with canvas() as (figure, (ax,)):
        ax.barh(list(kinds), [v / 1000 / max(n_frames, 1) for v in kinds.values()], color=BLUE)
        ax.set(xlabel="kB per frame")
        return svg(figure)
