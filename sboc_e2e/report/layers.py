"""What the frame viewer draws over a frame, and the list of misses and false alarms with their reasons."""

import math
from typing import Any, Final

import numpy as np

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FLAG_TEXT, FrameFlag, StreakFlag
from sboc_e2e.icd.signals import Strip
from sboc_e2e.report.reasons import Reasons, shed_words
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.matching import TruthStreak

USUAL: Final = FrameFlag.GAIN_ASSUMED | FrameFlag.READ_NOISE_ASSUMED
"""Flags of every frame of a source, which say nothing of one."""

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
                "state": _state(record),
                "sky": _sky(e, number),
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


def _state(record: DownlinkFrame | None) -> str:
    """What was unusual about a frame, in words: storms, shed work, what is missing."""
    if record is None:
        return "no packet of it arrived"
    words = [FLAG_TEXT["FrameFlag"][flag.name or ""] for flag in FrameFlag if flag in record.flags and flag not in USUAL]
    if record.housekeeping is not None and record.housekeeping.n_rois_dropped:
        words.append(f"{record.housekeeping.n_rois_dropped} detections held back")
    if record.housekeeping is not None and record.housekeeping.shed:
        words.append(f"left undone: {shed_words(record.housekeeping)}")
    return "; ".join(words)


def _sky(e: Evaluation, number: int) -> list[list[float]] | None:
    """Right ascension and declination (deg) on the solution's grid over the frame, rows first; None without a solution."""
    if "grid_ra_app_deg" not in e.frames.colnames:
        return None
    row = next((i for i, frame in enumerate(e.frames["frame"]) if int(frame) == number), None)
    if row is None:
        return None
    ra, dec = (np.asarray(e.frames[name][row], float).ravel() for name in ("grid_ra_app_deg", "grid_dec_app_deg"))
    side = math.isqrt(ra.size)
    if side < 2 or side * side != ra.size or not np.isfinite([ra, dec]).all():
        return None
    return [[round(float(v), 5) for v in values] for values in (ra, dec)]


def cases(e: Evaluation, reasons: Reasons) -> dict[str, list[dict[str, Any]]]:
    """Misses (brightest first) and false alarms (most significant first), each with place, S/N and reason."""
    found = e.detected_ground
    missed = [t for t in e.truth if t.index not in found and t.counted]
    missed.sort(key=lambda t: -t.snr if math.isfinite(t.snr) else 0.0)
    misses = [
        {
            "frame": t.frame,
            "row": float(t.ends[:, 0].mean()), "col": float(t.ends[:, 1].mean()), "snr": _snr(t.snr),
            "length": round(t.length_px, 1), "what": f"object {t.object_id}", "reason": reasons.why_missed(t),
            "line": _true_line(t),
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
