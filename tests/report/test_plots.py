"""Plots of the report: what their axes say."""

import numpy as np
import pytest

from sboc_e2e.report import plots


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
