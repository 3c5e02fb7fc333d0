"""Seconds and megabytes of each stage, as the run wrote them into its manifest."""

from collections.abc import Mapping
from typing import Any

from sboc_e2e.score.figures import absent, exact

STAGES = ("simulate", "onboard", "ground")


def timing(manifest: Mapping[str, Any], n_frames: int, frame_rate_hz: float) -> dict[str, Any]:
    """Wall and CPU seconds per frame, peak memory of each stage, and how much faster than real time the on-board half is."""
    stages = manifest.get("stages", {})
    out: dict[str, Any] = {}
    for stage in STAGES:
        record = stages.get(stage, {})
        for key, name in (("wall_s", f"{stage}_s_per_frame"), ("cpu_s", f"{stage}_cpu_s_per_frame")):
            value = record.get(key)
            out[name] = absent("stage was not timed") if value is None else exact(value / max(n_frames, 1), n_frames)
        peak = record.get("peak_rss_mb")
        out[f"{stage}_peak_rss_mb"] = absent("stage was not measured") if peak is None else exact(peak, 1)
    cpu = out["onboard_cpu_s_per_frame"]["value"]
    slow = "on-board stage was not timed"
    out["realtime_factor_onboard"] = exact(1.0 / (cpu * frame_rate_hz), n_frames) if cpu else absent(slow)
    return out
