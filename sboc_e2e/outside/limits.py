"""Limits of frames from outside: a computer on a desk has no orbit's clock, and dust or cosmic rays must not leave trails out."""

from dataclasses import replace
from typing import Final

from onboard.work import meter
from sboc_e2e.icd.work import WorkMeter

WORK: Final = 4
"""Times the work that a frame of its size may take on board."""

MOST_DETECTIONS: Final = 1_000
"""Detections of a frame, all of which are measured."""


def work_meter(n_pixels: int) -> WorkMeter:
    """The meter of a frame of `n_pixels` pixels."""
    on_board = meter(n_pixels)
    return replace(on_board, limits={kind: WORK * most for kind, most in on_board.limits.items()})
