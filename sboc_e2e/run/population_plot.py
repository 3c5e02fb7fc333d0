"""A picture of the published flux: objects larger than d per km^2 and year, with counting and total intervals."""

import io
from typing import Final

import matplotlib as mpl
import numpy as np
from astropy.table import Table
from matplotlib.figure import Figure

_STYLE: Final = {"svg.hashsalt": "sboc", "svg.fonttype": "none", "font.size": 8, "axes.grid": True, "grid.alpha": 0.25}


def population_svg(table: Table) -> str:
    """SVG document of products/population.ecsv. Without dates, so that bytes repeat."""
    size_mm = 1e3 * np.asarray(table["from_m"], float)
    columns = ("larger", "larger_low", "larger_high", "larger_total_low", "larger_total_high")
    value, low, high, lowest, highest = (np.asarray(table[name], float) for name in columns)
    known = np.isfinite(value)
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib's names of settings are a literal type
        figure = Figure(figsize=(4.5, 3.2), layout="constrained")
        axes = figure.subplots()
        if known.any():
            at, middle = size_mm[known], value[known]
            axes.errorbar(
                at, middle, (middle - np.minimum(lowest[known], middle), np.maximum(highest[known], middle) - middle), fmt="none",
                ecolor="0.6", elinewidth=3, label="systematic term included",
            )  # fmt: skip
            axes.errorbar(
                at, middle, (middle - low[known], high[known] - middle), fmt="o", ms=4, capsize=2, label="counting, 90 %"
            )
            axes.set(xscale="log", yscale="log")
            axes.legend(fontsize=7)
        else:
            axes.text(0.5, 0.5, str(table.meta["lacks"]), ha="center", va="center", wrap=True, transform=axes.transAxes)
        axes.set(xlabel="diameter d (mm)", ylabel="objects larger than d, per km2 and year")
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()
