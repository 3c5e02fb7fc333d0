"""What every fuzz target shares: the memory limit, and the loop."""

import resource
import sys
from collections.abc import Callable

LIMIT_BYTES = 256_000_000
"""A parser may take this much memory beyond what the process holds when fuzzing starts."""


def limit_memory() -> None:
    """Let allocations beyond the limit fail with MemoryError, which a target does not catch."""
    with open("/proc/self/statm", encoding="ascii") as statm:  # noqa: PTH123 - one word of a kernel file
        held = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + LIMIT_BYTES, held + LIMIT_BYTES))


def fuzz(target: Callable[[bytes], None]) -> None:
    """Run a target under atheris with the arguments of the command line."""
    import atheris

    limit_memory()
    atheris.Setup(sys.argv, target)
    atheris.Fuzz()
