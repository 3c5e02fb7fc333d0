"""The on-board software alone in a process, as it would fly.

``python -m tests.benchmarks.onboard_process FOLDER DETECTOR [TRACKER [FRAMES]]``: FOLDER holds `calibration.pickle`,
`camera.pickle` and frames 0.pickle, 1.pickle, ... Where more FRAMES are asked for than there are, they come again, one ADU
brighter each time. Prints resident memory (MB of 10^6 bytes) stage by stage as JSON. Nothing but the interpreter is loaded before
the first figure. Started with `ENVIRONMENT`. The process can't load what the steps do without (`LEFT_OUT`).
"""

import json
import pickle
import resource
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

STATUS = Path("/proc/self/status")
ENVIRONMENT = {"MALLOC_MMAP_THRESHOLD_": str(1 << 14)}
"""Images are given back to the system when they are freed: by itself glibc keeps up to 30 MB of them between frames."""

LEFT_OUT = ("scipy",)
"""Not installed where the default steps fly. Numba loads its linear algebra wherever it is, 18 MB that no kernel calls. The codec
`rans` is the one thing on board that needs it."""

PERIOD_NS = 250_000_000
"""Frames repeat at four a second, as the presets make them."""

DETECTORS = {"threshold": "ThresholdDetector", "line_integral": "LineIntegralDetector"}
TRACKERS = {
    "none": ("onboard.track.none", "NoTracker"),
    "joint": ("onboard.track.joint", "JointTracker"),
    "joint_and_stack": ("onboard.track.joint_and_stack", "JointAndStackTracker"),
}


class NoDetector:
    """Finds nothing: the chain's own cost."""

    history_frames = 0

    def detect(self, view: Any) -> tuple[Any, ...]:
        """Nothing."""
        return ()


def memory_mb(field: str) -> float:
    """`VmRSS` (now) or `VmHWM` (peak since the last reset) of this process; elsewhere than on Linux the peak of its life."""
    if not STATUS.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(field))
    return int(line.split()[1]) * 1024 / 1e6


def reset_peak() -> None:
    """Start a new peak where that is possible."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def _small_frames(chain_type: Any, options: Any, steps: Any, camera: Any) -> None:
    """Two frames of 256 x 256 with stars and a trail, so that every compiled kernel is in memory."""
    import numpy as np

    from sboc_e2e.icd.frame import Frame, FrameHeader

    side = 256
    chain = chain_type(options, steps, calibration=None, camera=camera, run_id=1)
    state = chain.initial_state()
    for number in range(2):
        rng = np.random.default_rng(number)
        pixels = rng.normal(260.0, 2.4, (side, side))
        row, col = np.indices((side, side), dtype=float)
        for star in range(40):
            at = (6.0 * star + 5.0, (37.0 * star) % 240.0 + 8.0)
            pixels += 60.0 * (1 + star % 5) * np.exp(-0.5 * ((row - at[0]) ** 2 + (col - at[1]) ** 2) / 0.8)
        pixels += 4.0 * np.exp(-0.5 * ((row - 30.0 - 20.0 * number - 0.7 * col) / 0.9) ** 2)
        header = FrameHeader(
            frame=number, t_start_tai_ns=2_000_000_000_000_000_000 + number * 250_000_000, exposure_ns=200_000_000,
            line_time_ns=10_000, rows=side, cols=side, gain_e_adu=1.2, read_noise_e=2.3, saturation_adu=32000.0,
        )  # fmt: skip
        state, _ = chain.process(state, Frame(header=header, pixels=np.rint(pixels).astype(np.uint16)))


def _frame(folder: Path, number: int, n_files: int) -> Any:
    """Frame `number` of a run of any length from a few files."""
    from dataclasses import replace

    import numpy as np

    frame = pickle.loads((folder / f"{number % n_files}.pickle").read_bytes())  # noqa: S301 - written by the benchmark
    turn = number // n_files
    later = frame.header.t_start_tai_ns + turn * n_files * PERIOD_NS
    header = replace(frame.header, frame=number, t_start_tai_ns=later)
    return replace(frame, header=header, pixels=frame.pixels + np.uint16(turn)) if turn else frame


def main(folder: Path, detector: str, tracker: str = "none", n_frames: str = "0") -> dict[str, Any]:
    """Memory after each stage, the peak while frames are processed, and the median CPU-seconds of a frame from the third on.

    `peaks` : of each frame.
    """
    sys.modules.update(dict.fromkeys(LEFT_OUT))  # an import of it fails
    out: dict[str, Any] = {"interpreter": memory_mb("VmRSS")}
    import_module("numba")
    out["numpy_and_numba"] = memory_mb("VmRSS")
    from onboard.chain import OnboardChain, OnboardSteps
    from onboard.downlink.codec import PlanesCodec
    from onboard.image.background import MeshBackground
    from onboard.options import OnboardOptions
    from onboard.stars.matched import MatchedStars

    found = NoDetector if detector == "none" else getattr(import_module("onboard.detect"), DETECTORS[detector])
    out["libraries"] = memory_mb("VmRSS")
    module, name = TRACKERS[tracker]
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=found(), codec=PlanesCodec(),
        tracker=getattr(import_module(module), name)(),
    )  # fmt: skip
    _small_frames(OnboardChain, OnboardOptions(), steps, pickle.loads((folder / "camera.pickle").read_bytes()))  # noqa: S301 - as above
    out["libraries_and_kernels"] = memory_mb("VmRSS")
    calibration = pickle.loads((folder / "calibration.pickle").read_bytes())  # noqa: S301 - written by the benchmark
    chain = OnboardChain(OnboardOptions(), steps, calibration=calibration, camera=calibration.camera, run_id=1)
    del calibration
    out["calibrated"] = memory_mb("VmRSS")
    state, peaks, cpu_s = chain.initial_state(), [], []
    n_files = len(list(folder.glob("[0-9]*.pickle")))
    for number in range(int(n_frames) or n_files):
        frame = _frame(folder, number, n_files)
        reset_peak()
        start = time.process_time()
        state = chain.process(state, frame)[0]
        cpu_s.append(time.process_time() - start)
        peaks.append(memory_mb("VmHWM"))
    out["after_frames"] = memory_mb("VmRSS")
    out["peak"], out["peaks"] = max(peaks[1:]), [round(peak, 1) for peak in peaks]
    out["cpu_s_per_frame"] = sorted(cpu_s[2:])[len(cpu_s[2:]) // 2]
    return out


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), *sys.argv[2:])))  # noqa: T201 - the script's result
