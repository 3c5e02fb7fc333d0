"""How long errors of stars stay in the focal length while the field moves over them.

A star displaced by its catalogue pulls the focal length one way where it enters the field and the other way where it leaves,
so a scan loses such errors faster than it loses stars. With stars even over a square field, each displaced at random, the
correlation of two frames is the autocorrelation of the weight that the focal length's estimate gives to a star at each place:
its derivative, orthogonal to those of attitude and distortion. Sums over a steady scan are what a long mean errs by, and a
first-order process with the correlation returned here has the same sum.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CELLS: Final = 48
"""Of the field along a side."""


def focal_correlation(moved_rows: float, moved_cols: float) -> float:
    """Correlation of the focal length's error by stars from one frame of a steady scan to the next.

    moved_rows, moved_cols : shares of the field's sides by which it moved; 0 of both is the same field, and has 1.
    """
    shift = np.abs(np.array([moved_rows, moved_cols]))
    largest = float(shift.max())
    if largest <= 0.0:
        return 1.0
    steps = np.arange(1, int(np.ceil(1.0 / largest)))
    place = steps[:, None] * shift * CELLS
    low = place.astype(np.int64)
    share = place - low
    table = _autocorrelation()
    seen = np.zeros(len(steps))
    for i, by_row in ((0, 1.0 - share[:, 0]), (1, share[:, 0])):
        for j, by_col in ((0, 1.0 - share[:, 1]), (1, share[:, 1])):
            seen += by_row * by_col * table[np.minimum(low[:, 0] + i, CELLS), np.minimum(low[:, 1] + j, CELLS)]
    together = 1.0 + 2.0 * float(seen.sum())
    return max((together - 1.0) / (together + 1.0), 0.0)


@lru_cache(maxsize=1)
def _autocorrelation() -> Array:
    """(CELLS + 1, CELLS + 1) by displacement along rows and cols, in cells; 1 at none."""
    middle = (np.arange(CELLS) + 0.5) / CELLS - 0.5
    row, col = np.meshgrid(middle, middle, indexing="ij")
    r2, zero, one = row * row + col * col, np.zeros_like(row), np.ones_like(row)
    # derivatives (row, col) of a star's place by the focal length, k1, k2, p1, p2 and the three angles of the attitude
    columns = np.array(
        [
            [row, col], [row * r2, col * r2], [row * r2**2, col * r2**2],
            [r2 + 2.0 * row**2, 2.0 * row * col], [2.0 * row * col, r2 + 2.0 * col**2],
            [one, zero], [zero, one], [col, -row],
        ]
    ).reshape(8, -1)  # fmt: skip
    weight = np.linalg.pinv(columns.T)[0].reshape(2, CELLS, CELLS)
    from scipy.signal import fftconvolve  # takes a fifth of a second, which frames without a solution do not need

    both = sum(fftconvolve(w, w[::-1, ::-1]) for w in weight)
    out = np.zeros((CELLS + 1, CELLS + 1))
    out[:CELLS, :CELLS] = both[CELLS - 1 :, CELLS - 1 :]
    return np.asarray(out / out[0, 0])
