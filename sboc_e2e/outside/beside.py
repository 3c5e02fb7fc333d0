"""Work on a large frame that is done beside other work, where there are two processors."""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from multiprocessing.connection import Connection
from typing import Any, Final

LEAST_PX: Final = 1 << 20
"""Pixels of a frame from which on work beside is worth its start: a megapixel's stars take a tenth of a second. Chosen."""

MOST_PX: Final = 36_000_000
"""Pixels of a frame up to which two searches at once find the memory, 500 MB more. Chosen: frames of 6000 x 6000."""


def is_worth(n_pixels: int) -> bool:
    """Whether to work beside on a frame of so many pixels. Elsewhere than on Linux a process cannot be forked safely."""
    return LEAST_PX <= n_pixels <= MOST_PX and sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1


@contextmanager
def threaded(*, worth: bool) -> Iterator[Callable[..., Callable[[], Any]]]:
    """What begins a call in a thread and gives what waits for its result; calls are made one after the other.

    Where it is not worth a thread, a call is made once its result is wanted.
    """
    if not worth:
        yield lambda function, *arguments: cache(partial(function, *arguments))
        return
    with ThreadPoolExecutor(max_workers=1) as pool:
        yield lambda function, *arguments: pool.submit(function, *arguments).result


def forked(function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
    """Begin a call in a forked process; what waits for its result, which is pickled. A call that fails there is made here."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_call, args=(there, function, arguments), daemon=True)
    child.start()
    there.close()

    def result() -> Any:
        try:
            return here.recv()
        except EOFError:
            return function(*arguments)
        finally:
            child.join()

    return result


def _call(there: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """What the process does."""
    try:
        there.send(function(*arguments))
    except Exception:  # noqa: BLE001 - the one who waits makes the call again, and raises what it raises
        there.close()
