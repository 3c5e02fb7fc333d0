"""Hot pixels that are in no map, learned over frames: sharp peaks that do not move."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit, StarFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import StarList

SIGHTINGS = 3
"""Number of frames with a sharp peak at one pixel that make it a hot pixel."""

FORGET_FRAMES = 64  # eight sightings' worth of patience. Chosen, not measured
PATIENCE_FRAMES = 8
"""A candidate is forgotten when it was not seen for 8 frames per sighting, 64 at most: particle hits must not pile up."""
LOOKED_AT_FRAMES = 61
"""A learned pixel is masked, so that it cannot be seen. Once in so many frames it is looked at for one frame: one that is hot no
more goes. Not all are stars again in the same frame, nor those of a column: the number is prime. Chosen."""

CAPACITY = 50_000
"""Room for candidates, those seen most first: 1 MB, three in a thousand of 4096 x 4096 pixels."""


def window_of(header: FrameHeader) -> tuple[int, ...]:
    """What part of the detector a frame shows, and how it is binned."""
    return header.rows, header.cols, header.window_row0, header.window_col0, header.bin_rows, header.bin_cols


@dataclass(frozen=True, kw_only=True, eq=False)
class HotPixels:
    """Candidates and learned hot pixels of one part of the detector.

    pixel : flat indices, sorted; seen : sightings; last : frame of the last one. window : rows, columns, first row and column of
    the frames, and detector pixels per pixel along both: indices say nothing in another.
    """

    pixel: NDArray[np.int64]
    seen: NDArray[np.int32]
    last: NDArray[np.int64]
    frames: int = 0
    window: tuple[int, ...] = ()

    @classmethod
    def empty(cls, window: tuple[int, ...] = ()) -> "HotPixels":
        """Nothing learned yet."""
        return cls(pixel=np.zeros(0, np.int64), seen=np.zeros(0, np.int32), last=np.zeros(0, np.int64), window=window)

    def in_window(self, header: FrameHeader) -> "HotPixels":
        """These, or none where a frame shows another part of the detector."""
        window = window_of(header)
        return self if self.window == window else HotPixels.empty(window)

    def after(self, stars: StarList, shape: tuple[int, int]) -> "HotPixels":
        """State after a frame whose star list holds peaks sharper than the PSF."""
        sharp = (stars.flags & StarFlag.COSMIC_LIKE) != 0
        row = np.clip(np.rint(stars.row[sharp]), 0, shape[0] - 1).astype(np.int64)
        col = np.clip(np.rint(stars.col[sharp]), 0, shape[1] - 1).astype(np.int64)
        now = np.unique(row * shape[1] + col)
        pixel = np.union1d(self.pixel, now)
        seen, last = np.zeros(len(pixel), np.int32), np.zeros(len(pixel), np.int64)
        known = np.searchsorted(pixel, self.pixel)
        seen[known], last[known] = self.seen, self.last
        fresh = np.searchsorted(pixel, now)
        masked = self._masked()
        seen[known[(self.seen >= SIGHTINGS) & ~masked]] = SIGHTINGS - 1  # one that is looked at is hot again where it is seen
        seen[fresh] += 1
        last[fresh] = self.frames
        last[known[masked]] = self.frames  # they could not be seen
        keep = self.frames - last < np.minimum(PATIENCE_FRAMES * seen, FORGET_FRAMES)
        if np.count_nonzero(keep) > CAPACITY:
            keep &= seen >= np.partition(seen[keep], -CAPACITY)[-CAPACITY]
        pixel, seen, last = pixel[keep][:CAPACITY], seen[keep][:CAPACITY], last[keep][:CAPACITY]
        return replace(self, pixel=pixel, seen=seen, last=last, frames=self.frames + 1)

    def _masked(self) -> NDArray[np.bool_]:
        """Which pixels are taken for hot, without those whose turn it is to be looked at in the next frame."""
        looked_at = (self.pixel + self.frames) % LOOKED_AT_FRAMES == 0
        return np.asarray((self.seen >= SIGHTINGS) & ~looked_at)

    def learned(self) -> NDArray[np.int64]:
        """Flat indices of the pixels that are masked in the next frame."""
        return self.pixel[self._masked()]

    def mark(self, defects: NDArray[np.uint8]) -> None:
        """Set `MaskBit.LEARNED_HOT` on the learned pixels of the map of defects, which has the window's size."""
        defects[np.divmod(self.learned(), defects.shape[1])] |= np.uint8(MaskBit.LEARNED_HOT)
