"""What moved: detections held against the earlier frame, and movers too short for a line search.

Short movers come from the star list: entries that were not there before, or whose centroid has moved.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import whiten
from onboard.detect.line_integral import halos, point_movers, sharpness, static_sky
from onboard.detect.line_integral.segments import MAX_TRAILS, POINT_LIKE_PX, edge_flags, ends_of
from onboard.detect.line_integral.star_removal import TILE_PX, WorkingImages, noise_e, snr_before
from onboard.image import registration
from onboard.image.nearest import nearest
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.icd.work import Work

SLOW_SNR: Final = 80.0
"""Least S/N of star-like objects whose motion is seen as a shift of the centroid."""

SLOW_SHIFT_PX: Final = 0.5
"""Least shift of such an object between frames, stars held fixed."""

SLOW_REACH_PX: Final = 3.0
"""Largest such shift; faster objects leave their place empty and are new entries."""

STAR_LIKE_PX: Final = 20.0
"""Shorter trails may be a faint star, or two of them in a row."""

GATHERING_PX: Final = 250.0
"""Longer trails gather so many unlisted stars in the earlier frame that their light there says little.

With 1,000 px a seventh fewer false lines pass (59, not 69 at 150 px, in 40 frames at 6.7 sigma), but trails of 300 px need 0.1
more S/N.
"""

STATIC_SHARE: Final = 0.15
"""Light left by stars is the same in both frames: false lines (142 in 16 blank frames) showed 0.15 of their S/N more in the
earlier one than trails do ..."""

STATIC_SIGMA: Final = 1.7
"""... and what exceeds this, as one place in 22 does by noise, is taken for a star, a spike or a column."""

VARIED_SIGMA: Final = 4.8
"""Rise of a point source between two frames, in sigma of their difference, that stars of constant light do not reach.

