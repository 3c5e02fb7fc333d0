"""Asking for memory changes nothing, wherever the place lies."""

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.prefetch import ask_for


@nb.njit
def _sum_while_asking(image: NDArray[np.int16], line: NDArray[np.float64], away: int) -> float:
    total = 0.0
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            ask_for(image, (i + away, j - away))
            ask_for(line, (away * i,))
            total += image[i, j] * line[j]
    return total


def test_places_inside_and_far_outside_do_no_harm() -> None:
    image, line = np.arange(12, dtype=np.int16).reshape(3, 4), np.ones(4)
    for away in (0, 1, -100, 10**6, 2**40):
        assert _sum_while_asking(image, line, away) == 66.0
        assert _sum_while_asking(image[:, ::-1], line, away) == 66.0
    assert (image == np.arange(12).reshape(3, 4)).all()
