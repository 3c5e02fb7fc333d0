"""Image lag: charge that a photodiode does not give away in its own read-out and shows in the next frame.

A scientific CMOS sensor shows less than 0.05 % of a pixel's charge in the frame after, and nothing in later ones (GSENSE1516BSI:
Wu et al. 2023, arXiv 2303.08425). Charge that stays by chance is a thinned Poisson process: both parts are Poisson.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.radiation.hits import HitList
from simulator.sensor.options import SensorOptions

LEAST_E = 0.02
"""Lag below this many electrons is left out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lag:
    """Charge that stays behind. place : (n,) flat numbers of pixels, each once; electrons : (n,)."""

    place: NDArray[np.int64]
    electrons: NDArray[np.float32]


def lag_of(image_e: NDArray[np.float32], hits: HitList, origin: tuple[int, int], share: float, full_well_e: float) -> Lag:
    """What a frame leaves behind.

    image_e : (rows, cols) mean electrons of the window whose first pixel is `origin` of the detector; hits : particles.
    """
    rows, cols = image_e.shape
    flat = image_e.ravel()
    row, col = hits.row.astype(np.int64) - origin[0], hits.col.astype(np.int64) - origin[1]
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    struck, which = np.unique(row[inside] * cols + col[inside], return_inverse=True)
    by_particles = np.bincount(which, hits.charge_e[inside], minlength=len(struck))
    bright = _brighter(flat, np.float32(LEAST_E / share))
    at = np.searchsorted(bright, struck)
    new = np.append(bright, -1)[at] != struck
    place = np.insert(bright, at[new], struck[new])
    charge = flat[place].astype(np.float64)
    charge[np.searchsorted(place, struck)] += by_particles
    electrons = share * np.minimum(charge, full_well_e)
    kept = electrons >= LEAST_E
    return Lag(place=place[kept], electrons=electrons[kept].astype(np.float32))


def hand_on(image_e: NDArray[np.float32], own: Lag, before: Lag | None, share: float) -> None:
    """Take from an image what it leaves behind, and add what the frame before left, in place.

    What particles leave behind is not taken from their own frame.
    """
    flat = image_e.reshape(-1)
    flat[own.place] *= np.float32(1.0 - share)
    if before is not None:
        flat[before.place] += before.electrons


class LagBetweenFrames:
    """Charge that goes from one frame to the next. It remembers what the last frame left behind."""

    def __init__(self, options: SensorOptions) -> None:
        self._share = options.structure.lag
        self._origin = (options.window.row0, options.window.col0)
        self._full_well_e = options.converter.full_well_e
        self._last: tuple[int, Lag] | None = None

    def show(
        self,
        image_e: NDArray[np.float32],
        hits: HitList,
        index: int,
        light_and_hits: Callable[[int], tuple[NDArray[np.float32], HitList]],
    ) -> None:
        """`hand_on` for frame `index`, in place.

        image_e : (rows, cols) mean electrons; hits : particles. light_and_hits : both of any frame; called for the frame before
        unless that was the last one shown.
        """
        if self._share == 0.0:
            return
        own, before = self._left_by(image_e, hits), None
        if index > 0 and self._last is not None and self._last[0] == index - 1:
            before = self._last[1]
        elif index > 0:
            before = self._left_by(*light_and_hits(index - 1))
        hand_on(image_e, own, before, self._share)
        self._last = (index, own)

    def _left_by(self, image_e: NDArray[np.float32], hits: HitList) -> Lag:
        return lag_of(image_e, hits, self._origin, self._share, self._full_well_e)


@numba.njit(cache=True)
def _brighter(flat: NDArray[np.float32], least_e: np.float32) -> NDArray[np.int64]:
    """Numbers of the pixels at or above a level."""
    count = 0
    for k in range(flat.size):
        count += flat[k] >= least_e
    out = np.empty(count, np.int64)
    count = 0
    for k in range(flat.size):
        if flat[k] >= least_e:
            out[count] = k
            count += 1
    return out
