"""Compile the numerical kernels once, by running the smoke scenario into a folder that is then removed.

numba keeps what it compiled (`sboc_e2e.kernel_cache`), so that the first real run and benchmarks do not pay for it. With two
cores, a second process meanwhile compiles half of the kernels: the detector's, the linker's and the fitter's. It calls these
steps with the synthetic inputs of their exams, so that it needs nothing of the run. The run finds them in numba's cache.
"""

import io
import os
import sys
import tempfile
import time
from contextlib import redirect_stdout
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from sboc_e2e.cli.main import run


def main() -> int:
    """Run the smoke scenario and print how long it took: two minutes where all is to be compiled, seconds where nothing is."""
    with tempfile.TemporaryDirectory(prefix="sboc-warm-up-") as folder:
        start = time.perf_counter()
        beside = get_context("spawn").Process(target=_compile_beside, daemon=True)
        if (os.cpu_count() or 1) > 1:
            beside.start()
        print("Compiling numerical kernels, once, by a small run: two minutes on two free cores, more on busy ones.", flush=True)
        with redirect_stdout(io.StringIO()):  # the figures of a run in a folder that is removed; what fails is said on stderr
            code = run(["run", "smoke", "--out", str(Path(folder) / "run"), "--workers", "1"])
        if beside.pid is not None:
            beside.terminate()
            beside.join()
    if code == 0:
        print(f"warm-up: {time.perf_counter() - start:.1f} s")
    return code


def _compile_beside() -> None:
    """Nobody looks at results: what this fails to compile, the run compiles and reports."""
    # `cli.main` has chosen the folder of the cache; modules with kernels are imported after it
    from sboc_e2e.checks import synthetic_view
    from sboc_e2e.exams import fitter
    from sboc_e2e.exams.linker import linker_trial
    from sboc_e2e.registry import SEAMS, Registry

    registry = Registry()
    made = {
        name: registry.resolve(name, SEAMS[name].default)()
        for name in ("onboard.detector", "ground.linker", "ground.streak_fitter")
    }
    detector = made["onboard.detector"]
    view = synthetic_view("streak", detector.history_frames)
    detector.detect(replace(view, history=tuple(detector.remembered(earlier) for earlier in view.history)))
    trial = linker_trial(turn_rad_s=0.0, exposure_s=0.2)
    made["ground.linker"].link(trial.headers, trial.streaks)
    next(fitter.questions(made["ground.streak_fitter"].fit))


if __name__ == "__main__":
    sys.exit(main())
