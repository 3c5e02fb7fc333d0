"""The line of a fitted trail, a parabola over its chord, and where it leaves the image beyond an end."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ground.streaks.trail_frame import TrailFrame
from sboc_e2e.icd.products import StreakFit


@dataclass(frozen=True, kw_only=True)
class Arc:
    """A fitted line: a parabola over its chord, which goes on beyond both ends."""

    chord: TrailFrame
    half_px: float
    sagitta_px: float

    @classmethod
    def of(cls, fit: StreakFit) -> "Arc":
        """Of a fit as it is."""
        chord = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1)
        return cls(chord=chord, half_px=0.5 * fit.length_px, sagitta_px=fit.sagitta_px)

    def height_px(self, u: Any) -> Any:
        """Of the line over its chord (v of `TrailFrame`) at places along it, the middle 0: negative beyond the ends."""
        return self.sagitta_px * (1.0 - (u / max(self.half_px, 1.0)) ** 2)

    def border_px(self, end: int, shape: tuple[int, int]) -> float:
        """Place where the line leaves an image (rows, cols) beyond an end, px along the chord from the middle.

        Of a bent line it is found in steps of a pixel, from the end up to the farther corner.
        """
        low, high = self.chord.image_limits(shape)
        if self.sagitta_px == 0.0:
            return high if end else -low
        places = self.half_px + np.arange(sum(shape), dtype=np.float64)
        row, col = self.chord.to_pixel(places if end else -places, self.height_px(places))
        outside = (row < -0.5) | (col < -0.5) | (row > shape[0] - 0.5) | (col > shape[1] - 0.5)
        return float(places[max(int(np.argmax(outside)) - 1, 0)])
