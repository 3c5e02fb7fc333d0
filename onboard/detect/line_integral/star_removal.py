"""A view without its stars: bright ones masked, faint ones subtracted with the flux they had a frame earlier."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import dotted, star_mask, whiten
from onboard.detect.line_integral import halos, point_movers, static_sky
from onboard.detect.line_integral.kept_frame import quantised
from onboard.detect.line_integral.sharpness import measured_width_px
from sboc_e2e.icd.signals import DetectorView

TILE_PX: Final = 64
"""Tiles of the level that the background mesh left over, and of whole-pixel shifts between frames."""

POINT_CLIP_SIGMA: Final = 7.5
"""Clip of the full-resolution smoothed image: what 8 bits hold."""

SUBTRACT_SNR: Final = 8.0
"""Stars up to this S/N are subtracted; brighter ones leave too much Poisson noise and PSF error and are masked."""

STATIC_EACH: Final = 32
"""An unlisted star shows at least 2 sigma in each of two frames ..."""

STATIC_BOTH: Final = 86
"""... and 3.8 sigma in their mean (3.8 sqrt 2 sigma in the sum), in sigma/16."""

MAX_UNLISTED: Final = 200_000
"""Room for unlisted stars."""

TRAIL_LEVEL: Final = 2.5
"""Point-source S/N on the faintest trails of 20 px that are found (7 sqrt(2 sqrt(pi) s / 20) = 2.7): there `star_light` tells a
star from noise in the earlier frame."""

COUNTS_SLOPE: Final = 0.9
"""Stars above S/N S are as many as S to minus this."""

CLIPPED_RADIUS_PX: Final = 2.0
"""Mask about pixels where both smoothed frames are at their clip: blends, the bright part of spikes, tails of columns."""

HIT_RADIUS_PX: Final = 2.5
"""Mask of a particle hit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkingImages:
    """image : (rows, cols) int8, sigma/16, noise-normalised and without stars.

    blocked : uint8, 0 = usable. level : mesh of what the background left over, sigma/16.
    stars : which entries of the star list are stars. subtracted : (n, 3) row, col and S/N of the light that was
    subtracted, not masked. new : entries that the earlier frame does not show; sharp : those among them that are sharper than
    the PSF.
    """

    image: NDArray[np.int8]
    blocked: NDArray[np.uint8]
    level: NDArray[np.float32]
    stars: NDArray[np.bool_]
    subtracted: NDArray[np.float64]
    halos: halos.Halos
    new: NDArray[np.int64]
    sharp: NDArray[np.bool_]


def snr_before(
    earlier: static_sky.EarlierFrame, row: NDArray[np.float64], col: NDArray[np.float64], psf_sigma_px: float
) -> NDArray[np.float64]:
    """Point-source S/N in the earlier frame at the mapped places of points of this one, shape (n,), NaN where unknown."""
    out = np.empty(len(row))
    order = star_mask.by_row(row)
    out[order] = static_sky.point_snr_before(earlier.frame.pixels, earlier.transform, row[order], col[order], psf_sigma_px)
    return out


def remove_stars_alone(
    view: DetectorView, image: NDArray[np.int8], blocked: NDArray[np.uint8], halo_px: float
) -> NDArray[np.bool_]:
    """Mask the listed stars of a frame without a predecessor, in place; entries that are pieces of trails stay.

    Returns which entries are stars, (n,).
    """
    stars, psf_sigma_px = view.stars, view.psf_sigma_px
    no_level = np.zeros((1, 1), np.float32)
    smooth = whiten.smooth(image, no_level, max(image.shape), whiten.odd_taps(psf_sigma_px), POINT_CLIP_SIGMA)
    pieces = star_mask.trail_pieces(
        view.residual_adu,
        smooth,
        view.background.sigma_adu,
        view.background.tile_px,
        stars.row,
        stars.col,
        stars.snr,
        psf_sigma_px,
        stars.psf_sigma_px is not None,
    )
    pieces |= dotted.dots_in_rows(stars.row, stars.col, image.size)
    order = star_mask.by_row(stars.row)
    mask_stars(view, order[~pieces[order]], image, blocked, halo_px)
    return ~pieces


