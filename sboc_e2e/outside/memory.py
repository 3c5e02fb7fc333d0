"""Memory that is not looked after for nothing: of frames, which is used again, and of libraries, which stays."""

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

M_TRIM_THRESHOLD: Final = -1  # number of an option of glibc's mallopt(3)
M_MMAP_MAX: Final = -4  # number of an option of glibc's mallopt(3)
MOST_BYTES: Final = 2**31 - 1  # the largest value that mallopt takes


@contextmanager
def uncollected() -> Iterator[None]:
    """No search for garbage meanwhile: while libraries are loaded there is none, and looking takes a tenth of the time.

    Nor is any looked for later in what was loaded.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.freeze()
            gc.enable()


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
