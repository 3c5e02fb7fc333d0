"""Segments of the search as detections: work that is left for them, ends, flags, S/N in the unclipped image."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import whiten
from onboard.detect.line_integral import dyadic, point_movers, static_sky
from onboard.detect.line_integral.star_removal import TILE_PX, WorkingImages
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.results import LARGEST_SNR
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.icd.work import Work, WorkMeter

MAX_TRAILS: Final = 2_000
"""Room for trails before particle tracks are told apart: those of a storm come first, being brighter."""

POINT_LIKE_PX: Final = 4.0
"""Trails shorter than about two PSF widths are called point-like."""

TRAIL_WORK: Final = 200_000.0  # operations of a trail, whatever its length ...
TRAIL_WORK_PER_PX: Final = 1_400.0
"""Operations of a trail that is looked at: 45 lines beside it of some 14 px across, its place in the frame before, its light
along it, its surroundings in the star list."""

CLIPPED_SNR: Final = 30.0
"""No pixel of a fainter trail is clipped."""

EDGE_PX: Final = 3.0
"""An end closer than this to the frame's edge may continue beyond it."""


def within_work(table: NDArray[np.float64], work: WorkMeter) -> NDArray[np.float64]:
    """The rows of `resolve.resolve` that are looked at further, in their order, as far as work allows; the others are counted.

    Trails of each octave of length take turns, the most significant of each first.
    """
    length = np.hypot(table[:, 3] - table[:, 1], table[:, 4] - table[:, 2])
    best_first = np.argsort(-table[:, 6], kind="stable")
    turn = dyadic.turns(np.log2(np.maximum(length[best_first], 1.0)).astype(np.int64))
    in_turn = best_first[np.argsort(turn, kind="stable")]
    operations = np.cumsum(TRAIL_WORK + TRAIL_WORK_PER_PX * length[in_turn])
    room = int(np.searchsorted(operations, work.left(Work.TRAILS), side="right"))
    work.spend(Work.TRAILS, operations[room - 1] if room else 0)
    work.leave(Work.TRAILS, len(table) - room)
    return np.asarray(table[np.sort(in_turn[:room])])


def edge_flags(ends: tuple[float, float, float, float], shape: tuple[int, int], snr: float) -> StreakFlag:
    """EDGE0 and EDGE1 of a segment (row0, col0, row1, col1): ends whose uncertainty reaches the frame's edge.

    The change-point law of faint ends: rms sqrt(26) L / S^2.
    """
    length = math.hypot(ends[2] - ends[0], ends[3] - ends[1])
    reach = EDGE_PX + min(20.0, math.sqrt(26.0) * length / snr**2)
    u_row, u_col = ((ends[2] - ends[0]) / length, (ends[3] - ends[1]) / length) if length > 0.0 else (0.0, 0.0)
    flags = StreakFlag(0)
    for row, col, sign, flag in ((ends[0], ends[1], -1.0, StreakFlag.EDGE0), (ends[2], ends[3], 1.0, StreakFlag.EDGE1)):
        row, col = row + sign * reach * u_row, col + sign * reach * u_col
        if row < 0.0 or col < 0.0 or row > shape[0] - 1 or col > shape[1] - 1:
            flags |= flag
    return flags


def with_edges(detection: Detection, shape: tuple[int, int]) -> Detection:
    """A detection whose ends were moved, with the flags that they have now in an image (rows, cols): EDGE0, EDGE1, CURVED."""
    ends = detection.row0, detection.col0, detection.row1, detection.col1
    flags = detection.flags & ~(StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.CURVED)
    flags |= edge_flags(ends, shape, detection.snr) | (StreakFlag.CURVED if detection.sagitta_px else StreakFlag(0))
    return replace(detection, flags=flags)


def _inside(ends: NDArray[np.float64], shape: tuple[int, int]) -> tuple[float, float, float, float]:
    """The part inside the frame of a segment (major0, minor0, major1, minor1); along it, so that its direction stays."""
    start = (float(ends[0]), float(ends[1]))
    way = (float(ends[2]) - start[0], float(ends[3]) - start[1])
    low, high = 0.0, 1.0
    for k in range(2):
        if abs(way[k]) > 1e-6:
            cuts = sorted((-start[k] / way[k], (shape[k] - 1.0 - start[k]) / way[k]))
            low, high = max(low, cuts[0]), min(high, cuts[1])
    high = max(low, high)
    (a0, b0), (a1, b1) = (tuple(min(max(start[k] + u * way[k], 0.0), shape[k] - 1.0) for k in range(2)) for u in (low, high))
    return a0, b0, a1, b1