def noise_e(view: DetectorView) -> float:
    """Noise of a pixel, e-."""
    return float(np.median(view.background.sigma_adu)) * (view.header.gain_e_adu or 1.0)


def mask_stars(
    view: DetectorView, chosen: NDArray[np.intp], image: NDArray[np.int8], blocked: NDArray[np.uint8], halo_px: float
) -> halos.Halos:
    """Mask some of the listed stars, those from `halos.HALO_SNR` on with their halos as they are measured; in place."""
    snr = view.stars.snr[chosen]
    bright = snr >= halos.HALO_SNR
    radii = star_mask.mask_radii_px(snr, view.psf_sigma_px, np.where(bright, 0.0, halo_px))
    whiten.blank_discs(image, blocked, view.stars.row[chosen], view.stars.col[chosen], radii)
    return halos.take_out(image, blocked, view.stars, chosen[bright], radii[bright], noise_e(view), view.work)


def remove_static_stars(
    view: DetectorView, earlier: static_sky.EarlierFrame, image: NDArray[np.int8], blocked: NDArray[np.uint8], halo_px: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64], halos.Halos]:
    """Mask bright stars and subtract faint ones that the earlier frame shows too, listed or not; in place.

    List entries that were not there are pieces of trails, movers or particle hits and stay in the image, except hits
    sharper than the PSF, which are masked. Returns the new entries (indices), which of them are sharp, and what was
    subtracted, (n, 3): row, col, S/N.
    """
    stars, psf_sigma_px = view.stars, view.psf_sigma_px
    sigma, tile_px = view.background.sigma_adu, view.background.tile_px
    before = snr_before(earlier, stars.row, stars.col, psf_sigma_px)
    # unknown (masked or outside then): a star; else a star of this brightness is almost never fainter than a third of it
    static = ~(before < np.maximum(1.5, 0.33 * stars.snr))
    is_faint = static & (stars.snr < SUBTRACT_SNR) & (before < 1.5 * SUBTRACT_SNR)
    order = star_mask.by_row(stars.row)
    faint, bright = order[is_faint[order]], order[(static & ~is_faint)[order]]
    light = mask_stars(view, bright, image, blocked, halo_px)
    static_sky.subtract_stars(image, blocked, stars.row[faint], stars.col[faint], before[faint], psf_sigma_px)
    new = np.flatnonzero(~static)
    fraction = point_movers.peak_fraction(measured_width_px(view))
    sharp = point_movers.sharper_than_psf(
        view.residual_adu, sigma, tile_px, stars.row[new], stars.col[new], stars.snr[new], fraction
    )
    hits = new[sharp]
    whiten.blank_discs(image, blocked, stars.row[hits], stars.col[hits], np.full(len(hits), HIT_RADIUS_PX))
    bright_per_px = float(np.count_nonzero(stars.snr[static] > SUBTRACT_SNR)) / image.size
    places = unlisted_stars(image, blocked, earlier, bright_per_px, psf_sigma_px)
    row, col, snr = np.ascontiguousarray(places.T)  # as above, so that one kernel serves both
    static_sky.subtract_stars(image, blocked, row, col, snr, psf_sigma_px)
    listed = np.column_stack([stars.row[faint], stars.col[faint], before[faint]])
    return new, sharp, np.concatenate([listed, places]), light