With N stars per frame near the threshold false alarms are N Q(z): 30,000 give 0.02 per frame. A star-like object that was not
there before is thus found from S on, S^2 = 2 z^2 (1 + nu S / 2) (`point_movers.object_noise`): 8.8 in the preset.
"""


def _snr_beyond(snr: float, before: float) -> float:
    """S/N of a detection less what stood there before: a small share of it, and all of it beyond STATIC_SIGMA."""
    return snr - STATIC_SHARE * before - (1.0 - STATIC_SHARE) * max(0.0, before - STATIC_SIGMA)


def stays_above_earlier(
    detection: Detection,
    earlier: static_sky.EarlierFrame,
    images: WorkingImages,
    psf_sigma_px: float,
    n_sigma: float,
    short_margin: float,
) -> bool:
    """Whether a detection stays above n_sigma once what the earlier frame shows at its place is held against it.

    The place is that among the stars (faint stars in a row, spikes) and that on the sensor (columns). Light of stars that were
    subtracted from this frame does not count, and long segments are refused only when nearly all of their light was there before.
    The part of short_margin asked of short ones goes from all at no length to nothing at STAR_LIKE_PX.
    """
    row, col, earlier_snr = images.subtracted.T
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    wanted = n_sigma + short_margin * max(0.0, 1.0 - detection.length_px / STAR_LIKE_PX)
    # among the stars these lie where they lie in this frame, on the sensor where the earlier frame had them
    back = registration.inverse(earlier.transform)
    for transform, sky, places in (
        (earlier.transform, registration.IDENTITY, registration.IDENTITY),
        (registration.IDENTITY, back, earlier.transform),
    ):
        before = static_sky.segment_snr_before(
            earlier.frame.pixels, transform, sky, (images.blocked, whiten.FOUND_BIT), (images.level, TILE_PX), ends, psf_sigma_px
        )
        if math.isnan(before):
            continue
        before -= halos.subtracted_snr(images.halos, places, images.blocked, whiten.FOUND_BIT, ends, psf_sigma_px)
        if before > 0.8 * detection.snr:
            return False
        if detection.length_px < GATHERING_PX and _snr_beyond(detection.snr, before) < wanted:
            before -= static_sky.subtracted_snr(row, col, earlier_snr, places, ends, psf_sigma_px)
            if _snr_beyond(detection.snr, before) < wanted:
                return False
    return True


def short_detections(
    view: DetectorView,
    earlier: static_sky.EarlierFrame,
    images: WorkingImages,
    smooth: NDArray[np.int8],
    n_sigma: float,
) -> list[Detection]:
    """Star-like and short movers: new entries of the star list, refined; a static source of changed brightness is refused."""
    stars, s_px = view.stars, view.psf_sigma_px
    entries = images.new[~images.sharp]
    table, done, left = point_movers.short_trails(
        images.image,
        smooth,
        images.blocked,
        stars.row[entries],
        stars.col[entries],
        s_px,
        n_sigma,
        whiten.FOUND_BIT,
        MAX_TRAILS,
        view.work.left(Work.POINTS),
    )
    view.work.spend(Work.POINTS, done)
    view.work.leave(Work.POINTS, left)
    before = snr_before(earlier, table[:, 2], table[:, 3], s_px)
    sigma_e = noise_e(view)
    found = []
    for (_, snr, row, col, angle, length), old in zip(table, before, strict=True):
        if not (snr - max(old, 0.0) > n_sigma and point_movers.rise_sigma(snr, old, s_px, sigma_e) > VARIED_SIGMA):
            continue
        ends = ends_of(row, col, angle, length, view.residual_adu.shape)
        flags = edge_flags(ends, view.residual_adu.shape, float(snr))
        if length < POINT_LIKE_PX:
            flags |= StreakFlag.POINT_LIKE
        row0, col0, row1, col1 = ends
        found.append(Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=float(snr), flags=flags))
    return found


def slow_movers(view: DetectorView, earlier: static_sky.EarlierFrame) -> list[Detection]:
    """Bright star-like objects that moved by a fraction of a pixel to a few pixels: clean list entries matched in both frames.

    A centroid is good to about s sqrt(2) / S px, so at S/N SLOW_SNR a shift of SLOW_SHIFT_PX is over twenty sigma: what is left
    are blends.
    """
    stars, listed = view.stars, earlier.frame.stars
    # in both frames: a particle that hits a star moves its centroid, and so does a hot pixel that a star comes to lie beside
    clean, known = (stars.snr >= SLOW_SNR) & (stars.flags == 0), (listed.snr >= 0.5 * SLOW_SNR) & (listed.flags == 0)
    bright = np.flatnonzero(clean)
    hit = point_movers.holds_sharp_pixel(
        view.residual_adu,
        view.mask,
        view.background.sigma_adu,
        view.background.tile_px,
        stars.row[bright],
        stars.col[bright],
        sharpness.measured_width_px(view),
    )
    clean[bright[hit]] = False
    if not clean.any() or not known.any():
        return []
    place = np.column_stack([stars.row[clean], stars.col[clean]])
    before = np.column_stack([listed.row[known], listed.col[known]])
    shift, index = nearest(registration.apply(earlier.transform, place), before, SLOW_REACH_PX)
    matched = np.isfinite(shift)
    ratio = np.full(len(shift), np.inf)
    ratio[matched] = listed.snr[known][index[matched]] / stars.snr[clean][matched]
    moved_far = matched & (shift > SLOW_SHIFT_PX) & (np.abs(np.log(ratio)) < 0.4)
    return [
        Detection(row0=float(row), col0=float(col), row1=float(row), col1=float(col), snr=float(snr), flags=StreakFlag.POINT_LIKE)
        for (row, col), snr in zip(place[moved_far], stars.snr[clean][moved_far], strict=True)
        if 0.0 <= row <= view.residual_adu.shape[0] - 1 and 0.0 <= col <= view.residual_adu.shape[1] - 1
    ]


def particle_hits(view: DetectorView, images: WorkingImages, n_sigma: float, most: int) -> list[Detection]:
    """New entries sharper than the PSF, brightest first and no more than `most`."""
    stars = view.stars
    rows, cols = view.residual_adu.shape
    sharp = images.new[images.sharp]
    sharp = sharp[stars.snr[sharp] >= n_sigma]
    hits = sharp[np.argsort(-stars.snr[sharp], kind="stable")[:most]]
    places = zip(np.clip(stars.row[hits], 0, rows - 1), np.clip(stars.col[hits], 0, cols - 1), stars.snr[hits], strict=True)
    flags = StreakFlag.COSMIC_LIKE | StreakFlag.POINT_LIKE
    return [
        Detection(row0=row, col0=col, row1=row, col1=col, snr=snr, flags=flags)
        for row, col, snr in ((float(row), float(col), float(snr)) for row, col, snr in places)
    ]
