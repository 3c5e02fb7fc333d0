"""How fast this machine is just now: the same work every time, none of it the project's own.

Processors differ by factors of two, and so does one processor on different days. CPU seconds of a benchmark mean something only
beside those of work that never changes; `baseline` compares timings in units of it.
"""

import statistics
import time
from typing import Final

import numpy as np
from scipy import ndimage

NAME: Final = "yardstick_s"
PIXELS: Final = 1 << 22
"""Those of a float32 image of 2048 x 2048 px, 16 MB: passes go through memory. Another number makes stored baselines useless."""
REPEATS: Final = 3  # The median of three, 0.2 CPU-s each, leaves out one that was disturbed. Chosen, not measured.


def yardstick_s() -> float:
    """CPU seconds of this thread for a sort, a separable filter and passes over 16 MB, median of three."""
    image = np.random.default_rng(0).random((1024, PIXELS // 1024), dtype=np.float32)
    spent = []
    for _ in range(REPEATS):
        began = time.thread_time()
        np.sort(image.ravel()[: PIXELS // 4])
        ndimage.gaussian_filter(image, 1.5, output=np.empty_like(image))
        for _ in range(8):
            image = image * np.float32(0.5) + np.float32(0.25)
        spent.append(time.thread_time() - began)
    return statistics.median(spent)
