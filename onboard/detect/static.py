"""Detections that were at the same place in a recent frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

SAME_PLACE_PX = 1.5
"""For all others, whose ends scatter; more takes slow objects for static ones. Chosen, not measured."""

WELL_PLACED_SNR = 25.0  # sqrt(2) x 0.87 px / 25 = 0.05 px
SAME_PLACE_WELL_PLACED_PX = 0.8
"""For points from this S/N on, whose places err by 0.05 px: an object that moves by a pixel from frame to frame is not static."""


def flag_static(detections: Sequence[Detection], recent: Sequence[Sequence[Detection]]) -> tuple[Detection, ...]:
    """Detections with STATIC set when each end of the segment was seen at the same place in a recent frame.

    Places are compared in pixels. What belongs to a star moves with the pointing between frames, by less than these tolerances.
    """
    earlier = [_ends(d) for frame in recent for d in frame]
    if not earlier or not detections:
        return tuple(detections)
    before = np.array(earlier)
    out = []
    for detection in detections:
        apart = np.abs(before - np.array(_ends(detection))).max(axis=1)
        is_point = detection.row0 == detection.row1 and detection.col0 == detection.col1
        reach = SAME_PLACE_WELL_PLACED_PX if is_point and detection.snr >= WELL_PLACED_SNR else SAME_PLACE_PX
        same = bool((apart < reach).any())
        out.append(replace(detection, flags=detection.flags | StreakFlag.STATIC) if same else detection)
    return tuple(out)


def _ends(detection: Detection) -> tuple[float, float, float, float]:
    """The ends in an order that does not depend on which is called 0."""
    a, b = (detection.row0, detection.col0), (detection.row1, detection.col1)
    return (*min(a, b), *max(a, b))
