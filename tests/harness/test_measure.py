"""What a stage costs, with and without what its first frames have to do once."""

import time

import numba
import numpy as np
import pytest

from sboc_e2e.run.measure import Meter, stage_figures


def test_the_median_frame_is_not_moved_by_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel is compiled for 3 s in the first of six frames, which take 15 ms each."""
    clock = iter([0.0, 3.015, *(t for k in range(5) for t in (10.0 + k, 10.015 + k))])
    monkeypatch.setattr(time, "process_time", lambda: next(clock))
    meter = Meter()
    for _ in range(6):
        with meter:
            pass
    figures = stage_figures(
        wall_s=4.0, cpu_s=meter.cpu_s, frames_cpu_s=meter.blocks_cpu_s, peak_mb=300.0, compile_cpu_s=meter.compile_cpu_s
    )
    assert figures["cpu_s"] == pytest.approx(3.09)
    assert figures["median_frame_cpu_s"] == pytest.approx(0.015)
    assert figures["timed_frames"] == 6


def test_a_stage_that_timed_no_frame_has_no_median() -> None:
    assert "median_frame_cpu_s" not in stage_figures(wall_s=0.0, cpu_s=0.0, frames_cpu_s=[], peak_mb=0.0, compile_cpu_s=0.0)


def test_compilation_is_no_cost_of_the_chain() -> None:
    """A kernel that no cache holds is compiled inside the block; the first run showed that as the chain's CPU time."""

    @numba.njit
    def kernel(x: float) -> float:
        total = 0.0
        for k in range(10):
            total += np.sqrt(x + k)
        return total

    meter = Meter()
    with meter:
        kernel(1.0)
    with meter:
        kernel(2.0)
    assert meter.compile_cpu_s > 0.02
    assert meter.cpu_s < 0.5 * meter.compile_cpu_s
