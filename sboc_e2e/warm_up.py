"""Compile the numerical kernels once, by running the smoke scenario into a folder that is then removed.

numba keeps what it compiled (`sboc_e2e.kernel_cache`), so that the first real run and benchmarks do not pay for it. With two
cores, a second process compiles the kernels of the detector and of the orbits, while this one compiles those of the linker and of
the fitter and then begins the run. These steps are called with the synthetic inputs of their exams, so that they need nothing of
the run. The run finds their kernels in numba's cache: it comes to the detector last of all.
"""

import io
import sys
import tempfile
import time
from contextlib import redirect_stdout
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from sboc_e2e.cli.main import run
from sboc_e2e.run.workers import worker_count


def main() -> int:
    """Run the smoke scenario and print how long it took: 90 s where all is to be compiled, seconds where nothing is."""
    with tempfile.TemporaryDirectory(prefix="sboc-warm-up-") as folder:
        start = time.perf_counter()
        print("Compiling numerical kernels, once, by a small run: 90 s on two free cores, more on busy ones.", flush=True)
        beside = get_context("spawn").Process(target=_detector_and_orbits, daemon=True)
        if worker_count(0) > 1:
            beside.start()
            _linker_and_fitter()
        with redirect_stdout(io.StringIO()):  # the figures of a run in a folder that is removed; what fails is said on stderr
            code = run(["run", "smoke", "--out", str(Path(folder) / "run"), "--workers", "1"])
        if beside.pid is not None:
            beside.terminate()
            beside.join()
    if code == 0:
        print(f"warm-up: {time.perf_counter() - start:.1f} s")
    return code


# `cli.main` has chosen the folder of the cache; modules with kernels are imported after it, in the functions below. Nobody looks
# at results: what they fail to compile, the run compiles and reports.


def _linker_and_fitter() -> None:
    from sboc_e2e.exams import fitter
    from sboc_e2e.exams.linker import linker_trial
    from sboc_e2e.exams.trails import trail

    trial = linker_trial(turn_rad_s=0.0, exposure_s=0.2)
    _default("ground.linker").link(trial.headers, trial.streaks)
    plain = trail((100.0, 100.0), 60.0, 30.0, 30.0, fitter.SHAPE, fitter.NOISE_E)
    _default("ground.streak_fitter").fit(*fitter.seen(plain, 0))


def _detector_and_orbits() -> None:
    import numpy as np

    from sboc_e2e.checks import synthetic_view
    from sboc_e2e.exams.linker import linker_trial
    from sboc_e2e.icd.frame import ObserverState

    detector = _default("onboard.detector")
    view = synthetic_view("streak", detector.history_frames)
    detector.detect(replace(view, history=tuple(detector.remembered(earlier) for earlier in view.history)))

    trial = linker_trial(turn_rad_s=0.0, exposure_s=0.2)
    headers = []
    for header in trial.headers:  # a circular orbit of 7,000 km, GPS fixes in the middle of exposures
        epoch_ns = header.t_start_tai_ns + header.exposure_ns // 2
        phase = (epoch_ns - trial.headers[0].t_start_tai_ns) * 1e-9 * 1.078e-3
        place_m = 7.0e6 * np.array([np.cos(phase), np.sin(phase), 0.0])
        speed_m_s = 7.546e3 * np.array([-np.sin(phase), np.cos(phase), 0.0])
        state = ObserverState(
            tai_ns=epoch_ns, position_m=place_m, velocity_m_s=speed_m_s, sigma_position_m=5.0, sigma_velocity_m_s=0.05
        )
        headers.append(replace(header, observer=state))
    tracklets = _default("ground.linker").link(headers, trial.streaks)
    _default("ground.orbit").estimate(tracklets[0], headers)


def _default(seam: str) -> Any:
    from sboc_e2e.registry import SEAMS, Registry

    return Registry().resolve(seam, SEAMS[seam].default)()


if __name__ == "__main__":
    sys.exit(main())
