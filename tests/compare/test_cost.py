"""What a comparison says that a choice costs."""

from sboc_e2e.compare.compare import _median_cpu_ms
from sboc_e2e.compare.pages import HEAD


def test_cost_is_that_of_the_median_frame_of_the_median_run() -> None:
    costs = [{"cpu_s": 3.1, "median_frame_cpu_s": s, "timed_frames": 6} for s in (0.015, 0.5, 0.016)]
    figure = _median_cpu_ms(costs)
    assert (figure["value"], figure["n"]) == (16.0, 18)
    assert "CPU ms per frame, median" in HEAD


def test_runs_whose_frames_were_not_timed_have_no_cost() -> None:
    figure = _median_cpu_ms([{"cpu_s": 3.1}])
    assert figure["value"] is None
    assert figure["reason"]
