"""Entry point `sboc`: runs a command and turns every failure into one line and an exit code.

0 done, 1 a check failed, 2 the user can mend it, 3 a plug-in or the program itself failed (traceback in the log file).
"""

import errno
import gc
import os
import select
import sys
import tempfile
import traceback
from pathlib import Path
from typing import Any, Final

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    # Worker processes parallelise; threads of libraries would only compete with them and change the order of sums.
    os.environ.setdefault(_variable, "1")

from sboc_e2e.kernel_cache import use_cache_of_these_sources

use_cache_of_these_sources()

import typer

# their commands join the application when they are imported
from sboc_e2e.cli import objects, outside, studies, validation  # noqa: F401
from sboc_e2e.cli.application import DONE, PROGRAM_ERROR, USER_ERROR, app
from sboc_e2e.icd.errors import PluginError, SbocError, UserError

USAGE_ERROR: Final[Any] = typer.BadParameter.__mro__[2]
"""Base of everything that the command-line parser complains about; its public name differs between versions of typer."""

INTERRUPTED: Final = 130
"""What the parser returns in place of a KeyboardInterrupt, without a word; no command has this exit code."""

MENDABLE: Final = {
    errno.ENOSPC: "free space and start again; a run goes on with --resume",
    errno.EDQUOT: "free space and start again; a run goes on with --resume",
    errno.EFBIG: "allow larger files (ulimit -f) and start again; a run goes on with --resume",
    errno.EROFS: "choose an --out that can be written",
    errno.EACCES: "choose an --out that can be written, or change its permissions",
    errno.EPERM: "choose an --out that can be written, or change its permissions",
    errno.ENAMETOOLONG: "choose a shorter path",
    errno.ENOTDIR: "choose an --out below a folder",
    errno.EISDIR: "a file is needed there, not a folder",
    errno.EEXIST: "a folder is needed there, not a file",
}


def main() -> None:
    """Run the command line and leave with an exit code."""
    code = run(sys.argv[1:])
    gc.freeze()  # what is left goes with the process: to look through all libraries for garbage takes half a second
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run a command; returns its exit code."""
    try:
        result = app(args=arguments, prog_name="sboc", standalone_mode=False)
        if result == INTERRUPTED:
            raise KeyboardInterrupt
        return result if isinstance(result, int) else DONE
    except typer.Exit as leave:
        return leave.exit_code
    except SystemExit as leave:
        # the parser catches a broken pipe itself and leaves with 1, which here means that a check failed
        if isinstance(leave.__context__, BrokenPipeError):
            return _without_reader(leave.__context__)
        raise
    except USAGE_ERROR as error:
        return _complain(error.format_message(), USER_ERROR)
    except (typer.Abort, KeyboardInterrupt):
        goes_on = "; --resume goes on after the last complete frame" if arguments[:1] == ["run"] else ""
        return _complain(f"interrupted{goes_on}", USER_ERROR)
    except PluginError as error:
        return _complain(f"{error} (traceback in {_log()})", PROGRAM_ERROR)
    except UserError as error:
        return _complain(str(error), USER_ERROR)
    except SbocError as error:
        return _complain(f"{error} (traceback in {_log()})", PROGRAM_ERROR)
    except BrokenPipeError as error:
        return _without_reader(error)
    except OSError as error:
        if error.errno in MENDABLE:
            path = error.filename2 or error.filename  # the second one of a renaming is what the user named
            where = f"{path}: " if path else ""
            return _complain(f"{where}{error.strerror}; {MENDABLE[error.errno]}", USER_ERROR)
        return _complain(f"{type(error).__name__}: {error} (traceback in {_log()})", PROGRAM_ERROR)
    except MemoryError:
        return _complain("out of memory; --workers 1 or a smaller detector need less", USER_ERROR)
    except Exception as error:  # noqa: BLE001 - the one place where a bug becomes a line and a log file
        return _complain(f"{type(error).__name__}: {error} (traceback in {_log()})", PROGRAM_ERROR)


def _complain(text: str, code: int) -> int:
    """One line on standard error."""
    line = " ".join(text.split())
    if sys.stderr is not None:  # None: the caller has closed it, and the exit code alone tells
        sys.stderr.write(f"sboc: {line}\n")
    return code


def _without_reader(error: BrokenPipeError) -> int:
    """The exit code after a broken pipe: done where who read the output has enough of it, as `head` has.

    Any other pipe leads to a process of the program, which then has ended too early.
    """
    closed = [stream for stream in (sys.__stdout__, sys.__stderr__) if stream is not None and _nobody_reads(stream.fileno())]
    if not closed:
        return _complain(f"{type(error).__name__}: {error} (traceback in {_log()})", PROGRAM_ERROR)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in closed:  # what is still in their buffers is written when the interpreter ends, and would fail again
        os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
    return DONE


def _nobody_reads(descriptor: int) -> bool:
    """Whether a descriptor is a pipe whose other end is closed."""
    watch = select.poll()
    watch.register(descriptor, select.POLLOUT)
    return any(event & (select.POLLERR | select.POLLHUP) for _, event in watch.poll(0))


def _log() -> Path | str:
    """Write the current traceback to a log file; its name."""
    for folder in (Path.cwd(), Path(tempfile.gettempdir())):
        path = folder / "sboc-error.log"
        try:
            path.write_text(traceback.format_exc(), encoding="utf-8")
        except OSError:
            continue
        return path
    return "no file: neither the working nor the temporary folder can be written"
