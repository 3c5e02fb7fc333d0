"""Pieces of one trail -> one detection."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

ACROSS_PX: Final = 3.0
"""Largest distance of a piece from the line of the longer one, plus 1 % of the gap between them."""

GAP_SHARE: Final = 0.25
"""Largest gap as a share of the summed length of the pieces."""

BRIGHTER: Final = 4.0
"""S/N of a piece over that of a longer line it lies on, from which on both are two, if `brighter_apart`. Flashes of tumblers are
brighter than the rest of their trail: of 81 trails 79 come out as one without this, 77 with 4, 73 with 2."""


def _ends(detections: Sequence[Detection]) -> NDArray[np.float64]:
    """Ends and length (n, 5) of detections: row0, col0, row1, col1, px."""
    return np.array([(d.row0, d.col0, d.row1, d.col1, d.length_px) for d in detections]).reshape(-1, 5)


def _first_continuation(
    main: Detection, pieces: Sequence[Detection], ends: NDArray[np.float64], brighter_apart: bool
) -> tuple[int, tuple[float, float]] | None:
    """The first of some pieces on the same line as `main` and near it; and where its ends lie along that.

    ends (n, 5) : `_ends` of the pieces. Positions are px from end 0. brighter_apart : see `join`.
    """
    length = main.length_px
    if length < 1.0 or not len(ends):
        return None
    u_row, u_col = (main.row1 - main.row0) / length, (main.col1 - main.col0) / length
    d_row, d_col = ends[:, [0, 2]] - main.row0, ends[:, [1, 3]] - main.col0
    along = d_row * u_row + d_col * u_col
    # beside the line, or the parabola of a bent one
    u = along / length
    across = d_row * u_col - d_col * u_row - 4.0 * main.sagitta_px * u * (1.0 - u)
    gap = np.maximum(np.maximum(along.min(axis=1) - length, -along.max(axis=1)), 0.0)
    near = gap <= np.maximum(8.0, GAP_SHARE * (length + ends[:, 4]))
    belongs = near & (np.abs(across).max(axis=1) <= ACROSS_PX + 0.01 * gap)
    if brighter_apart:
        shared = np.minimum(along.max(axis=1), length) - np.maximum(along.min(axis=1), 0.0)
        brighter = np.array([piece.snr > BRIGHTER * main.snr for piece in pieces])
        belongs &= ~(brighter & (shared > 0.5 * ends[:, 4]))
    on_line = np.flatnonzero(belongs)
    if not len(on_line):
        return None
    first = int(on_line[0])
    return first, (float(along[first, 0]), float(along[first, 1]))


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


def join(detections: Sequence[Detection], *, brighter_apart: bool = False) -> list[Detection]:
    """Detections with pieces of the same trail joined; the order of the result is by falling S/N.

    brighter_apart : a piece much brighter than a longer line it lies on stays by itself. Where the sky is not even, what is
    left of it beside a bright trail makes such lines.
    """
    # the longest first: its line is the one that others are compared with, whichever piece is the brightest
    todo = sorted(detections, key=lambda d: (-d.length_px, -d.snr))
    ends, done = _ends(todo), []
    while todo:
        main, ends = todo.pop(0), ends[1:]
        while (piece := _first_continuation(main, todo, ends, brighter_apart)) is not None:
            k, along = piece
            main, ends = _union(main, todo.pop(k), along), np.delete(ends, k, axis=0)
        done.append(main)
    return sorted(done, key=lambda d: -d.snr)
