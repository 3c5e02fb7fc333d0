"""The PSF of a wavefront with its halo over the field, as tables that are quick to draw from.

A table holds the light of a point in pixels at all sub-pixel places of a grid of 1/8 px, out to 7 px; farther out light is
drawn from closed forms (`simulator.optics.halo`). Tables stand on a grid so fine that neighbours differ by about a per cent.
"""

import math
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.special import j1

from simulator.optics.halo import Halo
from simulator.optics.passband import Passband
from simulator.optics.wavefront import NODES, PERIOD_PX, WavefrontOptions, frequencies_px, transfer_functions

Array = NDArray[np.float64]

HALF_PX: Final = 7  # half side of a table; closed forms go on from there. Time grows with its square; chosen, not measured
PHASES: Final = 8  # table nodes per px; bilinear values between them widen a table by a known variance (see `_GRID_VARIANCE`)
GRID: Final = 13
"""Tables along either axis of the field."""
LARGEST_DISC_PX: Final = 5.0
"""Blur discs up to this diameter are part of a table; in larger ones the wavefront does not show."""
_SUPPORT: Final = np.arange(2 * HALF_PX * PHASES + 1) / PHASES - HALF_PX
_SQUARE: Final = np.maximum(np.abs(_SUPPORT)[:, None], np.abs(_SUPPORT))
_HIGHEST: Final = 2.4
"""Cycles per pixel beyond which a PSF of 0.3 px and the pixel pass less than 1e-4."""
# Bilinear values between the grid's points widen a table by step^2 / 6 along either axis.
_GRID_VARIANCE: Final = 1.0 / (6.0 * PHASES**2)


@lru_cache(maxsize=4)
def field_functions(
    options: WavefrontOptions, band: Passband, f_number: float, pixel_um: float, obstruction: float, seed: int
) -> NDArray[np.complex64]:
    """OTFs at the frequencies of the tables; the last ones are kept, because they take a second."""
    return transfer_functions(options, band, f_number, pixel_um, obstruction, seed, frequencies_px(_HIGHEST))


