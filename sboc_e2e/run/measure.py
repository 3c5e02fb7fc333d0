"""What a stage costs: wall and CPU seconds without compilation of kernels, and the peak memory of the process while it ran."""

import resource
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from types import TracebackType
from typing import Any, Final

from numba.core import event

_STATUS: Final = Path("/proc/self/status")
_CLEAR: Final = Path("/proc/self/clear_refs")


class _Compilation(event.Listener):
    """Adds up what this process spends on compiling kernels; a kernel compiles those that it calls, so events nest."""

    def __init__(self) -> None:
        self.cpu_s = 0.0
        self.wall_s = 0.0
        self._depth = 0
        self._cpu = 0.0
        self._wall = 0.0

    def on_start(self, event: Any) -> None:
        """A kernel that is stored nowhere begins to be compiled."""
        if self._depth == 0:
            self._wall, self._cpu = time.perf_counter(), time.process_time()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """It is compiled."""
        self._depth -= 1
        if self._depth == 0:
            self.wall_s += time.perf_counter() - self._wall
            self.cpu_s += time.process_time() - self._cpu


COMPILATION: Final = _Compilation()
event.register("numba:compile", COMPILATION)


def reset_peak() -> None:
    """Start a new peak where the system can do that (Linux); elsewhere the peak is that of the whole process."""
    try:
        _CLEAR.write_text("5")
    except OSError:
        return


def peak_rss_mb() -> float:
    """Largest resident set since `reset_peak`, in MB of 10^6 bytes."""
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    except (OSError, ValueError):
        pass
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


@dataclass(kw_only=True)
class Meter:
    """Adds up the cost of blocks, ``with meter: ...``, and keeps the CPU seconds of each.

    Compilation happens once on a machine and is no part of the chain: it is counted apart (`compile_cpu_s`).
    """

    wall_s: float = 0.0
    cpu_s: float = 0.0
    compile_cpu_s: float = 0.0
    blocks_cpu_s: list[float] = field(default_factory=list)
    _wall: float = 0.0
    _cpu: float = 0.0
    _compile_wall: float = 0.0
    _compile_cpu: float = 0.0

    def __enter__(self) -> "Meter":
        self._compile_wall, self._compile_cpu = COMPILATION.wall_s, COMPILATION.cpu_s
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        compile_cpu_s = COMPILATION.cpu_s - self._compile_cpu
        self.wall_s += time.perf_counter() - self._wall - (COMPILATION.wall_s - self._compile_wall)
        cpu_s = time.process_time() - self._cpu - compile_cpu_s
        self.compile_cpu_s += compile_cpu_s
        self.cpu_s += cpu_s
        self.blocks_cpu_s.append(cpu_s)


def stage_figures(
    *, wall_s: float, cpu_s: float, frames_cpu_s: list[float], peak_mb: float, compile_cpu_s: float
) -> dict[str, float]:
    """Figures of a stage for the manifest. After a resume they cover the frames of the last attempt; `timed_frames` is their
    number.

    wall_s, cpu_s, frames_cpu_s : without compilation; the last for each frame. compile_cpu_s : what compilation took.
    """
    figures = {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "compile_cpu_s": compile_cpu_s,
        "timed_frames": len(frames_cpu_s),
        "peak_rss_mb": round(peak_mb, 1),
    }
    if frames_cpu_s:
        figures["median_frame_cpu_s"] = median(frames_cpu_s)
    return {name: round(value, 6) for name, value in figures.items()}
