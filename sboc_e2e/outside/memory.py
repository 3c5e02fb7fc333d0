"""Memory of frames that is used again instead of being fetched anew."""

import ctypes
from typing import Final

M_TRIM_THRESHOLD: Final = -1  # number of an option of glibc's mallopt(3)
M_MMAP_MAX: Final = -4  # number of an option of glibc's mallopt(3)
MOST_BYTES: Final = 2**31 - 1  # the largest value that mallopt takes


def keep_freed_memory() -> None:
    """Have the C library keep what is freed, where it is glibc.

    Arrays of a large frame come and go by the dozen. Otherwise the system clears new pages for each of them, which takes a
    second of a frame of 4096 x 4096.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return
    mallopt(M_MMAP_MAX, 0)
    mallopt(M_TRIM_THRESHOLD, MOST_BYTES)
