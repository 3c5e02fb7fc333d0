"""Stars under regions of interest, from earlier frames in which no trail lay over them.

A star under a trail cannot be measured in the frame of the trail, and most are too faint for ground's catalogue. The star
lists of the last frames are kept with the transforms of (row, col) into the newest one; a star that at least two of them
hold, away from their own trails, is sent with its mean place and flux. A mover is never at the same place of the sky twice.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image import registration
from onboard.image.nearest import inside
from sboc_e2e.icd.flags import StarFlag, StreakFlag
from sboc_e2e.icd.signals import FIXED_POINT, Detection, RoiGroup, StarList

Array = NDArray[np.float64]

FRAMES_KEPT = 5
"""More frames give a better mean; each costs 30 bytes of memory per star."""

FEWEST_FRAMES = 2
"""Least number of lists with a star. Particles, noise and pieces of trails are in one list only."""

REACH_PX = 64.0
"""Shift of the pointing from frame to frame that is searched."""

LEAST_SNR = 5.0  # the default threshold of `matched`, for extractors with a lower one
SAME_STAR_PX = 1.0
"""Entries of different frames closer than this are one star: four sigma of a centroid at S/N 5 and a PSF of 1 px."""

SPOILT_SIGMAS = 6.0
"""Least distance of a star from a trail, in PSF sigmas. The fit of a nearer star contains light of the trail."""

MARGIN_SIGMAS = 3.0
"""Stars up to this distance outside a strip still shine into it."""

SHORT_PX = 6.0  # as short a trail may be listed as a star. Chosen, not measured
MOVER_PX = 3.0
"""An entry within this distance of a detection that is a point or shorter than `SHORT_PX` may be the detected object itself."""

NOT_KEPT = int(StarFlag.SATURATED | StarFlag.EDGE | StarFlag.TRAILED | StarFlag.COSMIC_LIKE)


@dataclass(frozen=True, kw_only=True, eq=False)
class EarlierStars:
    """Usable stars of an earlier frame, and the transform (2, 3) of their (row, col) into the newest frame."""

    stars: StarList
    transform: Array


def usable_stars(stars: StarList, detections: Sequence[Detection], psf_sigma_px: float) -> StarList:
    """Stars that a later frame may rely on: well measured, and not under one of the frame's own trails."""
    good = ((stars.flags & NOT_KEPT) == 0) & (stars.snr >= LEAST_SNR) & (stars.flux_e > 0.0)
    for detection in detections:
        reach = SPOILT_SIGMAS * psf_sigma_px + abs(detection.sagitta_px)
        near = inside(stars.row, stars.col, (detection.row0, detection.col0, detection.row1, detection.col1), reach)
        good[near] &= distance_px(detection, stars.row[near], stars.col[near]) > reach
    return part_of(stars, np.flatnonzero(good))


def brought_forward(earlier: tuple[EarlierStars, ...], now: StarList) -> tuple[EarlierStars, ...]:
    """The memory in coordinates of the present frame, newest last; empty when its stars are not found again."""
    if not earlier:
        return ()
    clean = part_of(now, np.flatnonzero((now.flags & NOT_KEPT) == 0))
    step = registration.register(earlier[-1].stars, clean, reach_px=REACH_PX)
    if step is None:
        return ()
    return tuple(replace(one, transform=_chained(step, one.transform)) for one in earlier)


def with_frame(earlier: tuple[EarlierStars, ...], stars: StarList) -> tuple[EarlierStars, ...]:
    """The memory after a frame whose usable stars are given."""
    identity = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return (*earlier, EarlierStars(stars=stars, transform=identity))[-FRAMES_KEPT:]