class PsfField:
    """Tables of a camera's PSF over its window.

    otf : (NODES, NODES, n, n) of the wavefront; None: a point. sigma_px : (GRID, GRID) Gaussian sigmas at the places of the grid
    that blur it. place : rows and cols (k,) of positions in units of the grid.
    """

    def __init__(
        self,
        otf: NDArray[np.complex64] | None,
        sigma_px: Array,
        halo: Halo,
        place: Callable[[Array, Array], Array],
        obstruction: float,
    ) -> None:
        self._sigma_px, self.halo, self._place, self._obstruction = sigma_px, halo, place, obstruction
        self._frequency = frequencies_px(_HIGHEST)
        wave = np.exp(2j * np.pi * _SUPPORT[:, None] * self._frequency) / PERIOD_PX
        self._wave = wave.astype(np.complex64)
        self._otf = None if otf is None else self._centred(otf)
        distance = np.hypot(_SUPPORT[:, None], _SUPPORT)
        # Rings outside the period come back into it, about evenly.
        self._folded = 2.0 * np.pi**1.5 * halo.rim_px / PERIOD_PX**3
        self._fixed = (halo.aureole(distance) + halo.spikes(_SUPPORT[:, None], _SUPPORT)).astype(np.float32)
        self.tables = self._all(0.0)
        self.reach = reach_of(self.tables.max(axis=0))
        self._wider = lru_cache(maxsize=2)(self._all)
        self._single = lru_cache(maxsize=64)(self._one)

    def node(self, row: Array, col: Array) -> NDArray[np.int64]:
        """Number of the table nearest to places (n,)."""
        place = np.clip(np.rint(self._place(row, col)), 0, GRID - 1).astype(np.int64)
        return np.asarray(place[0] * GRID + place[1])

    def spread(self, node: NDArray[np.int64], variance_px2: Array) -> NDArray[np.float32]:
        """Tables, (GRID * GRID, n, n), blurred further by the mean variance of the stars at each node.

        A Gaussian blur acts on all frequencies as exp(-2 pi^2 v nu^2); between 0 and the next power of two above the largest
        variance tables are mixed linearly, which gives the variance exactly and the shape to (v / sigma^2)^2 / 4.
        """
        largest = float(variance_px2.max(initial=0.0))
        if largest < 1e-5:
            return self.tables
        end = 2.0 ** math.ceil(math.log2(largest))
        count = np.bincount(node, minlength=GRID * GRID)
        mean = np.bincount(node, weights=variance_px2, minlength=GRID * GRID) / np.maximum(count, 1)
        share, wider = (mean / end).astype(np.float32), self._wider(end)
        out = np.empty_like(self.tables)
        for k in range(len(out)):  # one by one: whole products would be three times as large as the tables
            out[k] = (np.float32(1.0) - share[k]) * self.tables[k] + share[k] * wider[k]
        return out

    def at(self, node: int, extra_px2: float, disc_px: float) -> NDArray[np.float32]:
        """One table with a Gaussian variance more (less, if negative) and a blur disc."""
        if extra_px2 == 0.0 and disc_px < 0.05:
            return np.asarray(self.tables[node])
        return self._single(node, round(extra_px2, 3), round(disc_px, 2))

    def sigma_at(self, row: Array, col: Array) -> Array:
        """Sigma of the Gaussian, before pixels, whose noise-equivalent area is that of the table, linear between places."""
        return np.asarray(map_coordinates(self._equivalent_px, self._place(row, col), order=1, mode="nearest"))

    @cached_property
    def _equivalent_px(self) -> Array:
        squares = (self.tables.astype(np.float64) ** 2).sum(axis=(1, 2)) / PHASES**2
        return np.sqrt(np.maximum(1.0 / (4.0 * np.pi * squares) - 1.0 / 12.0, 1e-4)).reshape(GRID, GRID)

    def _centred(self, otf: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """OTFs whose images a Gaussian as wide as they are finds at the star's place; the rest is part of a camera's distortion.

        The maximum of the Gaussian's overlap, by fixed-point steps: twice the mean offset under the Gaussian's weight.
        """
        out = otf.copy()
        nu2 = self._frequency[:, None] ** 2 + self._frequency**2
        every = (GRID - 1) // (NODES - 1)
        for i in range(NODES):
            for j in range(NODES):
                variance = float(self._sigma_px[i * every, j * every]) ** 2
                transfer = otf[i, j] * np.exp(-2.0 * np.pi**2 * variance * nu2)
                image = (self._wave @ transfer.astype(np.complex64) @ self._wave.T).real
                width2 = PHASES**2 / (4.0 * np.pi * float((image**2).sum()))
                shift = np.zeros(2)
                for _ in range(12):
                    weight = [np.exp(-0.5 * (_SUPPORT - d) ** 2 / width2) for d in shift]
                    total = weight[0] @ image @ weight[1]
                    row = (weight[0] * (_SUPPORT - shift[0])) @ image @ weight[1] / total
                    col = weight[0] @ image @ (weight[1] * (_SUPPORT - shift[1])) / total
                    shift += 2.0 * np.array([row, col])
                ramp = [np.exp(2j * np.pi * self._frequency * d) for d in shift]
                out[i, j] *= (ramp[0][:, None] * ramp[1]).astype(np.complex64)
        return out

    def _all(self, extra_px2: float) -> NDArray[np.float32]:
        first = self._one(0, extra_px2, 0.0)
        out = np.empty((GRID * GRID, *first.shape), dtype=np.float32)
        out[0] = first
        for k in range(1, GRID * GRID):
            out[k] = self._one(k, extra_px2, 0.0)
        return out

    def _one(self, node: int, extra_px2: float, disc_px: float) -> NDArray[np.float32]:
        """The table of a node: its OTF between the nearest ones of the wavefront, times Gaussian, disc and pixel."""
        row, col = divmod(node, GRID)
        nu2 = self._frequency[:, None] ** 2 + self._frequency**2
        variance = max(float(self._sigma_px[row, col]) ** 2 + extra_px2 - _GRID_VARIANCE, 1e-3)
        blur = np.exp(-2.0 * np.pi**2 * variance * nu2) * np.sinc(self._frequency)[:, None] * np.sinc(self._frequency)
        if disc_px > 0.0:
            blur = blur * _disc_otf(np.sqrt(nu2), disc_px, self._obstruction)
        transfer = blur.astype(np.complex64)
        if self._otf is not None:
            y, x = row * (NODES - 1) / (GRID - 1), col * (NODES - 1) / (GRID - 1)
            i, j = min(int(y), NODES - 2), min(int(x), NODES - 2)
            low = self._otf[i, j] * (j + 1 - x) + self._otf[i, j + 1] * (x - j)
            high = self._otf[i + 1, j] * (j + 1 - x) + self._otf[i + 1, j + 1] * (x - j)
            transfer = transfer * (low * (i + 1 - y) + high * (y - i)).astype(np.complex64)
        table = (self._wave @ transfer @ self._wave.T).real
        return np.asarray(np.maximum(self.halo.core_share * (table - self._folded), 0.0) + self._fixed, dtype=np.float32)


def reach_of(table: NDArray[np.float32]) -> Array:
    """Largest share of a pixel 0 to HALF_PX pixels (along an axis) or farther from the point: how far it has to be drawn."""
    return np.array([table[r - 1e-9 <= _SQUARE].max() for r in range(HALF_PX + 1)], dtype=np.float64)


def _disc_otf(frequency: Array, diameter_px: float, obstruction: float) -> Array:
    """Transform of a uniform annular disc."""

    def whole(d: float) -> Array:
        x = np.pi * d * np.maximum(frequency, 1e-9)
        return np.asarray(2.0 * j1(x) / x)

    inner = obstruction**2
    hole = inner * whole(obstruction * diameter_px) if obstruction > 0.0 else 0.0
    return np.asarray((whole(diameter_px) - hole) / (1.0 - inner))
