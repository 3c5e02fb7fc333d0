"""A line against its own neighbourhood: its light in pieces, and the same pieces shifted to its sides.

A trail is brighter in each of its pieces than every place beside it, whatever the sky there is made of. Stars in a row, tracks
of clouds, roofs and spikes are so in some. No PSF, no noise and no class of false lines is needed to tell this.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import effective_width_px
from sboc_e2e.icd.products import StreakFit

TILE_PX: Final = 64
"""Side of the tiles in which counts around lines are kept."""
MOST_TILES: Final = 1024
"""Tiles of a frame, 16 MB: the brightest lines first. A mosaic with 20 trails of 1,000 to 1,900 px takes most of them."""
REACH_PX: Final = 28.0
"""What is kept to both sides of a line: six places beside a profile of 2 px. Of a wider one fewer are known."""

SIDES: Final = 6
"""Places on each side that a piece is held against."""
FIRST_WIDTHS: Final = 3.0
"""Distance of the first of them from the line in widths: a Gaussian has 0.3 % of its light beyond."""
STEP_WIDTHS: Final = 2.0
"""From one to the next."""
LEAST_STEP_PX: Final = 1.5
"""Least distance from one to the next: nearer places share their pixels."""
FEWEST_SIDES: Final = 5
"""Places beside a piece that must be known."""

PIECE_WIDTHS: Final = 4.0
"""Least length of a piece in widths, which is more than the full width of a star (2.35)."""
LEAST_PIECE_PX: Final = 6.0
"""Least length of a piece. Chosen, not measured."""
PIECE_SNR: Final = 4.0
"""S/N that a piece of an even trail has at least: the best of twelve places in white noise has 1.6."""
MOST_ALONG: Final = 64
"""Samples along a piece, at most: a budget of work. Across it they are half a width apart, or a pixel."""
MOST_PIECES: Final = 64
"""Pieces of a line, at most: a budget of work."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line that has no fit, such as one of the negative: ends, width (sigma, that of a pixel not included) and arc in px."""

    row0: float
    col0: float
    row1: float
    col1: float
    length_px: float
    width_px: float
    sagitta_px: float
    snr: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Tiles:
    """Counts of a frame near its lines.

    adu : (n, `TILE_PX`, `TILE_PX`) float32, NaN where no pixel saw the sky. slot : which of them is where, -1 for none.
    """

    adu: NDArray[np.float32]
    slot: NDArray[np.int32]

    @classmethod
    def of(
        cls,
        pixels: NDArray[Any],
        unknown: NDArray[np.bool_ | np.uint8],
        lines: Iterable[tuple[float, float, float, float]],
        adu_scale: float = 1.0,
    ) -> "Tiles":
        """Of an image (rows, cols) in units of `adu_scale` ADU: near lines (row0, col0, row1, col1), the first ones first."""
        slot = np.full([-(-side // TILE_PX) for side in pixels.shape], -1, dtype=np.int32)
        order: list[tuple[int, int]] = []
        for row0, col0, row1, col1 in lines:
            length = math.hypot(row1 - row0, col1 - col0)
            share = np.linspace(-REACH_PX, length + REACH_PX, 2 + int((length + 2.0 * REACH_PX) // REACH_PX)) / max(length, 1e-6)
            across = np.arange(-1, 2)[:, None] * REACH_PX / max(length, 1e-6)
            row = row0 + share * (row1 - row0) + across * (col1 - col0)
            col = col0 + share * (col1 - col0) - across * (row1 - row0)
            places = np.unique(np.floor(np.stack((row, col), axis=-1).reshape(-1, 2) / TILE_PX).astype(np.int64), axis=0)
            for i, j in places.tolist():
                if 0 <= i < slot.shape[0] and 0 <= j < slot.shape[1] and slot[i, j] < 0 and len(order) < MOST_TILES:
                    slot[i, j] = len(order)
                    order.append((i, j))
        adu = np.full((len(order), TILE_PX, TILE_PX), np.nan, dtype=np.float32)
        for tile, (i, j) in zip(adu, order, strict=True):
            box = slice(i * TILE_PX, (i + 1) * TILE_PX), slice(j * TILE_PX, (j + 1) * TILE_PX)
            counts = np.where(unknown[box] != 0, np.float32(np.nan), pixels[box].astype(np.float32) * np.float32(adu_scale))
            tile[: counts.shape[0], : counts.shape[1]] = counts
        return cls(adu=adu, slot=slot)

    def at(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float32]:
        """Counts of the nearest pixels; NaN where they are not kept."""
        r, c = np.rint(row).astype(np.int64), np.rint(col).astype(np.int64)
        i, j = r // TILE_PX, c // TILE_PX
        inside = (i >= 0) & (j >= 0) & (i < self.slot.shape[0]) & (j < self.slot.shape[1])
        slot = np.where(inside, self.slot[np.where(inside, i, 0), np.where(inside, j, 0)], -1)
        if not len(self.adu):
            return np.full(slot.shape, np.nan, dtype=np.float32)
        return np.where(slot >= 0, self.adu[slot, r % TILE_PX, c % TILE_PX], np.float32(np.nan))


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """How a line stands out of its neighbourhood.

    pieces : of the line that tell. wins : share of them that are brighter than each place beside them. peak : median height of a
    piece above the nearest places on both sides, over its height above the median of all, -1 to 1.
    """

    pieces: int
    wins: float
    peak: float

    @classmethod
    def of(cls, fit: StreakFit | Line, tiles: Tiles) -> "Contrast | None":
        """Of a line; None where the tiles do not tell."""
        length, width = fit.length_px, effective_width_px(fit.width_px)
        if not length > 0.0 or not math.isfinite(length + width + fit.sagitta_px):
            return None
        most = min(length / max(PIECE_WIDTHS * width, LEAST_PIECE_PX), (fit.snr / PIECE_SNR) ** 2, MOST_PIECES)
        light = light_of_pieces(fit, tiles, max(int(most), 1))
        middle, sides = light[SIDES], np.delete(light, SIDES, axis=0)
        told = np.isfinite(middle) & (np.isfinite(sides).sum(axis=0) >= FEWEST_SIDES)
        told &= np.isfinite(light[[SIDES - 1, SIDES - 2, SIDES + 1, SIDES + 2]]).any(axis=0)
        if not told.any():
            return None
        light, middle, sides = light[:, told], middle[told], sides[:, told]
        near = np.nanmax(light[[SIDES - 2, SIDES - 1, SIDES + 1, SIDES + 2]], axis=0)
        height = middle - np.nanmedian(sides, axis=0)
        peak = np.median((middle - near) / np.maximum(height, 1e-6))
        wins = np.mean(middle > np.nanmax(sides, axis=0))
        return cls(pieces=int(told.sum()), wins=float(wins), peak=float(np.clip(peak, -1.0, 1.0)))


def places_beside(width_px: float) -> NDArray[np.float64]:
    """Distances (`SIDES`,) of the places on each side of a line, px."""
    return FIRST_WIDTHS * width_px + max(STEP_WIDTHS * width_px, LEAST_STEP_PX) * np.arange(SIDES, dtype=np.float64)


def light_of_pieces(fit: StreakFit | Line, tiles: Tiles, n: int) -> NDArray[np.float64]:
    """Mean counts of n equal pieces of a line, in row `SIDES`, and of the same pieces beside it, (2 `SIDES` + 1, n).

    NaN where less than half of a piece is known. The line has a length.
    """
    length, width = fit.length_px, effective_width_px(fit.width_px)
    per_piece = min(max(int(length / n), 2), MOST_ALONG)
    share = (np.arange(n * per_piece) + 0.5) / (n * per_piece)
    away = places_beside(width)
    place = np.concatenate((-away[::-1], [0.0], away))
    apart = max(1.0, width / 2.0)
    fine = apart * np.arange(-math.ceil(2.0 * width / apart), math.ceil(2.0 * width / apart) + 1.0)
    core = np.exp(-0.5 * (fine / width) ** 2)
    bend = 4.0 * fit.sagitta_px * share * (1.0 - share)
    across = (place[:, None] + fine)[:, :, None] + bend
    d_row, d_col = (fit.row1 - fit.row0) / length, (fit.col1 - fit.col0) / length
    value = tiles.at(
        fit.row0 + share * length * d_row + across * d_col, fit.col0 + share * length * d_col - across * d_row
    ).reshape(place.size, fine.size, n, per_piece)
    known = np.isfinite(value)
    weight = np.einsum("pfnk,f->pn", known, core)
    light = np.einsum("pfnk,f->pn", np.where(known, value, 0.0), core) / np.maximum(weight, 1e-9)
    light[weight < 0.5 * core.sum() * per_piece] = np.nan
    return np.asarray(light, dtype=np.float64)
