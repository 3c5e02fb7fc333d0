"""Particle hits are taken out of what a tracker sums: they light up one frame, far brighter than trails that no frame shows."""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.signals import UNKNOWN

HIT_CODE: Final = 104
"""6.5 sigma of a smoothed pixel. A trail of 10 px at the detector's 7.2 has 3.9 there: one in a hundred reaches this."""

REACH_SIGMAS: Final = 4.0
"""Pixels are blanked out to this many PSF widths from a bright pixel, where its light has fallen to a hundredth."""


@nb.njit(cache=True)
def _bright_row(values: NDArray[np.int8]) -> int:
    count = np.int32(0)
    for i in range(values.size):
        count += np.int32(values[i] >= np.int8(HIT_CODE))
    return int(count)


@nb.njit(cache=True)
def _bright_places(image: NDArray[np.int8]) -> NDArray[np.int64]:
    """Row and column (n, 2) of the pixels from HIT_CODE on."""
    counts = np.zeros(image.shape[0] + 1, np.int64)
    for row in range(image.shape[0]):
        counts[row + 1] = counts[row] + _bright_row(image[row])
    out = np.empty((counts[-1], 2), np.int64)
    for row in range(image.shape[0]):
        n = counts[row]
        if counts[row + 1] > n:
            for col in range(image.shape[1]):
                if image[row, col] >= HIT_CODE:
                    out[n, 0], out[n, 1] = row, col
                    n += 1
    return out


@nb.njit(cache=True)
def _blank(image: NDArray[np.int8], places: NDArray[np.int64], reach_px: int) -> None:
    rows, cols = image.shape
    for k in range(places.shape[0]):
        row, col = places[k]
        for i in range(max(0, row - reach_px), min(rows, row + reach_px + 1)):
            for j in range(max(0, col - reach_px), min(cols, col + reach_px + 1)):
                image[i, j] = UNKNOWN


def blank_hits(image: NDArray[np.int8], psf_sigma_px: float) -> None:
    """Put `UNKNOWN` about pixels of an image as `Searched.smooth` that are too bright for a trail that no frame shows. In place.

    Bright trails of light go too: frames show them one by one.
    """
    _blank(image, _bright_places(image), math.ceil(REACH_SIGMAS * psf_sigma_px))
