"""Stars that slow movers hide, taken from the regions of earlier frames.

The on-board memory sends the stars under a region, but none within 3 px of a point-like detection, which may be the object
itself. An object that moves by 2 px from frame to frame has hidden nothing a few frames earlier, when the star still lay
beside it in its region. Places are kept as directions, so that any motion of the camera is allowed for.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy  # scipy.spatial is loaded where it is used: frames without a solution need none
from numpy.typing import NDArray

from ground.sky.pixel_sky import mid_frame_directions, mid_frame_pixels
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StarFlag, StreakFlag
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.signals import StarList

FRAMES_KEPT: Final = 12
"""Three seconds at 4 frames/s: a limit of memory. Chosen, not measured."""
FEWEST_FRAMES: Final = 2
"""Least number of frames that sent a star. A moving object is never at the same place of the sky twice."""

SAME_STAR_PX: Final = 1.0
"""Entries closer than this are one star, as on board: four sigma of a centroid at S/N 5 and a PSF of 1 px."""
SHORT_PX: Final = 6.0
"""As on board, whose star list leaves these places out."""
HIDDEN_PX: Final = 3.0
"""Around point-like detections and those shorter than `SHORT_PX` nothing within this distance is sent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EarlierStars:
    """Stars under the regions of one frame: directions (n, 3) in the axes of the sky, flux (e-), S/N; (n,) each."""

    direction: NDArray[np.float64]
    flux_e: NDArray[np.float64]
    snr: NDArray[np.float64]


def with_hidden_stars(
    memory: tuple[EarlierStars, ...], frame: DownlinkFrame, solution: FrameSolution
) -> tuple[tuple[EarlierStars, ...], DownlinkFrame]:
    """The memory after a frame, and the frame with the stars that its slow movers hide among the remembered ones."""
    if solution.flags & FrameFlag.NO_SOLUTION:
        return memory, frame
    sent = frame.remembered
    now = EarlierStars(
        direction=mid_frame_directions(solution, sent.row, sent.col),
        flux_e=sent.flux_e.astype(np.float64),
        snr=sent.snr.astype(np.float64),
    )
    hidden = _hidden(memory, frame, solution)
    if len(hidden):
        frame = replace(frame, remembered=_joined(sent, hidden))
    return (*memory, now)[-FRAMES_KEPT:], frame


def _hidden(memory: tuple[EarlierStars, ...], frame: DownlinkFrame, solution: FrameSolution) -> NDArray[np.float64]:
    """(n, 4) row, col, flux and S/N of the stars near slow movers that enough earlier frames agree on."""
    movers = [
        (0.5 * (d.row0 + d.row1), 0.5 * (d.col0 + d.col1), 0.5 * d.length_px + HIDDEN_PX)
        for d in (group.detection for group in frame.rois)
        if StreakFlag.POINT_LIKE in d.flags or d.length_px < SHORT_PX
    ]
    if not movers or not memory:
        return np.zeros((0, 4))
    direction = np.concatenate([stars.direction for stars in memory])
    number = np.concatenate([np.full(len(stars.flux_e), k) for k, stars in enumerate(memory)])
    row, col = mid_frame_pixels(solution, direction)
    values = np.column_stack((row, col, *(np.concatenate([getattr(s, name) for s in memory]) for name in ("flux_e", "snr"))))
    near = np.zeros(len(row), dtype=np.bool_)
    for mover_row, mover_col, reach in movers:
        near |= np.hypot(row - mover_row, col - mover_col) < reach
    values, number = values[near], number[near]
    out = []
    while len(values):
        same = np.hypot(values[:, 0] - values[0, 0], values[:, 1] - values[0, 1]) < SAME_STAR_PX
        if len(np.unique(number[same])) >= FEWEST_FRAMES:
            # The entries are means over the same few frames, so several of them have no more information than one.
            out.append([*values[same].mean(axis=0)])
        values, number = values[~same], number[~same]
    found = np.array(out).reshape(-1, 4)
    if len(found) == 0 or len(frame.remembered) == 0:
        return found
    sent = scipy.spatial.cKDTree(np.column_stack((frame.remembered.row, frame.remembered.col)))
    return np.asarray(found[sent.query(found[:, :2])[0] > SAME_STAR_PX])


def _joined(stars: StarList, more: NDArray[np.float64]) -> StarList:
    """A star list with further ones, by falling flux."""
    flux = np.append(stars.flux_e, more[:, 2].astype(np.float32))
    order = np.argsort(-flux, kind="stable")
    flags = np.append(stars.flags, np.full(len(more), int(StarFlag.REMEMBERED), dtype=stars.flags.dtype))
    return StarList(
        row=np.append(stars.row, more[:, 0])[order],
        col=np.append(stars.col, more[:, 1])[order],
        flux_e=flux[order],
        snr=np.append(stars.snr, more[:, 3].astype(np.float32))[order],
        flags=flags[order],
    )
