"""How much work a frame may take: the nominal work of its size, and a limit of twice that, shared out by kind.

The passes over every pixel take the same work whatever is in the frame. What grows with the frame's content has a limit of its
own for each kind, so that no kind can starve another, and their sum and the passes are twice the nominal work exactly. Beyond a
limit the least valuable is left: entries of the star list by brightness, each part of the field in turn; candidates and trails by
significance, each octave of length in turn, so that long trails never make room for many short ones; regions by their priority.
"""

from typing import Final

from sboc_e2e.icd.work import Work, WorkMeter

REGULAR_PER_PX: Final = 10
"""Operations of the passes that touch every pixel (docs/flight.md counts them stage by stage; vector lanes count as one)."""

NOMINAL_PER_PX: Final = 30  # docs/flight.md shows what it is made of
NOMINAL_FIXED: Final = 32_000_000
"""Nominal work: a full field of stars, 3,600 above 5 sigma per megapixel, and a score of trails however small the frame is."""

LIMITS: Final[dict[Work, tuple[int, int]]] = {
    Work.STARS: (13_000_000, 19),
    Work.HALOS: (2_000_000, 2),
    Work.CANDIDATES: (13_000_000, 17),
    Work.POINTS: (4_000_000, 2),
    Work.TRAILS: (12_000_000, 8),
    Work.REGIONS: (20_000_000, 2),
}
"""Most operations of each kind: a part for any frame, and one for each pixel."""


def nominal(n_pixels: int) -> int:
    """Operations of a nominal frame of `n_pixels` pixels."""
    return NOMINAL_FIXED + NOMINAL_PER_PX * n_pixels


def meter(n_pixels: int) -> WorkMeter:
    """The meter of one frame: limits for its size, and the work of its regular passes."""
    limits = {kind: fixed + each * n_pixels for kind, (fixed, each) in LIMITS.items()}
    return WorkMeter(limits=limits, regular=REGULAR_PER_PX * n_pixels)
