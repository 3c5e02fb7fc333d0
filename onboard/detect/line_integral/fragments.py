"""Pieces of one trail -> one detection."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

ACROSS_PX: Final = 3.0
"""Largest distance of a piece from the line of the longer one, plus 1 % of the gap between them."""

GAP_SHARE: Final = 0.25
"""Largest gap as a share of the summed length of the pieces."""


def continuation(main: Detection, piece: Detection) -> tuple[float, float] | None:
    """Positions of the ends of `piece` along `main` (px from end 0) if it lies on the same line near it, else None."""
    length = main.length_px
    if length < 1.0:
        return None
    u_row, u_col = (main.row1 - main.row0) / length, (main.col1 - main.col0) / length
    along, across = [], []
    for row, col in ((piece.row0, piece.col0), (piece.row1, piece.col1)):
        d_row, d_col = row - main.row0, col - main.col0
        along.append(d_row * u_row + d_col * u_col)
        # beside the line, or the parabola of a bent one
        u = along[-1] / length
        across.append(d_row * u_col - d_col * u_row - 4.0 * main.sagitta_px * u * (1.0 - u))
    gap = max(min(along) - length, -max(along), 0.0)
    if max(map(abs, across)) > ACROSS_PX + 0.01 * gap or gap > max(8.0, GAP_SHARE * (length + piece.length_px)):
        return None
    return along[0], along[1]


def _union(main: Detection, piece: Detection, along: tuple[float, float]) -> Detection:
    """One detection from the outermost ends of two pieces; the S/N of disjoint pieces adds in squares."""
    length = main.length_px
    ends = [
        (0.0, main.row0, main.col0, bool(main.flags & StreakFlag.EDGE0)),
        (length, main.row1, main.col1, bool(main.flags & StreakFlag.EDGE1)),
        (along[0], piece.row0, piece.col0, bool(piece.flags & StreakFlag.EDGE0)),
        (along[1], piece.row1, piece.col1, bool(piece.flags & StreakFlag.EDGE1)),
    ]
    first, last = min(ends), max(ends)
    shared = max(0.0, min(length, max(along)) - max(0.0, min(along))) / max(piece.length_px, 1.0)
    flags = main.flags & ~(StreakFlag.EDGE0 | StreakFlag.EDGE1)
    flags |= StreakFlag.EDGE0 if first[3] else StreakFlag(0)
    flags |= StreakFlag.EDGE1 if last[3] else StreakFlag(0)
    snr = math.sqrt(main.snr**2 + max(0.0, 1.0 - shared) * piece.snr**2)
    sagitta = main.sagitta_px * ((last[0] - first[0]) / max(length, 1.0)) ** 2
    return replace(main, row0=first[1], col0=first[2], row1=last[1], col1=last[2], snr=snr, sagitta_px=sagitta, flags=flags)


def join(detections: Sequence[Detection]) -> list[Detection]:
    """Detections with pieces of the same trail joined; the order of the result is by falling S/N."""
    # the longest first: its line is the one that others are compared with, whichever piece is the brightest
    todo = sorted(detections, key=lambda d: (-d.length_px, -d.snr))
    done: list[Detection] = []
    while todo:
        main = todo.pop(0)
        k = 0
        while k < len(todo):
            along = continuation(main, todo[k])
            if along is None:
                k += 1
            else:
                main = _union(main, todo.pop(k), along)
                k = 0
        done.append(main)
    return sorted(done, key=lambda d: -d.snr)
