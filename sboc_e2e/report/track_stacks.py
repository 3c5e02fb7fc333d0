"""Tracklets that no single frame shows: the strips of their frames along the motion, one above the other, and the sum of all.

Each strip is read along its own trail, from its earlier to its later end, so that the object lies in the same place of all of
them, whatever stars and fixed patterns do. They are in units of their own noise and clipped, as the on-board filter clips.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.report import pictures

FAINT_SNR: Final = 7.2
"""No member may reach what the detector asks of a single frame."""

MOST_TRACKS: Final = 12  # tracklets that are shown, the faintest in their best frame first. Chosen for the page's size
MOST_STRIPS: Final = 12  # frames of one picture. Chosen: no window on board is longer than 15
ACROSS_PX: Final = 25  # rows of a strip: twelve pixels to either side, six widths of a PSF. Chosen
ALONG_PX: Final = 160  # columns of a strip; the trail fills the middle `1 / (1 + 2 MARGIN)` of them. Chosen
MARGIN: Final = 0.4
"""Sky before and behind the trail, in lengths."""

CLIP_SIGMA: Final = 4.0  # as on board: stars and particles are brighter, what no frame shows is not
SMOOTH_PX: Final = 0.85  # the PSF of the presets. Smoothing by it is the matched filter across the trail
SMOOTH_COLUMNS: Final = ALONG_PX / (1.0 + 2.0 * MARGIN) / 15.0
"""Along the trail strips are smoothed by a fifteenth of it, so that an eye need not do it, and the ends stay to be seen."""

BLACK_SIGMA, WHITE_SIGMA = -2.0, 6.0
LINE: Final = 2  # rows between strips


@dataclass(frozen=True, kw_only=True)
class TrackStack:
    """A picture and what stands below it. snr : of the members, by frame; joint_snr : root of the sum of their squares."""

    tracklet: int
    frames: tuple[int, ...]
    snr: tuple[float, ...]
    joint_snr: float
    length_px: float
    picture: str


def faint_tracks(streaks: Table, kept: set[int]) -> list[NDArray[np.int64]]:
    """Rows of the members, by frame, of each tracklet that has two or more in kept frames, all of them below FAINT_SNR."""
    tracklet, frame = np.asarray(streaks["tracklet_id"]), np.asarray(streaks["frame"])
    snr = np.asarray(streaks["snr"], dtype=np.float64)
    shown = np.isin(frame, sorted(kept))
    out = []
    for number in np.unique(tracklet[tracklet >= 0]):
        rows = np.flatnonzero((tracklet == number) & shown)
        if len(np.unique(frame[rows])) >= 2 and np.nanmax(snr[tracklet == number], initial=0.0) < FAINT_SNR:
            out.append(rows[np.argsort(frame[rows], kind="stable")])
    return sorted(out, key=lambda rows: float(np.nanmax(snr[rows])))[:MOST_TRACKS]


def strip(image: NDArray[np.float32], ends: NDArray[np.float64]) -> NDArray[np.float32]:
    """Pixels about a trail (2, 2: row, col of both ends) in units of their noise, ALONG_PX from before the first end on.

    Where a column is longer than a pixel it is the mean of several samples. What lies outside the image is 0.
    """
    way = ends[1] - ends[0]
    length = max(float(np.hypot(*way)), 1.0)
    u = way / length
    samples = max(1, round((1.0 + 2.0 * MARGIN) * length / ALONG_PX))
    along = np.linspace(-MARGIN * length, (1.0 + MARGIN) * length, ALONG_PX * samples)[None, :]
    across = (np.arange(ACROSS_PX) - ACROSS_PX // 2)[:, None]
    row = (ends[0, 0] + along * u[0] - across * u[1]).astype(np.float32)
    col = (ends[0, 1] + along * u[1] + across * u[0]).astype(np.float32)
    read = cv2.remap(image, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    low, middle, high = np.nanpercentile(read, [25, 50, 75]) if np.isfinite(read).any() else (0.0, 0.0, 1.0)
    sigma = max(float(high - low) / 1.349, 1e-6)
    clipped = np.clip(np.nan_to_num((read - middle) / sigma), -CLIP_SIGMA, CLIP_SIGMA)
    mean = clipped.reshape(ACROSS_PX, ALONG_PX, samples).mean(axis=2).astype(np.float32)
    smooth = cv2.GaussianBlur(mean, (0, 0), sigmaX=SMOOTH_COLUMNS, sigmaY=SMOOTH_PX)
    return in_noise(np.where(mean == 0.0, np.float32(0.0), smooth))


def in_noise(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same over the noise of the sky beside the trail, less its level; pixels of 0 are none."""
    sky = np.concatenate([values[: ACROSS_PX // 3], values[-(ACROSS_PX // 3) :]])
    sky = sky[sky != 0.0]
    low, middle, high = np.percentile(sky, [25, 50, 75]) if sky.size else (0.0, 0.0, 1.0)
    return np.asarray((values - middle) / max(float(high - low) / 1.349, 1e-6), dtype=np.float32)


def stacked(strips: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """The sum of strips, in units of its noise."""
    return in_noise(np.sum(strips, axis=0, dtype=np.float32))


def picture(strips: list[NDArray[np.float32]]) -> NDArray[np.uint8]:
    """Strips one above the other, and below a thick line the sum of all."""
    line = np.full((LINE, ALONG_PX), WHITE_SIGMA, np.float32)
    parts = [part for each in strips[:MOST_STRIPS] for part in (each, line)] + [line, stacked(strips)]
    grey = (np.concatenate(parts) - BLACK_SIGMA) / (WHITE_SIGMA - BLACK_SIGMA)
    return np.asarray(np.clip(255.0 * grey, 0.0, 255.0), dtype=np.uint8)


def track_stacks(streaks: Table, kept: dict[int, Path], dark: NDArray[np.float32] | None) -> list[TrackStack]:
    """Pictures of the faintest tracklets of a run. kept : FITS file of each frame that was kept; dark : ADU, None without one."""
    tracks = faint_tracks(streaks, set(kept))
    wanted = {int(streaks["frame"][row]) for rows in tracks for row in rows}
    strips: dict[int, NDArray[np.float32]] = {}
    for number in sorted(wanted):
        image = pictures.read_pixels(kept[number])
        if dark is not None and dark.shape == image.shape:
            image -= dark
        for rows in tracks:
            for row in rows[np.asarray(streaks["frame"][rows]) == number]:
                strips[int(row)] = strip(image, in_time(streaks, int(row)))
    return [_described(streaks, rows, [strips[int(row)] for row in rows]) for rows in tracks]


def in_time(streaks: Table, row: int) -> NDArray[np.float64]:
    """Ends (2, 2) of a streak, the one that its tracklet's motion leaves first where epochs tell it."""
    s = streaks[row]
    ends = np.array([[s["row0"], s["col0"]], [s["row1"], s["col1"]]], dtype=np.float64)
    turned = "t1_tai_ns" in streaks.colnames and int(s["t1_tai_ns"]) < int(s["t0_tai_ns"])
    return ends[::-1] if turned else ends


def _described(streaks: Table, rows: NDArray[np.int64], strips: list[NDArray[np.float32]]) -> TrackStack:
    snr = [float(streaks["snr"][row]) for row in rows]
    lengths = [float(np.hypot(*np.diff(in_time(streaks, int(row)), axis=0)[0])) for row in rows]
    return TrackStack(
        tracklet=int(streaks["tracklet_id"][rows[0]]),
        frames=tuple(int(streaks["frame"][row]) for row in rows),
        snr=tuple(round(s, 1) for s in snr),
        joint_snr=round(math.sqrt(math.fsum(s * s for s in snr)), 1),
        length_px=round(float(np.median(lengths)), 1),
        picture=pictures.data_uri(picture(strips), lossless=True),
    )
