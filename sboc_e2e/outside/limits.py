"""Limits of frames from outside: a computer on a desk has no orbit's clock, and dust or cosmic rays must not leave trails out."""

from dataclasses import replace
from typing import Final

from onboard.work import meter
from sboc_e2e.icd.work import Work, WorkMeter

WORK: Final = 4
"""Times the work that a frame of its size may take on board."""

LEAST_PX: Final = 2048**2
"""Candidates and trails of a smaller frame may take as much work as those of one of this size: pictures are small, and hold
trees, clouds and whole constellations. Of 224 real frames 190 have more candidates than their size allows. In ten whose trails
were missed this shows four of 18 more, for 0.6 s a frame."""

MOST_DETECTIONS: Final = 1_000
"""Detections of a frame, all of which are measured but for particle hits."""

MOST_HITS: Final = 100
"""Of lines sharper than the stars, as particles are, the brightest are measured: the vetter tells trails among them by their
length. Full, stretched and crowded stars are wider than the optics, and ten of ten satellites of a train were sharper. In orbit
one is sent. A budget of time."""


def work_meter(n_pixels: int) -> WorkMeter:
    """The meter of a frame of `n_pixels` pixels."""
    on_board = meter(n_pixels)
    least = meter(max(n_pixels, LEAST_PX)).limits
    limits = on_board.limits | {kind: least[kind] for kind in (Work.CANDIDATES, Work.TRAILS)}
    return replace(on_board, limits={kind: WORK * most for kind, most in limits.items()})
