"""Pixels of a ROI group in trail axes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_frame import TrailFrame
from sboc_e2e.icd.products import StreakPixels


@dataclass(frozen=True, kw_only=True, eq=False)
class TrailPixels:
    """Usable pixels near the trail in its frame; all (n,) float64, electrons and px; index: into the ROI's lists."""

    frame: TrailFrame
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    value_e: NDArray[np.float64]
    variance_e2: NDArray[np.float64]
    index: NDArray[np.intp]

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> "TrailPixels":
        """The chosen pixels, in the order given."""
        if chosen.dtype == np.bool_:
            # numpy takes five arrays by number faster than it goes five times through a mask
            chosen = np.flatnonzero(chosen)
        return TrailPixels(
            frame=self.frame,
            u=self.u[chosen],
            v=self.v[chosen],
            value_e=self.value_e[chosen],
            variance_e2=self.variance_e2[chosen],
            index=self.index[chosen],
        )

    def without(self, removed: NDArray[np.intp]) -> "TrailPixels":
        """All pixels except those with the given ROI indices."""
        return self.take(~np.isin(self.index, removed))

    def in_frame(self, frame: TrailFrame) -> "TrailPixels":
        """The same pixels in other axes that differ by a shift and a turn."""
        turn_cos = self.frame.cos * frame.cos + self.frame.sin * frame.sin
        turn_sin = self.frame.cos * frame.sin - self.frame.sin * frame.cos
        u0, v0 = self.frame.to_trail(np.array([frame.row]), np.array([frame.col]))
        du, dv = self.u - u0[0], self.v - v0[0]
        return TrailPixels(
            frame=frame,
            u=du * turn_cos + dv * turn_sin,
            v=dv * turn_cos - du * turn_sin,
            value_e=self.value_e,
            variance_e2=self.variance_e2,
            index=self.index,
        )

    def in_blocks(self, length_px: float, width_px: float) -> "TrailPixels":
        """Means of the pixels in blocks of this length along u and width along v, weighted by their noise.

        index : of one pixel of each block.
        """
        across = np.floor((self.v - self.v.min()) / width_px).astype(np.int64)
        place = np.floor((self.u - self.u.min()) / length_px).astype(np.int64) * (int(across.max()) + 1) + across
        weight = 1.0 / self.variance_e2
        total = np.bincount(place, weight)
        lit = np.flatnonzero(total)
        one_of = np.zeros(total.size, dtype=np.intp)
        one_of[place] = self.index

        def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.bincount(place, weight * values)[lit] / total[lit]

        return TrailPixels(
            frame=self.frame,
            u=mean(self.u),
            v=mean(self.v),
            value_e=mean(self.value_e),
            variance_e2=1.0 / total[lit],
            index=one_of[lit],
        )

    def near(self, reach_px: float) -> "TrailPixels":
        """Pixels within `reach_px` of v = 0, by ascending u."""
        chosen = np.flatnonzero(np.abs(self.v) <= reach_px)
        return self.take(chosen[np.argsort(self.u[chosen], kind="stable")])


def usable_pixels(pixels: StreakPixels, frame: TrailFrame, reach_px: float) -> TrailPixels:
    """Pixels with finite value and noise within `reach_px` of the line v = 0."""
    u, v = frame.to_trail(pixels.row, pixels.col)
    usable = np.isfinite(pixels.variance_e2) & np.isfinite(pixels.value_e) & (pixels.variance_e2 > 0.0)
    index = np.flatnonzero(usable & (np.abs(v) <= reach_px))
    return TrailPixels(
        frame=frame,
        u=u[index],
        v=v[index],
        value_e=pixels.value_e[index].astype(np.float64),
        variance_e2=pixels.variance_e2[index].astype(np.float64),
        index=index,
    )
