"""Compile the numerical kernels once, by running the smoke scenario into a folder that is then removed.

numba keeps what it compiled (`sboc_e2e.kernel_cache`), so that the first real run and benchmarks do not pay for it. A quarter of
the compilation is ground's. Where there are two cores, a second run compiles that part meanwhile: its simple detector reaches
ground early.
"""

import io
import os
import sys
import tempfile
import time
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing import get_context
from pathlib import Path

from sboc_e2e.cli.main import run


def main() -> int:
    """Run the smoke scenario and print how long it took: two minutes where all is to be compiled, seconds where nothing is."""
    with tempfile.TemporaryDirectory(prefix="sboc-warm-up-") as folder:
        start = time.perf_counter()
        beside = get_context("spawn").Process(target=_reach_ground_early, args=(folder,), daemon=True)
        if (os.cpu_count() or 1) > 1:
            beside.start()
        code = run(["run", "smoke", "--out", str(Path(folder) / "run"), "--workers", "1"])
        if beside.pid is not None:
            beside.terminate()
            beside.join()
    if code == 0:
        print(f"warm-up: {time.perf_counter() - start:.1f} s")
    return code


def _reach_ground_early(folder: str) -> None:
    """Nobody looks at its result: what it fails to compile, the full run compiles and reports."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        run(["run", "smoke", "--use", "onboard.detector=threshold", "--out", str(Path(folder) / "early"), "--workers", "1"])


if __name__ == "__main__":
    sys.exit(main())
