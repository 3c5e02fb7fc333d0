"""From rows of the joint filter to the contract's tracks: which of them pass, and where their members lie in each frame."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.image import registration
from onboard.track.foreign_light import LitMember, own_light
from onboard.track.joint_filter import more_asked
from onboard.track.kept_search import KeptSearch
from onboard.track.removed_stars import left_in
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, Track, TrackMember

LEAST_REST: Final = 3.3
"""What is left of a track without any one of its frames must reach this S/N: particles light up one frame."""

UNEVEN: Final = 6.0  # noise alone exceeds it in one of 120 tracks of two frames, one of 19 of six. Chosen, not measured
UNEVEN_SHARE: Final = 0.2
"""Chi-square of a track's frames against even brightness may exceed its degrees of freedom by this, and by this share of the
joint S/N squared: objects tumble."""

EDGE_PX: Final = 3.0  # such a trail may continue beyond the frame, as `segments.EDGE_PX` has it


def plausible(row: NDArray[np.float64]) -> bool:
    """Whether a row of `joint_filter.follow` is lit in all its frames, about evenly."""
    snr, least, chi2, free = row[7:11]
    return bool(least > LEAST_REST and chi2 < free + UNEVEN + (UNEVEN_SHARE * snr) ** 2)


def stands(
    track: Track,
    row: NDArray[np.float64],
    window: tuple[KeptSearch, ...],
    transforms: NDArray[np.float64],
    n_old: int,
    asked: NDArray[np.float64],
    psf_sigma_px: float,
) -> bool:
    """Whether a track reaches what is asked of it in light that no frame's own trails and no stars explain. See `track_of`."""
    first, last = int(row[5]), int(row[6])
    of = {member.frame: member.detection for member in track.members}
    removed = [frame.removed for frame in window]
    members = []
    for k, frame in enumerate(window):
        if k >= n_old and frame.header.frame in of:
            d = of[frame.header.frame]
            stars = left_in(np.array([[d.row0, d.col0], [d.row1, d.col1]]), k, removed, transforms, psf_sigma_px)
            members.append(LitMember(d, float(row[11 + k]), frame.image, frame.trails, stars))
    own = own_light(members, row[11 + first : 11 + max(first, n_old)], psf_sigma_px)
    return own is None or (own.snr >= asked[last - first + 1] + more_asked(row[2]) and own.least > LEAST_REST)


def track_of(
    row: NDArray[np.float64],
    line: NDArray[np.float64],
    window: tuple[KeptSearch, ...],
    transforms: NDArray[np.float64],
    taus: NDArray[np.float64],
    n_old: int,
) -> Track | None:
    """A row of `joint_filter.follow` and its line as a contract record without a number; None for fewer than two frames.

    The first n_old frames of the window are those whose pixels are no longer kept: no members lie in them.
    """
    sense, start, length, offset, tilt, first, last, snr = row[:8]
    line_px = math.hypot(line[2] - line[0], line[3] - line[1])
    u = (line[2:4] - line[0:2]) / line_px
    # lanes lie side by side along the minor axis, max(|u|) px across the line for each px of it
    across = np.eye(2)[int(abs(u[0]) >= abs(u[1]))] / np.abs(u).max()
    members = []
    for k in range(max(int(first), n_old), int(last) + 1):
        begin = start + sense * taus[k] * length
        along = np.array([begin, begin + length] if sense > 0.0 else [begin + length, begin])
        away = offset + tilt * (along / line_px - 0.5)
        ends = registration.apply(transforms[k], line[0:2] + along[:, None] * u + away[:, None] * across)
        inside = clipped(ends, window[k].shape)
        if inside is not None:
            (row0, col0, row1, col1), flags = inside
            members.append(
                TrackMember(
                    frame=window[k].header.frame,
                    detection=Detection(
                        row0=row0, col0=col0, row1=row1, col1=col1, snr=max(float(row[11 + k]), 0.0), flags=flags
                    ),
                )
            )
    return Track(number=0, snr=float(snr), members=tuple(members)) if len(members) >= 2 else None


def clipped(ends: NDArray[np.float64], shape: tuple[int, ...]) -> tuple[tuple[float, float, float, float], StreakFlag] | None:
    """The part of a segment (2, 2) inside a frame, flagged where the edge cuts it; None when nothing is."""
    (row0, col0), (row1, col1) = ends.tolist()
    last_row, last_col = (n - 1.0 - EDGE_PX for n in shape)
    if min(row0, row1, col0, col1) >= EDGE_PX and max(row0, row1) <= last_row and max(col0, col1) <= last_col:
        return (row0, col0, row1, col1), StreakFlag(0)  # nearly all of them
    way, limits = ends[1] - ends[0], np.array(shape) - 1.0
    low, high = 0.0, 1.0
    for k in range(2):
        if abs(way[k]) < 1e-9:
            if not 0.0 <= ends[0, k] <= limits[k]:
                return None
            continue
        cuts = sorted((-ends[0, k] / way[k], (limits[k] - ends[0, k]) / way[k]))
        low, high = max(low, cuts[0]), min(high, cuts[1])
    if high - low < 0.1:
        return None
    points = ends[0] + np.array([[low], [high]]) * way
    flags = StreakFlag(0)
    for flag, cut, point in ((StreakFlag.EDGE0, low > 0.0, points[0]), (StreakFlag.EDGE1, high < 1.0, points[1])):
        if cut or (point < EDGE_PX).any() or (point > limits - EDGE_PX).any():
            flags |= flag
    points = np.clip(points, 0.0, limits)
    return (float(points[0, 0]), float(points[0, 1]), float(points[1, 0]), float(points[1, 1])), flags
