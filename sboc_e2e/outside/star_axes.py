"""How sharp a frame's stars are along the short axis of their images.

While the sky turns, or a mount errs, the images of stars grow along one direction. A satellite crosses its pixels in a fraction
of the exposure: its trail is as narrow as the optics alone. So the short axis of the stars tells the width of a trail, and the
circular width of the same images, up to twice as large, does not.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from ground.vetting.short_lines import SHORTEST_PX
from onboard.stars.shape import LEAST_STARS, LEAST_VARIANCE_PX2, MOST_STARS, adaptive_moments
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import DetectorView

NO_STAR: Final = StarFlag.SATURATED | StarFlag.COSMIC_LIKE | StarFlag.EDGE | StarFlag.DEFECT
LEAST_SNR: Final = 15.0
"""S/N of a star from which its axes are good to 7 %."""
RADIUS_PX: Final = 8
"""Half the side of the window of a star. Images with a larger variance than a quarter of its square are left out."""
START_PX2: Final = 1.0
"""Variance that the iteration begins with. Chosen: FWHM of 2.4 px."""

MOST_DRAWN_PX: Final = 0.5 * SHORTEST_PX
"""Length by which stars are drawn out, up to which they are none of the lines: half the shortest one that is judged."""
LEAST_SETTLED: Final = 0.1
"""Share of the bright listed stars whose shape can be told, at least, for that: of stars that are lines 0 to 0.03 were told by
the glow about them or by stars beside."""


@dataclass(frozen=True, kw_only=True)
class StarAxes:
    """Images of the stars, medians: sigma of the short axis, the pixel's own taken off, and length of the even trail that has the
    variance of the long one, px (1.1 to 1.3 times the true one: adaptive moments follow the ends of a trail).

    share : of the stars that were looked at, whose images told it.
    """

    short_px: float
    drawn_px: float
    share: float

    @property
    def are_points(self) -> bool:
        """Whether they are no lines, by far."""
        return self.share >= LEAST_SETTLED and self.drawn_px <= MOST_DRAWN_PX

    @classmethod
    def of(cls, view: DetectorView) -> "StarAxes | None":
        """Of the brightest listed stars of a view; None: too few tell."""
        stars = view.stars
        fit_for_it = np.flatnonzero(((stars.flags & np.uint8(NO_STAR)) == 0) & (stars.snr >= LEAST_SNR))[:MOST_STARS]
        peaks = np.rint(np.column_stack((stars.row[fit_for_it], stars.col[fit_for_it]))).astype(np.float32)
        if len(peaks) < LEAST_STARS:
            return None
        moments = np.empty((len(peaks), 3))
        adaptive_moments(view.residual_adu, view.mask, peaks, RADIUS_PX, START_PX2, moments)
        rr, rc, cc = moments[np.isfinite(moments[:, 0])].T
        if rr.size < LEAST_STARS:
            return None
        half = np.hypot(0.5 * (rr - cc), rc)
        short = float(np.median(0.5 * (rr + cc) - half))
        return cls(
            short_px=math.sqrt(max(short, LEAST_VARIANCE_PX2) - PIXEL_VARIANCE_PX2),
            drawn_px=math.sqrt(12.0 * 2.0 * float(np.median(half))),
            share=rr.size / len(peaks),
        )
