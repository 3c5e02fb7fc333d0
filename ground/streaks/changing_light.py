"""Brightness of a trail that a parabola does not describe: what a tumbler's flashes are worth at its ends.

An end is found where the light of the model stops. A model that is too bright there by a share b puts the end b sqrt(pi) w
inwards (w width of the profile): a trail of S/N 700 with two flashes had its ends five sigma off. The brightness in bins
(`light_curve`) is therefore followed by a Legendre series of the order that pays for itself (Schwarz 1978, Ann. Stat. 6, 461),
and what the series leaves unknown at an end goes into the end's error.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ground.streaks.light_curve import LightCurve

Array = NDArray[np.float64]

MOST_ORDERS: Final = 24
"""A budget of work, reached at 96 bins (`BINS_EACH`). Chosen, not measured."""
BINS_EACH: Final = 4
"""Bins for each term of the series, at least."""
LEAST_LIGHT: Final = 0.05
"""Of the mean: a series may swing below nothing, light does not."""


class LightSeries(NamedTuple):
    """Brightness over that of the smooth model, x from -1 at end 0 to 1 at end 1: coefficients (k,); error at both ends."""

    coefficients: Array
    end_errors: tuple[float, float]

    def at(self, x: Array) -> Array:
        """(n,) of the places x; beyond the ends what it is there."""
        return np.maximum(legendre.legval(np.clip(x, -1.0, 1.0), self.coefficients), LEAST_LIGHT)


def light_series(curve: LightCurve, smooth_e_px: Array) -> LightSeries | None:
    """Of a light curve that varies about a smooth model, density (k,) in its bins; None of one that does not.

    Errors count as larger by the root of chi-square over its freedom where the series does not get down to the noise.
    """
    n = len(curve.density_e_px)
    if not curve.variable or n < 2 * BINS_EACH:
        return None
    x = (2.0 * np.arange(n) + 1.0) / n - 1.0
    smooth = np.maximum(smooth_e_px, 1e-9)
    ratio, weight = curve.density_e_px / smooth, smooth / curve.sigma_e_px
    cost = math.inf
    best: Array = np.ones(1)
    covariance: Array = np.ones((1, 1))
    for order in range(min(MOST_ORDERS, n // BINS_EACH)):
        terms = legendre.legvander(x, order)
        weighted = terms * weight[:, None]
        inverse = np.linalg.pinv(weighted.T @ weighted, hermitian=True)
        found = inverse @ (weighted.T @ (weight * ratio))
        chi2 = float(np.sum((weight * (ratio - terms @ found)) ** 2))
        if chi2 + (order + 1) * math.log(n) < cost:
            cost, best = chi2 + (order + 1) * math.log(n), found
            covariance = np.asarray(inverse * max(chi2 / (n - order - 1), 1.0), dtype=np.float64)
    ends = legendre.legvander(np.array([-1.0, 1.0]), len(best) - 1)
    errors = np.sqrt(np.sum((ends @ covariance) * ends, axis=1)) / np.maximum(ends @ best, LEAST_LIGHT)
    return LightSeries(best, (float(errors[0]), float(errors[1])))


def end_variance_px2(series: LightSeries, width_px: float) -> Array:
    """(2, 2) covariance that the errors of the brightness give the ends."""
    return math.pi * width_px**2 * np.diag(np.square(np.minimum(series.end_errors, 1.0)))