def remembered_stars(
    earlier: tuple[EarlierStars, ...], groups: Sequence[RoiGroup], *, psf_sigma_px: float, most: int
) -> StarList:
    """Stars of the memory under the strips of some ROI groups, at most `most` of them, by falling flux, flagged REMEMBERED.

    Place and flux are means over the frames that hold the star; the S/N is that of the mean.
    """
    columns: list[Array] = []
    for number, one in enumerate(earlier):
        place = registration.apply(one.transform, np.column_stack((one.stars.row, one.stars.col)))
        near = np.flatnonzero(_under_rois(place, groups, MARGIN_SIGMAS * psf_sigma_px))
        entries = part_of(one.stars, near)
        values = (entries.flux_e, entries.snr, entries.flags, np.full(len(near), number))
        columns.append(np.column_stack((place[near], *(np.asarray(v, dtype=np.float64) for v in values))))
    stars = _means(np.concatenate(columns)) if columns else np.zeros((0, 5))
    for group in groups:
        detection = group.detection
        if detection.flags & StreakFlag.POINT_LIKE or detection.length_px < SHORT_PX:
            stars = stars[distance_px(detection, stars[:, 0], stars[:, 1]) > MOVER_PX]
    stars = stars[np.argsort(-stars[:, 2], kind="stable")[:most]]
    return StarList(
        row=stars[:, 0],
        col=stars[:, 1],
        flux_e=stars[:, 2].astype(np.float32),
        snr=stars[:, 3].astype(np.float32),
        flags=stars[:, 4].astype(np.uint8) | np.uint8(StarFlag.REMEMBERED),
    )


def part_of(stars: StarList, index: NDArray[np.intp]) -> StarList:
    """Some entries of a star list."""
    return StarList(
        row=stars.row[index], col=stars.col[index], flux_e=stars.flux_e[index], snr=stars.snr[index], flags=stars.flags[index]
    )


def distance_px(detection: Detection, row: Array, col: Array) -> Array:
    """Distance of points (n,) from the chord of a detection."""
    drow, dcol = detection.row1 - detection.row0, detection.col1 - detection.col0
    square = max(drow**2 + dcol**2, 1e-12)
    share = np.clip(((row - detection.row0) * drow + (col - detection.col0) * dcol) / square, 0.0, 1.0)
    return np.asarray(np.hypot(row - detection.row0 - share * drow, col - detection.col0 - share * dcol))


def _chained(second: Array, first: Array) -> Array:
    """The transform (2, 3) that does `first`, then `second`."""
    return np.column_stack((second[:, :2] @ first[:, :2], second[:, :2] @ first[:, 2] + second[:, 2]))


def _under_rois(place: Array, groups: Sequence[RoiGroup], margin_px: float) -> NDArray[np.bool_]:
    """Which points (n, 2) lie in a strip of the groups, or within the margin of one."""
    inside = np.zeros(len(place), dtype=bool)
    for group in groups:
        for s in group.strips:
            _mark_near(place, s.axis, s.major0, s.minor0_fp, s.slope_fp, s.values_adu.shape, margin_px, inside)
    return inside


@njit(cache=True)
def _mark_near(
    place: Array,
    axis: int,
    major0: int,
    minor0_fp: int,
    slope_fp: int,
    shape: tuple[int, int],
    margin_px: float,
    inside: NDArray[np.bool_],
) -> None:
    """Set True for the points (n, 2) within the margin of a strip."""
    n, width = shape
    margin_across = margin_px * math.hypot(1.0, slope_fp / FIXED_POINT)
    for k in range(place.shape[0]):
        line = place[k, axis] - major0
        if -0.5 - margin_px < line < n - 0.5 + margin_px:
            across = place[k, 1 - axis] - math.floor((minor0_fp + np.rint(line) * slope_fp) / FIXED_POINT)
            inside[k] |= -0.5 - margin_across < across < width - 0.5 + margin_across


def _means(entries: Array) -> Array:
    """Means (m, 5) row, col, flux, S/N, flags of entries (n, 6) with the frame's number last, of stars in enough frames."""
    stars = []
    free = np.ones(len(entries), dtype=bool)
    # The newest entries come first, because their places went through the fewest transforms.
    for k in range(len(entries) - 1, -1, -1):
        if not free[k]:
            continue
        distance = np.hypot(entries[:, 0] - entries[k, 0], entries[:, 1] - entries[k, 1])
        same = np.flatnonzero(free & (distance < SAME_STAR_PX))
        free[same] = False
        if len(same) < FEWEST_FRAMES or len(set(entries[same, 5].tolist())) < FEWEST_FRAMES:
            continue
        mean = entries[same, :3].mean(axis=0)
        snr = entries[same, 3].mean() * np.sqrt(len(same))
        flags = np.bitwise_or.reduce(entries[same, 4].astype(np.uint8))
        stars.append((*mean, snr, float(flags)))
    return np.array(stars, dtype=np.float64).reshape(-1, 5)
