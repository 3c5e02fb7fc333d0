"""The best curve through the light along a line that rises once and falls once, as that of a meteor does."""

import math

import numpy as np
from numpy.typing import NDArray


def rise_and_fall(light: NDArray[np.float64], weight: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """The curve (n,) that rises to one of its points, falls from there and fits light (n,) best; weights (n,), equal at first.

    Isotonic regression (Barlow et al. 1972) on either side of each point.
    """
    from scipy.optimize import isotonic_regression  # takes a quarter of a second, which frames without such lines spare

    weight = np.ones(light.size) if weight is None else weight
    best, least = light, math.inf
    for top in range(1, light.size):
        up = isotonic_regression(light[:top], weights=weight[:top]).x
        down = isotonic_regression(light[top:], weights=weight[top:], increasing=False).x
        curve = np.concatenate((up, down))
        rest = float(weight @ (light - curve) ** 2)
        if rest < least:
            best, least = curve, rest
    return best
