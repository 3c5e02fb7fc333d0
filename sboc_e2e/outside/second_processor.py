"""Work on a large frame that is done beside other work, where there are two processors."""

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache, partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Final

from sboc_e2e.icd.errors import SbocError, UserError

PR_SET_PDEATHSIG: Final = 1  # number of an option of Linux's prctl(2): the signal to a process whose parent has ended

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


class Companion:
    """A process beside this one. It is told things and replies, each in order."""

    def __init__(self, process: BaseProcess, pipe: Connection) -> None:
        self._process = process
        self._pipe = pipe

    def tell(self, value: Any) -> None:
        """Tell it something; what it does not live to hear is told in `reply`."""
        with suppress(BrokenPipeError):
            self._pipe.send(value)

    def reply(self) -> Any:
        """Wait for its next reply. Raises what went wrong in it."""
        try:
            failed, value = self._pipe.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            code = self._process.exitcode
            raise UserError(f"a process of this command was ended from outside (exit code {code}); was memory short?") from None
        if failed:
            raise value
        return value


@contextmanager
def companion(function: Callable[..., Iterator[Any]], *arguments: Any) -> Iterator[Companion]:
    """A process that gives what a generator yields; it is ended when this is left, and ends with this process.

    function : of what waits for the next thing told, and the arguments.
    """
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_converse, args=(os.getpid(), here, there, function, arguments), daemon=True)
    process.start()
    there.close()
    try:
        yield Companion(process, here)
    finally:
        here.close()
        process.terminate()
        process.join()


def _converse(
    parent: int, here: Connection, there: Connection, function: Callable[..., Iterator[Any]], arguments: tuple[Any, ...]
) -> None:
    """What the process does."""
    here.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever interrupts the command ends its first process, and that one this
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        return
    try:
        for value in function(there.recv, *arguments):
            there.send((False, value))
    except Exception as error:  # noqa: BLE001 - raised again in the process that waits
        error.add_note(traceback.format_exc())
        with suppress(OSError):
            there.send((True, _sendable(error)))


def _sendable(error: Exception) -> Exception:
    """An error that another process can raise."""
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 - its own
    except Exception:  # noqa: BLE001 - somebody else's error, whose text is kept
        return SbocError(f"{type(error).__name__}: {error}")
    return error


def _call(there: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """What the process does."""
    try:
        there.send(function(*arguments))
    except Exception:  # noqa: BLE001 - the one who waits makes the call again, and raises what it raises
        there.close()