def star_light(
    now: NDArray[np.float64], before: NDArray[np.float64], bright_per_px: float, psf_sigma_px: float
) -> NDArray[np.float64]:
    """What to take for a star's light, (n,) in S/N, where smoothed frames have a common maximum of S/N now and then.

    Either noise peaks there in the earlier frame, or a star of that S/N stands there. A trail of point-source S/N t makes that
    P(t) = noise(then) phi(now - t) + star(then) phi((now - t - then) / sqrt 2) / sqrt 2. With light d taken away the place adds
    (now - d) t - t^2 / 2 to a trail's log likelihood: d is what makes this log P(t) / P(0) at t = TRAIL_LEVEL. So a trail over
    noise that passes for a faint star keeps its light, and stars do not come through.

    bright_per_px : stars above SUBTRACT_SNR per px, from which star(S) follows. noise(S) : maxima of smoothed noise per px and
    S/N (Adler & Taylor 2007, leading term).
    """
    noise = before * (before**2 - 1.0) * np.exp(-0.5 * before**2) / (2.0 * psf_sigma_px**2 * (2.0 * math.pi) ** 1.5)
    star = COUNTS_SLOPE / SUBTRACT_SNR * bright_per_px * (before / SUBTRACT_SNR) ** (-1.0 - COUNTS_SLOPE)

    def likelihood(trail: float) -> NDArray[np.float64]:
        beside = now - trail
        return noise * np.exp(-0.5 * beside**2) + math.sqrt(0.5) * star * np.exp(-0.25 * (beside - before) ** 2)

    gain = np.log(likelihood(TRAIL_LEVEL) / likelihood(0.0))
    return np.clip(now - gain / TRAIL_LEVEL - 0.5 * TRAIL_LEVEL, 0.0, before)


def unlisted_stars(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    earlier: static_sky.EarlierFrame,
    bright_per_px: float,
    psf_sigma_px: float,
) -> NDArray[np.float64]:
    """Stars too faint for the list that the earlier frame shows too, (n, 3): row, col, S/N to subtract.

    The two frames are smoothed in bands of one row of tiles, which stay in the cache, instead of as whole images.
    """
    codes, taps, no_level = earlier.frame.pixels[0], whiten.odd_taps(psf_sigma_px), np.zeros((1, 1), np.float32)
    rows, cols = image.shape
    margin = len(taps)  # the kernel's reach, and one row for the test of a local maximum
    places, found = np.empty((MAX_UNLISTED, 4)), 0
    for top in range(0, rows, TILE_PX):
        low, high = static_sky.shifted_rows(earlier.transform, top, TILE_PX, cols)
        first, stop = max(0, top + low - margin), min(rows, top + TILE_PX + high + margin)
        if stop <= first:
            continue
        now_first, now_stop = max(0, top - margin), min(rows, top + TILE_PX + margin)
        found = static_sky.faint_static_stars(
            whiten.smooth(image[now_first:now_stop], no_level, max(image.shape), taps, POINT_CLIP_SIGMA),
            whiten.smooth(quantised(codes[first:stop]), no_level, max(image.shape), taps, POINT_CLIP_SIGMA),
            now_first,
            first,
            top,
            rows,
            earlier.transform,
            STATIC_EACH,
            STATIC_BOTH,
            round(POINT_CLIP_SIGMA * whiten.UNIT),
            TILE_PX,
            places,
            found,
        )
    row, col, now, earlier_snr = places[:found].T
    clipped = now + earlier_snr >= 2.0 * POINT_CLIP_SIGMA
    whiten.blank_discs(image, blocked, row[clipped], col[clipped], np.full(int(clipped.sum()), CLIPPED_RADIUS_PX))
    row, col, now, earlier_snr = places[:found][~clipped].T
    return np.column_stack([row, col, star_light(now, earlier_snr, bright_per_px, psf_sigma_px)])


def working_images(view: DetectorView, earlier: static_sky.EarlierFrame | None, *, halo_px: float) -> WorkingImages:
    """Noise-normalised and star-free image of a view."""
    image = whiten.quantise(view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px)
    blocked = whiten.unusable(view.mask)
    new, sharp = np.zeros(0, np.int64), np.zeros(0, np.bool_)
    is_star, subtracted = np.ones(len(view.stars), np.bool_), np.zeros((0, 3))
    light = halos.none()
    if earlier is not None:
        new, sharp, subtracted, light = remove_static_stars(view, earlier, image, blocked, halo_px)
        is_star[new] = False
    elif len(view.stars):
        is_star = remove_stars_alone(view, image, blocked, halo_px)
    level = whiten.local_level(image, blocked, TILE_PX)
    return WorkingImages(
        image=image, blocked=blocked, level=level, stars=is_star, subtracted=subtracted, halos=light, new=new, sharp=sharp
    )
