"""What the frame viewer draws over a frame, and the list of misses and false alarms with their reasons."""

import math
from typing import Any, Final

import numpy as np

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Strip
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.matching import TruthStreak

MAX_CASES: Final = 40
"""Misses and false alarms shown, worst first; the counts of all stand beside them."""


def _snr(value: float) -> float | None:
    """S/N for a page; None where truth from elsewhere does not give it."""
    return round(float(value), 1) if math.isfinite(value) else None


def _outline(strip: Strip) -> list[list[float]]:
    """Corners of a strip as (col, row)."""
    n, width = strip.values_adu.shape
    corners = []
    for line, side in ((0, 0), (0, width), (n, width), (n, 0)):
        minor = ((strip.minor0_fp + line * strip.slope_fp) / 65536.0) + side - 0.5
        major = strip.major0 + line - 0.5
        corners.append([minor, major] if strip.axis == 0 else [major, minor])
    return [[round(c, 1), round(r, 1)] for c, r in corners]


def _true_line(streak: TruthStreak) -> list[list[float]]:
    keep = slice(None, None, 4)
    return [[round(float(c), 2), round(float(r), 2)] for r, c in zip(streak.path.row[keep], streak.path.col[keep], strict=True)]


def frame_layers(e: Evaluation, frames: list[int]) -> list[dict[str, Any]]:
    """Layers of each frame: truth paths, ROI outlines, stars, measured streaks with their tracklets."""
    downlinked = {f.header.frame: f for f in e.downlink_frames}
    out = []
    for number in frames:
        record = downlinked.get(number)
        found = e.detected_ground
        rows = [i for i, frame in enumerate(e.streaks["frame"]) if int(frame) == number]
        out.append(
            {
                "frame": number,
                "truth": [
                    {"line": _true_line(t), "snr": _snr(t.snr), "object": t.object_id, "found": t.index in found}
                    for t in e.truth
                    if t.frame == number
                ],
                "rois": [[_outline(strip) for strip in group.strips] for group in record.rois] if record else [],
                "stars": (
                    [[round(float(c), 1), round(float(r), 1)] for r, c in zip(record.stars.row, record.stars.col, strict=True)]
                    if record
                    else []
                ),
                "streaks": [
                    {
                        "line": [[round(float(s["col0"]), 2), round(float(s["row0"]), 2)],
                                 [round(float(s["col1"]), 2), round(float(s["row1"]), 2)]],
                        "snr": round(float(s["snr"]), 1),
                        "id": int(s["streak_id"]),
                        "tracklet": int(s["tracklet_id"]),
                        "vetoed": bool(int(s["flags"]) & StreakFlag.VETOED),
                        "true": i in e.pairs,
                    }
                    for i in rows
                    for s in (e.streaks[i],)
                ],
            }
        )  # fmt: skip
    return out


def _why_missed(e: Evaluation, streak: TruthStreak) -> str:
    share = e.footprints.captured.get(streak.index)
    if share is None:
        return "the frame did not arrive"
    matched_rows = [row for row, t in e.pairs.items() if t.index == streak.index]
    if matched_rows:
        return "measured, but rejected by the vetter"
    if share >= 0.9:
        return f"ROI holds {share:.0%} of its light, but no measured streak matches it"
    if share >= 0.1:
        return f"ROI holds only {share:.0%} of its light"
    return "not detected on board"


def cases(e: Evaluation) -> dict[str, list[dict[str, Any]]]:
    """Misses (brightest first) and false alarms (most significant first), each with place, S/N and reason."""
    found = e.detected_ground
    missed = [t for t in e.truth if t.index not in found and t.counted]
    missed.sort(key=lambda t: -t.snr if math.isfinite(t.snr) else 0.0)
    misses = [
        {
            "frame": t.frame,
            "row": float(t.ends[:, 0].mean()), "col": float(t.ends[:, 1].mean()), "snr": _snr(t.snr),
            "length": round(t.length_px, 1), "what": f"object {t.object_id}", "reason": _why_missed(e, t), "line": _true_line(t),
        }
        for t in missed[:MAX_CASES]
    ]  # fmt: skip
    order = sorted(e.false_rows, key=lambda i: -float(e.streaks["snr"][i]))
    false = []
    for i in order[:MAX_CASES]:
        s = e.streaks[i]
        flags = StreakFlag(int(s["flags"]))
        names = ", ".join(flag.name or "" for flag in flags) or "no flag"
        false.append(
            {
                "frame": int(s["frame"]), "row": float(s["row_mid"]), "col": float(s["col_mid"]),
                "snr": round(float(s["snr"]), 1),
                "length": round(float(s["length_px"]), 1), "what": f"streak {int(s['streak_id'])}",
                "reason": f"no truth streak matches; flags: {names.lower()}",
                "line": [[float(s["col0"]), float(s["row0"])], [float(s["col1"]), float(s["row1"])]],
            }
        )  # fmt: skip
    return {"misses": misses, "false_alarms": false}


def completeness_series(e: Evaluation) -> dict[str, tuple[Any, Any]]:
    """S/N and detected of the counted truth, for both halves of the chain."""
    counted = [t for t in e.truth if t.counted]
    snr = np.array([t.snr for t in counted])
    return {
        "ROIs on board": (snr, np.array([t.index in e.detected_onboard for t in counted], bool)),
        "measured on ground": (snr, np.array([t.index in e.detected_ground for t in counted], bool)),
    }
