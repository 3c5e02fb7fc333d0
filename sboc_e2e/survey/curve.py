"""The curve of found trails: what S/N, length, sky and the field's edge make of the chance that a trail is found.

    p = top / (1 + exp(-(S - half) / width)) / (1 + exp(-(length - shortest) / SHORT_WIDTH_PX))

`half` goes with the trail's length, the noise of its sky and whether the field's edge cuts it, and differs a little from object
to object: trails of one object have stars, direction and light in common, and are found or lost together more often than chance
would have it. Below the shortest length nothing is found, however bright: the software takes it for no line.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, roots_hermitenorm

Array = NDArray[np.float64]

PARAMETERS: Final = (
    "s50 at 30 px", "its slope with x = log10(length / 30 px)", "with x^2", "ln width", "logit top",
    "slope of s50 with log10 noise", "s50 of trails cut by the edge less that of others", "shortest length (px)",
    "ln of one sigma of s50 between objects",
)  # fmt: skip
HALF, SLOPE, BEND, LN_WIDTH, LOGIT_TOP, WITH_NOISE, WHEN_CUT, SHORTEST, LN_SPREAD = range(len(PARAMETERS))
"""Places of the parameters in a curve."""

LENGTH_PX: Final = 30.0
"""The half point of the curve is that of this length."""
LONGEST_PX: Final = 3000.0
"""Longer trails count as of this length: a parabola in log length must not be drawn on beyond what was measured. Chosen."""
SHORT_WIDTH_PX: Final = 0.3
"""Of the step at the shortest length. Above S/N 9, 21 of 22 trails below 8 px were lost, 3 of 4 of 8 to 10 px found. Chosen."""

START: Final = (8.0, 0.0, 0.0, 0.6, 3.0, 0.0, 0.0, 8.0, -1.2)
"""Where the search for the curve begins: half at S/N 8, no slopes, a width of exp(0.6) = 1.8, 95 % found at the top, lines

from 8 px on, one sigma of 0.3 between objects.
"""
PRIOR_SIGMA: Final = (np.inf, 3.0, 3.0, np.inf, 2.0, 5.0, 3.0, 3.0, 1.0)
"""Of each parameter about its start, so weak that 200 trails outweigh it; what no trail tells stays there. Chosen."""
UNTOLD: Final = 1e-3  # one sigma of a slope that the samples cannot tell: it stays at its start
NODES: Final = 7
"""Of the mean over objects (Gauss and Hermite): exact for polynomials of degree 13."""
LEAST_SHARE: Final = 1e-6  # of a trail, so that one found below all expectation does not rule the fit

_Z, _WEIGHT = roots_hermitenorm(NODES)
_WEIGHT = _WEIGHT / _WEIGHT.sum()


@dataclass(frozen=True, kw_only=True, eq=False)
class Trails:
    """Trails (k,) with what became of them. cut : by the field's edge. owner : their object; no two runs share one."""

    snr: Array
    length_px: Array
    noise_ratio: Array
    cut: NDArray[np.bool_]
    found: NDArray[np.bool_]
    owner: NDArray[np.int64]


def found_share(
    curve: Array,
    snr: Array,
    length_px: Array,
    noise_ratio: Array | float = 1.0,
    cut: NDArray[np.bool_] | bool = False,
    shift: Array | float = 0.0,
) -> Array:
    """Probability that a trail is found.

    curve : `PARAMETERS`. noise_ratio : noise over that of the response's own sky. cut : by the field's edge. shift : of s50, that
    of the trail's object; without one, that of the usual object.
    """
    x = _log_length(length_px)
    half = curve[HALF] + curve[SLOPE] * x + curve[BEND] * x * x + curve[WITH_NOISE] * np.log10(noise_ratio)
    half = half + curve[WHEN_CUT] * np.asarray(cut, dtype=np.float64) + shift
    short = expit((length_px - curve[SHORTEST]) / SHORT_WIDTH_PX)
    return np.asarray(expit(curve[LOGIT_TOP]) * expit((snr - half) / np.exp(curve[LN_WIDTH])) * short)


