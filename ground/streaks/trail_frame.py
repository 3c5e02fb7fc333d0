"""The trail's own axes: u along the chord, v across it, and where the chord leaves the image."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

EDGE_REACH_PX: Final = 20.0
"""An end flagged as the image's edge but farther than this from it, along the trail, is an ordinary end."""


@dataclass(frozen=True, kw_only=True)
class TrailFrame:
    """Origin (row, col) and direction (drow, dcol) = (sin, cos) of u; v is +90 deg from it, towards (+cos, -sin)."""

    row: float
    col: float
    cos: float
    sin: float

    @classmethod
    def of_chord(cls, row0: float, col0: float, row1: float, col1: float) -> "TrailFrame":
        """Origin at the middle of the chord; u along columns when both ends coincide."""
        length = math.hypot(row1 - row0, col1 - col0)
        cos, sin = ((col1 - col0) / length, (row1 - row0) / length) if length > 0.0 else (1.0, 0.0)
        return cls(row=0.5 * (row0 + row1), col=0.5 * (col0 + col1), cos=cos, sin=sin)

    @property
    def angle_rad(self) -> float:
        """atan2(drow, dcol) of u."""
        return math.atan2(self.sin, self.cos)

    def to_trail(self, row: NDArray[Any], col: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(u, v) of pixel positions."""
        drow, dcol = np.asarray(row, dtype=np.float64) - self.row, np.asarray(col, dtype=np.float64) - self.col
        return dcol * self.cos + drow * self.sin, drow * self.cos - dcol * self.sin

    def to_pixel(self, u: Any, v: Any) -> tuple[Any, Any]:
        """(row, col) of trail positions, numbers or arrays."""
        return self.row + u * self.sin + v * self.cos, self.col + u * self.cos - v * self.sin

    def turned(self, u: float, v: float, slope: float) -> "TrailFrame":
        """The frame whose origin is at (u, v) of this one and whose u runs along dv/du = slope."""
        row, col = self.to_pixel(u, v)
        norm = math.hypot(1.0, slope)
        cos, sin = (self.cos - slope * self.sin) / norm, (self.sin + slope * self.cos) / norm
        return TrailFrame(row=row, col=col, cos=cos, sin=sin)

    def image_limits(self, shape: tuple[int, int]) -> tuple[float, float]:
        """u at which the line v = 0 enters and leaves the image, whose pixels reach half a pixel beyond their centres."""
        low, high = -math.inf, math.inf
        for position, direction, size in ((self.row, self.sin, shape[0]), (self.col, self.cos, shape[1])):
            if abs(direction) < 1e-12:
                continue
            a, b = (-0.5 - position) / direction, (size - 0.5 - position) / direction
            low, high = max(low, min(a, b)), min(high, max(a, b))
        return low, high


def cut_ends(detection: Detection, shape: tuple[int, int]) -> tuple[bool, bool]:
    """Which ends the image's edge cuts off: flagged, and near enough to it along the trail to be believed.

    The detector flags what is near the edge in any direction. A trail that runs along an edge begins and ends within the image.
    """
    frame = TrailFrame.of_chord(detection.row0, detection.col0, detection.row1, detection.col1)
    low, high = frame.image_limits(shape)
    half = 0.5 * detection.length_px
    return (
        StreakFlag.EDGE0 in detection.flags and bool(-half - low < EDGE_REACH_PX),
        StreakFlag.EDGE1 in detection.flags and bool(high - half < EDGE_REACH_PX),
    )