def line_detection(row: NDArray[np.float64], shape: tuple[int, int]) -> Detection:
    """A row of `resolve.resolve` as a contract record, ends inside the frame."""
    axis = int(row[0])
    a0, b0, a1, b1 = _inside(row[1:5], shape if axis == 0 else shape[::-1])
    ends = (a0, b0, a1, b1) if axis == 0 else (b0, a0, b1, a1)
    slope = (row[4] - row[2]) / max(row[3] - row[1], 1e-6)
    sagitta = float(row[5]) / math.sqrt(1.0 + slope * slope)
    flags = edge_flags(ends, shape, float(row[6]))
    if abs(sagitta) < 0.5:
        sagitta = 0.0
    else:
        flags |= StreakFlag.CURVED
    # positive side of the contract: (+drow, -dcol) turned from the chord, i.e. growing row for a chord along growing col
    signed = sagitta if axis == 1 else -sagitta
    return Detection(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=float(row[6]), sagitta_px=signed, flags=flags)


def seed_ends(seeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seeds of `resolve.resolve` (n, 6) as row0, col0, row1, col1, S/N (n, 5), ends by growing major coordinate.

    They are turned where they lie, and a part of `seeds` comes back: memory is dearest here.
    """
    flat = seeds[:, 0] != 0.0
    for first in (1, 3):
        seeds[flat, first], seeds[flat, first + 1] = seeds[flat, first + 1], seeds[flat, first]
    return seeds[:, 1:]


def with_blurred_ends(detection: Detection, images: WorkingImages, psf_sigma_px: float) -> Detection:
    """A short line refitted with the template whose ends are blurred by the PSF: sharp ends cost it a few per cent of S/N."""
    row, col = 0.5 * (detection.row0 + detection.row1), 0.5 * (detection.col0 + detection.col1)
    angle = math.atan2(detection.row1 - detection.row0, detection.col1 - detection.col0)
    rough = (detection.snr, row, col, angle, detection.length_px)
    snr, row, col, angle, length = point_movers.fit_short_trail(
        images.image, images.blocked, whiten.FOUND_BIT, rough, psf_sigma_px
    )
    if snr <= detection.snr:
        return detection
    row0, col0, row1, col1 = ends_of(row, col, angle, length, images.image.shape)
    return replace(detection, row0=row0, col0=col0, row1=row1, col1=col1, snr=float(snr))


def ends_of(
    row: float, col: float, angle_rad: float, length_px: float, shape: tuple[int, ...]
) -> tuple[float, float, float, float]:
    """row0, col0, row1, col1 of a trail about its middle, each moved into the frame; the angle turns from col to row."""
    half_row, half_col = 0.5 * length_px * math.sin(angle_rad), 0.5 * length_px * math.cos(angle_rad)
    row0, row1 = (float(np.clip(row + sign * half_row, 0.0, shape[0] - 1.0)) for sign in (-1.0, 1.0))
    col0, col1 = (float(np.clip(col + sign * half_col, 0.0, shape[1] - 1.0)) for sign in (-1.0, 1.0))
    return row0, col0, row1, col1


def segment_snr(detection: Detection, view: DetectorView, images: WorkingImages, s_px: float) -> float:
    """Matched-filter S/N of a detection's segment in the unclipped image, on its usable pixels; NaN where these are few."""
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    return static_sky.segment_snr(
        view.residual_adu,
        view.mask,
        view.background.sigma_adu,
        view.background.tile_px,
        (images.blocked, whiten.FOUND_BIT),
        (images.level, TILE_PX),
        ends,
        s_px,
    )


def with_unclipped_snr(detection: Detection, view: DetectorView, images: WorkingImages, s_px: float) -> Detection:
    """A bright trail with its S/N in the unclipped image, where that is larger: the working image is clipped."""
    if detection.snr <= CLIPPED_SNR or detection.length_px < POINT_LIKE_PX:
        return detection
    snr = segment_snr(detection, view, images, s_px)
    return replace(detection, snr=min(snr, LARGEST_SNR)) if snr > detection.snr else detection
