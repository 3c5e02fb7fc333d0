"""Seconds and megabytes of each stage, as the run wrote them into its manifest."""

from collections.abc import Mapping
from typing import Any

from sboc_e2e.score.figures import absent, exact

STAGES = ("simulate", "onboard", "ground")


def timing(manifest: Mapping[str, Any], n_frames: int, frame_rate_hz: float) -> dict[str, Any]:
    """Wall and CPU seconds per frame, peak memory of each stage, and the real-time factor of the on-board half.

    A resumed stage timed only the frames of its last attempt: seconds are divided by those (`timed_frames`).
    """
    stages = manifest.get("stages", {})
    out: dict[str, Any] = {}
    for stage in STAGES:
        record = stages.get(stage, {})
        timed = int(record.get("timed_frames", n_frames))
        for key, name in (("wall_s", f"{stage}_s_per_frame"), ("cpu_s", f"{stage}_cpu_s_per_frame")):
            value = record.get(key)
            out[name] = absent("stage was not timed") if value is None or timed == 0 else exact(value / timed, timed)
        peak = record.get("peak_rss_mb")
        out[f"{stage}_peak_rss_mb"] = absent("stage was not measured") if peak is None else exact(peak, 1)
    onboard = out["onboard_cpu_s_per_frame"]
    cpu = onboard["value"]
    slow = "on-board stage was not timed"
    out["realtime_factor_onboard"] = exact(1.0 / (cpu * frame_rate_hz), onboard["n"]) if cpu else absent(slow)
    return out
