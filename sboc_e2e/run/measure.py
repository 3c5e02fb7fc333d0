"""What a stage costs: wall and CPU seconds, and the peak memory of the process while it ran."""

import resource
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from types import TracebackType
from typing import Final

_STATUS: Final = Path("/proc/self/status")
_CLEAR: Final = Path("/proc/self/clear_refs")


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
    """Adds up the cost of blocks, ``with meter: ...``, and keeps the CPU seconds of each."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    blocks_cpu_s: list[float] = field(default_factory=list)
    _wall: float = 0.0
    _cpu: float = 0.0

    def __enter__(self) -> "Meter":
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self.wall_s += time.perf_counter() - self._wall
        cpu_s = time.process_time() - self._cpu
        self.cpu_s += cpu_s
        self.blocks_cpu_s.append(cpu_s)


def stage_figures(*, wall_s: float, cpu_s: float, frames_cpu_s: list[float], peak_mb: float) -> dict[str, float]:
    """Figures of a stage for the manifest; after a resume they cover the frames of the last attempt, whose number stands beside.

    frames_cpu_s : CPU seconds of each frame. Their median is not moved by the first frames, in which kernels may be compiled.
    """
    figures = {"wall_s": wall_s, "cpu_s": cpu_s, "timed_frames": len(frames_cpu_s), "peak_rss_mb": round(peak_mb, 1)}
    if frames_cpu_s:
        figures["median_frame_cpu_s"] = median(frames_cpu_s)
    return {name: round(value, 6) for name, value in figures.items()}