def _log_length(length_px: Array) -> Array:
    """The curve's x."""
    return np.asarray(np.log10(np.clip(length_px, 1.0, LONGEST_PX) / LENGTH_PX))


def mean_share(
    curve: Array,
    snr: Array,
    length_px: Array,
    noise_ratio: Array | float = 1.0,
    cut: NDArray[np.bool_] | bool = False,
) -> Array:
    """The same as `found_share` in the mean of all objects."""
    of_nodes = np.exp(curve[LN_SPREAD]) * _Z
    each = [w * found_share(curve, snr, length_px, noise_ratio, cut, s) for w, s in zip(_WEIGHT, of_nodes, strict=True)]
    return np.asarray(np.sum(each, axis=0))


def shifts(curve: Array, n: int, rng: np.random.Generator) -> Array:
    """Shifts of s50 of n objects."""
    return np.asarray(np.exp(curve[LN_SPREAD]) * rng.standard_normal(n))


def fitted(trails: Trails, *, sky: bool, start: Array | None = None) -> Array:
    """The curve of highest likelihood under weak priors. sky : whether the noise varies enough to tell its slope.

    What is found of an object's trails is independent once its shift is given; all shifts are averaged over.
    """
    sigma = np.array(PRIOR_SIGMA)
    if not sky:
        sigma[WITH_NOISE] = UNTOLD
    if not trails.cut.any():
        sigma[WHEN_CUT] = UNTOLD
    _, owner = np.unique(trails.owner, return_inverse=True)
    about, n = np.array(START), int(owner.max()) + 1
    x = _log_length(trails.length_px)
    of_half = {HALF: np.ones(len(x)), SLOPE: x, BEND: x * x, WITH_NOISE: np.log10(trails.noise_ratio), WHEN_CUT: trails.cut}

    def loss(curve: Array) -> tuple[float, Array]:
        """Minus the log likelihood, and its gradient."""
        width, spread = np.exp(curve[LN_WIDTH]), np.exp(curve[LN_SPREAD])
        top, short = expit(curve[LOGIT_TOP]), expit((trails.length_px - curve[SHORTEST]) / SHORT_WIDTH_PX)
        half = np.sum([curve[k] * value for k, value in of_half.items()], axis=0)
        each, slopes = np.empty((NODES, n)), np.empty((NODES, len(curve), n))
        for j, z in enumerate(_Z):
            whole = found_share(curve, trails.snr, trails.length_px, trails.noise_ratio, trails.cut, spread * z)
            p = np.clip(whole, LEAST_SHARE, 1.0 - LEAST_SHARE)
            each[j] = np.bincount(owner, weights=np.where(trails.found, np.log(p), np.log1p(-p)), minlength=n)
            by_ln_p = np.where(trails.found, 1.0, -p / (1.0 - p)) * (whole == p)
            rise = 1.0 - whole / np.maximum(top * short, 1e-300)
            by_half = -by_ln_p * rise / width
            slope = {k: by_half * value for k, value in of_half.items()}
            slope[LN_WIDTH] = by_half * (trails.snr - half - spread * z)
            slope[LOGIT_TOP] = by_ln_p * (1.0 - top)
            slope[SHORTEST] = -by_ln_p * (1.0 - short) / SHORT_WIDTH_PX
            slope[LN_SPREAD] = by_half * spread * z
            for k, value in slope.items():
                slopes[j, k] = np.bincount(owner, weights=value, minlength=n)
        likely = each + np.log(_WEIGHT)[:, None]
        most = likely.max(axis=0)
        share = np.exp(likely - most)
        total = share.sum(axis=0)
        away = (curve - about) / sigma
        value = -float(np.sum(most + np.log(total))) + 0.5 * float(away @ away)
        return value, -np.einsum("jo,jko->k", share / total, slopes) + away / sigma

    first = about if start is None else start
    return np.asarray(minimize(loss, first, method="BFGS", jac=True).x)
