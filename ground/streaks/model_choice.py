"""Which refinement of a straight, uniform trail the pixels ask for: score tests against the extended BIC.

Rao's score statistic of a candidate parameter needs one pass over the pixels at the present best fit. The best
candidate enters when its statistic exceeds ``ln n + 2 ln(candidates)`` (Chen & Chen 2008, extended BIC, gamma = 1);
then the model is fitted again and the rest is asked again.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import CURVED_WIDTHS, LineFit, minus_two_ln_likelihood, score
from ground.streaks.trail_model import LN_WIDTH, Q1, Q2, SAGITTA, accumulate, quartic_px4

CANDIDATES: Final = (SAGITTA, Q1, Q2, LN_WIDTH)
"""Curvature, linear and quadratic brightness, width."""

LEAST_WIDTHS: Final = {SAGITTA: CURVED_WIDTHS, Q1: 10.0, Q2: 20.0, LN_WIDTH: 0.0}
"""Trails shorter than this many widths cannot tell a candidate from misplaced ends; natural curvature is nil there."""

SHORT_WIDTHS: Final = 30.0
"""Length in widths below which brightness needs `SHORT_EVIDENCE`. Chosen, not measured."""
SHORT_EVIDENCE: Final = 25.0
"""Chi-square that brightness must be worth on trails shorter than this many widths: there it trades with the place of an end,
and one gradient in a hundred that noise made costs as much as all other errors of the ends together."""


def score_tests(line: LineFit, candidates: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of each candidate, given all free parameters: score statistic and one-step estimate."""
    p = line.pixels
    index = np.array([*line.free, *candidates], dtype=np.int64)
    gradient, fisher = np.empty(index.size), np.empty((index.size, index.size))
    scale = (line.half_px, *line.blur_px, quartic_px4(p.frame.angle_rad))
    accumulate(line.parameters, p.u, p.v, p.value_e, p.variance_e2, scale, index, gradient, fisher)
    n = len(line.free)
    nuisance = np.linalg.pinv(fisher[:n, :n], rcond=1e-12, hermitian=True)
    statistic, step = np.empty(len(candidates)), np.empty(len(candidates))
    for k in range(len(candidates)):
        row = fisher[n + k, :n] @ nuisance
        information = fisher[n + k, n + k] - row @ fisher[:n, n + k]
        slope = gradient[n + k] - row @ gradient[:n]
        information = max(information, 1e-12 * fisher[n + k, n + k], 1e-300)
        statistic[k], step[k] = slope**2 / information, slope / information
    return statistic, step


def evidence_needed(line: LineFit, candidate: int) -> float:
    """Chi-square that a refinement must be worth (extended BIC)."""
    least = SHORT_EVIDENCE if candidate in (Q1, Q2) and 2.0 * line.half_px < SHORT_WIDTHS * line.width_px else 0.0
    return max(math.log(max(line.n_pixels, 2)) + 2.0 * math.log(len(CANDIDATES)), least)


def straight_unless_evident(line: LineFit, *, iterations: int) -> LineFit:
    """The line without a curvature that does not pay for itself.

    A detector bends faint trails towards noise and neighbouring stars. Real trails are hardly ever bent. The likelihood ratio
    decides, because the formal error of a curvature made by noise is far too small.
    """
    if SAGITTA not in line.free:
        return line
    parameters = line.parameters.copy()
    parameters[SAGITTA] = 0.0
    free = tuple(f for f in line.free if f != SAGITTA)
    straight = score(line.pixels, parameters, free, half_px=line.half_px, blur_px=line.blur_px, iterations=iterations)
    if not straight.regular:
        return line
    gain = minus_two_ln_likelihood(straight) - minus_two_ln_likelihood(line)
    return straight if gain < evidence_needed(line, SAGITTA) else line


def choose_model(line: LineFit, *, iterations: int, shape: bool) -> LineFit:
    """The fit with every refinement that pays for itself; `shape`: whether curvature and brightness are considered."""
    widths = 2.0 * line.half_px / line.width_px
    allowed = [c for c in CANDIDATES if widths > LEAST_WIDTHS[c]] if shape else [LN_WIDTH]
    open_candidates = [c for c in allowed if c not in line.free]
    while open_candidates:
        statistic, step = score_tests(line, tuple(open_candidates))
        gain = statistic - [evidence_needed(line, c) for c in open_candidates]
        best = int(np.argmax(gain))
        if gain[best] < 0.0:
            break
        chosen = open_candidates.pop(best)
        parameters = line.parameters.copy()
        limit = 0.3 if chosen in (LN_WIDTH, Q1, Q2) else 2.0 * line.width_px
        parameters[chosen] += float(np.clip(step[best], -limit, limit))
        refitted = score(
            line.pixels, parameters, (*line.free, chosen), half_px=line.half_px, blur_px=line.blur_px, iterations=iterations
        )
        if not refitted.regular:
            break
        line = refitted
    return line


SMALL_STEP: Final = 0.05
"""Change of ln width that one step of Fisher scoring gets right (to its square)."""


def width_estimate(line: LineFit, iterations: int) -> tuple[float, float]:
    """Fitted ln width and its error, whether or not the model needed it free: the vetter's sharpness."""
    if LN_WIDTH in line.free:
        return float(line.parameters[LN_WIDTH]), math.sqrt(line.covariance[LN_WIDTH, LN_WIDTH])
    free = (*line.free, LN_WIDTH)
    statistic, step = score_tests(line, (LN_WIDTH,))
    if abs(step[0]) < SMALL_STEP:
        return float(line.parameters[LN_WIDTH] + step[0]), float(abs(step[0]) / math.sqrt(max(statistic[0], 1e-300)))
    wide = score(line.pixels, line.parameters, free, half_px=line.half_px, blur_px=line.blur_px, iterations=iterations)
    value = float(wide.parameters[LN_WIDTH])
    if not math.isfinite(value):
        return float(line.parameters[LN_WIDTH]), math.inf
    return value, math.sqrt(wide.covariance[LN_WIDTH, LN_WIDTH])
