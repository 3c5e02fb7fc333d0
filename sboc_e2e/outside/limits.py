"""Limits of frames from outside: a computer on a desk has no orbit's clock, and dust or cosmic rays must not leave trails out."""

from dataclasses import replace
from typing import Final

from onboard.work import meter
from sboc_e2e.icd.work import WorkMeter

WORK: Final = 4
"""Times the work that a frame of its size may take on board."""

LEAST_PX: Final = 2048 * 2048
"""Smaller frames may take as much as one of this size: pictures of a tenth of it have as many candidates. In 65 of 78 pictures of
0.1 to 20 megapixels some were left out, and trails of 11 to 15 sigma a pixel among them."""

MOST_DETECTIONS: Final = 1_000
"""Detections of a frame, all of which are measured but for particle hits."""

MOST_HITS: Final = 100
"""Of lines sharper than the stars, as particles are, the brightest are measured: the vetter tells trails among them by their
length. Full, stretched and crowded stars are wider than the optics, and ten of ten satellites of a train were sharper. In orbit
one is sent. A budget of time."""


def work_meter(n_pixels: int) -> WorkMeter:
    """The meter of a frame of `n_pixels` pixels."""
    limits = meter(max(n_pixels, LEAST_PX)).limits
    return replace(meter(n_pixels), limits={kind: WORK * most for kind, most in limits.items()})
