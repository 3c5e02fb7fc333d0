"""On-board tracks over several frames, compared with objects: completeness by S/N and number of frames, and false tracks."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.score.figures import Figure, absent, exact, half_point, proportion, rate
from sboc_e2e.score.matching import MeasuredStreak, TruthStreak, match_all

FRAME_CLASSES: Final = ((2, 2), (3, 3), (4, 7), (8, 10**6))
"""Classes of the number of frames that show an object."""

LEAST_TOTAL_SNR: Final = 8.0
"""Completeness counts objects with at least this total S/N."""


def tracking(truth: Sequence[TruthStreak], frames: Sequence[DownlinkFrame], seen: set[int], n_frames: int) -> dict[str, Any]:
    """Figures of the on-board tracks that came down.

    seen : truth indices that ground measured, frame by frame or as members of tracks. A track belongs to an object if at least
    half of its members match that object's streaks; else it is false. An object counts as found if it has a track or was measured
    in two frames. Its S/N per frame is the root mean square over the frames that show it, its total S/N the root of the sum of
    squares.
    """
    members = [(g.track, f.header.frame, g.detection) for f in frames for g in f.rois if g.track >= 0]
    ends = [np.array([[d.row0, d.col0], [d.row1, d.col1]]) for _, _, d in members]
    matched = match_all(
        [
            MeasuredStreak(index=k, frame=frame, ends=ends[k], middle=ends[k].mean(axis=0))
            for k, (_, frame, _) in enumerate(members)
        ],
        list(truth),
    )
    objects: dict[int, list[int]] = defaultdict(list)
    for k, (number, _, _) in enumerate(members):
        objects[number].append(truth[matched[k]].object_id if k in matched else -1)
    owner = {}
    for number, of in objects.items():
        best, count = max(Counter(of).items(), key=lambda item: (item[1], -item[0]))
        owner[number] = best if best >= 0 and 2 * count >= len(of) else -1
    false = sum(o < 0 for o in owner.values())
    snr_of: dict[int, list[float]] = defaultdict(list)
    measured: Counter[int] = Counter()
    for streak in truth:
        if np.isfinite(streak.snr):
            snr_of[streak.object_id].append(streak.snr)
            measured[streak.object_id] += streak.index in seen
    several = {o: np.array(values) for o, values in snr_of.items() if len(values) >= 2}
    tracked = {o for o in owner.values() if o >= 0}
    found = tracked | {o for o in several if measured[o] >= 2}
    total = {o: float(np.sqrt((values**2).sum())) for o, values in several.items()}
    bright = [o for o in several if total[o] >= LEAST_TOTAL_SNR]
    return {
        "n_tracks": exact(len(owner), len(owner)),
        "false_per_frame": rate(false, n_frames, n_frames),
        "objects": proportion(sum(o in found for o in bright), len(bright), "no object of total S/N 8 in two or more frames"),
        "objects_tracked": proportion(
            sum(o in tracked for o in bright), len(bright), "no object of total S/N 8 in two or more frames"
        ),
        "snr50_total": _half([total[o] for o in several], [o in found for o in several]),
        "snr50_per_frame": {
            _label(low, high): _half(
                [float(np.sqrt((v**2).mean())) for v in several.values() if low <= len(v) <= high],
                [o in found for o, v in several.items() if low <= len(v) <= high],
            )
            for low, high in FRAME_CLASSES
        },
    }


def _label(low: int, high: int) -> str:
    return f"n = {low}" if low == high else f"n = {low}-{high}" if high < 10**6 else f"n >= {low}"


def _half(snr: Sequence[float], found: Sequence[bool]) -> Figure:
    return half_point(snr, found) if snr else absent("no object in so many frames")
