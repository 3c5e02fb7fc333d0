"""Detections that were at the same place in a recent frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

SAME_PLACE_PX = 1.5


def flag_static(detections: Sequence[Detection], recent: Sequence[Sequence[Detection]]) -> tuple[Detection, ...]:
    """Detections with STATIC set when each end of the segment was seen at the same place in a recent frame."""
    earlier = [_ends(d) for frame in recent for d in frame]
    if not earlier or not detections:
        return tuple(detections)
    before = np.array(earlier)
    out = []
    for detection in detections:
        apart = np.abs(before - np.array(_ends(detection))).max(axis=1)
        same = bool((apart < SAME_PLACE_PX).any())
        out.append(replace(detection, flags=detection.flags | StreakFlag.STATIC) if same else detection)
    return tuple(out)


def _ends(detection: Detection) -> tuple[float, float, float, float]:
    """The ends in an order that does not depend on which is called 0."""
    a, b = (detection.row0, detection.col0), (detection.row1, detection.col1)
    return (*min(a, b), *max(a, b))
