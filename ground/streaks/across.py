"""What the pixels of one frame say of where a faint trail lies across its direction, at any line near it.

A frame of S/N 4 has its brightest place often on a peak of its noise, farther off than its error says. So a line through many
frames is not fitted to such places but to the pixels: each frame gives the slope and the curvature of its likelihood at the
line of all frames (`ground.link.pixel_line`). The model of a trail and its derivatives are those of the single-frame fit.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import LineFit, effective_width_px, uniform_trail
from ground.streaks.fit_record import edges_of
from ground.streaks.intruders import intruder_mask
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_model import DENSITY, N_PARAMETERS, SAGITTA, SLOPE, V_MID, accumulate, quartic_px4
from ground.streaks.trail_pixels import TrailPixels, usable_pixels
from sboc_e2e.icd.products import StreakFit, StreakPixels

Array = NDArray[np.float64]

REACH_PX: Final = 2.5
"""Pixels are kept for lines so far from the fitted one: as far as a forced fit may be off (`ground.streaks.forced`)."""
LEAST_END_PX: Final = 0.5
"""Least blur of an end, as in a forced fit: ends are placed to that at best. Chosen, not measured."""
FEWEST_PIXELS: Final = 8
"""Fewer tell no line, as in a forced fit."""
LEAST_DENSITY: Final = 1e-3
"""Of a trail's light, e-/px, for the model of frames whose noise has made it negative."""

_FREE: Final = np.array([DENSITY, V_MID, SLOPE])


@dataclass(frozen=True, kw_only=True, eq=False)
class AcrossPixels:
    """Pixels (by ascending u) about a fitted trail, in the axes of its chord.

    straight : parameters of the trail as fitted, which a line shifts and tilts. half_px : of its length. blur_px : of its ends.
    """

    pixels: TrailPixels
    straight: Array
    half_px: float
    blur_px: tuple[float, float]
    width_px: float

    @classmethod
    def of(cls, fit: StreakFit, pixels: StreakPixels) -> "AcrossPixels | None":
        """Of a fit in its own frame; None with too few pixels."""
        frame, half = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1), max(0.5 * fit.length_px, 0.5)
        width = effective_width_px(pixels.psf_sigma_px)
        near = usable_pixels(pixels, frame, 5.0 * width + REACH_PX + abs(fit.sagitta_px)).near(math.inf)
        if near.u.size < FEWEST_PIXELS:
            return None
        along, covariance = np.array([frame.sin, frame.cos]), np.asarray(fit.covariance_px2)
        edges = edges_of(fit.flags)
        sigma = [math.sqrt(max(float(along @ covariance[i : i + 2, i : i + 2] @ along), 0.0)) for i in (0, 2)]
        blur0, blur1 = (0.0 if edge else max(s, LEAST_END_PX) for s, edge in zip(sigma, edges, strict=True))
        straight = uniform_trail(max(fit.flux_e / (2.0 * half), LEAST_DENSITY), half, edges, width)
        straight[SAGITTA], straight[V_MID] = fit.sagitta_px, 2.0 / 3.0 * fit.sagitta_px
        return cls(pixels=near, straight=straight, half_px=half, blur_px=(blur0, blur1), width_px=width)

    def across_px(self, shift_px: Array) -> float:
        """Part of a shift (2,) in row and col that moves the trail across."""
        frame = self.pixels.frame
        return float(shift_px @ np.array([frame.cos, -frame.sin]))

    def without_intruders(self, place: Array) -> "AcrossPixels":
        """The same without the light of other sources, when the trail is moved by `place` (2,)."""
        parameters = self._moved(place, float(self.straight[DENSITY]))
        line = LineFit(
            pixels=self.pixels,
            parameters=parameters,
            covariance=np.zeros((N_PARAMETERS, N_PARAMETERS)),
            half_px=self.half_px,
            blur_px=self.blur_px,
            free=(DENSITY,),
            chi2=math.nan,
            snr=math.nan,
            n_pixels=self.pixels.u.size,
        )
        mask, _ = intruder_mask(line, self.width_px, self.blur_px, ends_given=True)
        return replace(self, pixels=self.pixels.take(~mask))

    def density(self, place: Array) -> tuple[float, float]:
        """Most likely light, e-/px, and its variance, when the trail is moved by `place` (2,): middle, half of the tilt, px."""
        found = float(self.straight[DENSITY])
        variance = math.inf
        for _ in range(2):  # linear but for the object's own noise in the weights
            gradient, fisher = self._sums(place, max(found, LEAST_DENSITY))
            variance = 1.0 / max(float(fisher[0, 0]), 1e-30)
            found = max(found, LEAST_DENSITY) + float(gradient[0]) * variance
        return found, variance

    def evidence(self, place: Array, density: float, precision: float) -> tuple[Array, Array]:
        """Slope (2,) and information (2, 2) of the log likelihood by `place`, at the most likely density under its prior.

        precision : of the prior, (e-/px)^-2.
        """
        gradient, fisher = self._sums(place, max(density, LEAST_DENSITY))
        by_density = fisher[1:, 0]
        known = np.outer(by_density, by_density) / (float(fisher[0, 0]) + precision + 1e-30)
        return gradient[1:], fisher[1:, 1:] - known

    def _moved(self, place: Array, density: float) -> Array:
        parameters = self.straight.copy()
        parameters[DENSITY] = density
        parameters[V_MID] += place[0]
        parameters[SLOPE] = place[1]
        return parameters

    def _sums(self, place: Array, density: float) -> tuple[Array, Array]:
        """Slope (3,) and Fisher matrix (3, 3) of density, place and half of the tilt."""
        gradient, fisher, p = np.empty(3), np.empty((3, 3)), self.pixels
        scale = (self.half_px, *self.blur_px, quartic_px4(p.frame.angle_rad))
        accumulate(self._moved(place, density), p.u, p.v, p.value_e, p.variance_e2, scale, _FREE, gradient, fisher)
        return gradient, fisher
