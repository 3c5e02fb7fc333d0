"""Likelihood of the place and the tilt of a faint trail, as far from the fitted ones as its pixels go.

The slope and curvature of `ground.streaks.across` describe it near one place. At S/N 3 to 5 it is no parabola: it has other
maxima, and a star makes one that is higher than the trail's. Here it is tabulated: in blocks along the trail, sums over the
pixels of what a trail moved by so much across matches. A place and a tilt move each block by its own amount. The light is
integrated.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.across import REACH_PX, AcrossPixels
from ground.streaks.trail_model import DENSITY, SLOPE, V_MID, mean_all, quartic_px4

Array = NDArray[np.float64]

STEP_PX: Final = 0.15
"""Of the tables, which are read linearly: a profile 0.94 px wide is wrong by 0.3 % of its peak at most."""
BEYOND_PX: Final = 1.05
"""How far the tables go on beyond the reach of the pixels, for the ends of tilted trails. Chosen, not measured."""
BLOCKS: Final = 8
"""Pieces along the trail, each moved as a whole. That costs up to 0.3 in the logarithm where half of the tilt is 1 px, twice the
error of a trail of S/N 4; 16 pieces are no better."""
BLURS: Final = 2.0
"""Widths of an end's blur that the blocks go on beyond it. Chosen, not measured."""
SPOILT: Final = 0.005
"""Share of frames whose light across tells nothing of the line, because it is a star's. Measured as the share that makes the true
lines of 826 faint frames most likely (two runs of `sso_faint`): 0.001 in all, 0.005 in 351 trails below 30 px; 0.005 costs 0.8 in
the logarithm."""
SPOILT_LIGHT: Final = 3.0
"""Spread of a star's light on a trail, in units of the trail's. Chosen, not measured."""
SPOILT_TILTS_PX: Final = np.linspace(-1.0, 1.0, 9)
"""Half tilts over which the likelihood of a spoilt frame is averaged. Chosen, not measured."""

_SHIFTS_PX: Final = STEP_PX * np.arange(-round((REACH_PX + BEYOND_PX) / STEP_PX), round((REACH_PX + BEYOND_PX) / STEP_PX) + 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class AcrossLikelihood:
    """Tables of a frame.

    x : (B,) middles of the blocks, in half lengths. matched, power : (B, S) at shifts `_SHIFTS_PX`, sums over the block's
    pixels of template times light over variance, (e-/px)^-1, and of template squared over variance, (e-/px)^-2.
    """

    x: Array
    matched: Array
    power: Array

    @classmethod
    def of(cls, across: AcrossPixels) -> "AcrossLikelihood":
        """Of a frame's pixels. The object's own noise is left out: it is small below S/N 7."""
        p, half = across.pixels, across.half_px
        scale = (half, *across.blur_px, quartic_px4(p.frame.angle_rad))
        beyond = [1.0 + (BLURS * (blur + across.width_px)) / half for blur in across.blur_px]
        edges = np.linspace(-beyond[0], beyond[1], BLOCKS + 1)
        block = np.clip(np.searchsorted(edges, p.u / half) - 1, 0, BLOCKS - 1)
        matched, power = np.empty((2, BLOCKS, len(_SHIFTS_PX)))
        parameters = across.straight.copy()
        parameters[DENSITY], parameters[SLOPE] = 1.0, 0.0
        for k, shift in enumerate(_SHIFTS_PX):
            parameters[V_MID] = across.straight[V_MID] + shift
            template = mean_all(parameters, p.u, p.v, scale)
            matched[:, k] = np.bincount(block, template * p.value_e / p.variance_e2, BLOCKS)
            power[:, k] = np.bincount(block, template**2 / p.variance_e2, BLOCKS)
        return cls(x=0.5 * (edges[1:] + edges[:-1]), matched=matched, power=power)

    def log(self, place: Array, light: float | Array, spread: float | Array) -> Array:
        """(m,) log likelihood over that of no light, of places (m, 2): shift of the middle and half of the tilt, px.

        light, spread : normal prior of the trail's light, e-/px, of all places or (m,). Shifts beyond the tables are as those at
        their border.
        """
        matched, power = np.zeros(len(place)), np.zeros(len(place))
        last = len(_SHIFTS_PX) - 1
        for x, by_shift, power_by_shift in zip(self.x, self.matched, self.power, strict=True):
            at = np.clip((place[:, 0] + x * place[:, 1] - _SHIFTS_PX[0]) / STEP_PX, 0.0, last - 1e-6)
            left = at.astype(np.int64)
            share = at - left
            matched += by_shift[left] * (1.0 - share) + by_shift[left + 1] * share
            power += power_by_shift[left] * (1.0 - share) + power_by_shift[left + 1] * share
        precision = spread**-2
        best = (matched + light * precision) ** 2 / (power + precision)
        return np.asarray(0.5 * (best - light**2 * precision - np.log1p(power / precision)))

    def log_spoilt(self, light: float) -> float:
        """Log likelihood of a star anywhere within reach, with a light like this many e-/px or a few times as much."""
        shift, tilt = (g.ravel() for g in np.meshgrid(_SHIFTS_PX[np.abs(_SHIFTS_PX) <= REACH_PX], SPOILT_TILTS_PX))
        log = self.log(np.stack([shift, tilt], axis=1), 0.0, SPOILT_LIGHT * light)
        return float(np.logaddexp.reduce(log)) - math.log(log.size)
