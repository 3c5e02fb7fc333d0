"""Connected pixels above a threshold to segments: the last step of detectors with a pixel threshold.

Ends are on the principal axis of the pixels of a component. Collinear pieces are joined. Every segment gets its
matched-filter S/N from the same noise-normalised image as the default detector.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import star_mask, whiten
from onboard.detect.cross_profile import cross_profile
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView

FWHM: Final = 2.354820045
"""Full width at half maximum of a Gaussian of unit sigma."""

HALF_RESOLUTION_UNIT: Final = 2 * whiten.UNIT
"""One sigma of the noise in `half_resolution`."""

AROUND_PX: Final = star_mask.WIDE_REACH_PX + 2 * 8
"""Margin about a piece of the image: the reach of the test for trails and of the smoothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MaskedImage:
    """image : (rows, cols) int8, sigma/16; blocked : uint8, 0 = usable. Stars and defective pixels are blank in both."""

    image: NDArray[np.int8]
    blocked: NDArray[np.uint8]


def masked_image(view: DetectorView, halo_px: float, least_snr: float = 0.0) -> MaskedImage:
    """The view in units of sigma/16 with its stars from `least_snr` on (but not the trails in the star list) taken out."""
    sigma, tile_px = view.background.sigma_adu, view.background.tile_px
    image = whiten.quantise(view.residual_adu, view.mask, sigma, tile_px)
    masked = MaskedImage(image=image, blocked=whiten.unusable(view.mask))
    _take_out(masked, view, np.flatnonzero(view.stars.snr >= least_snr), halo_px)
    return masked


def half_resolution(masked: MaskedImage, psf_sigma_px: float) -> NDArray[np.int16]:
    """The image filtered by the PSF and binned 2 x 2; its noise is `HALF_RESOLUTION_UNIT`."""
    no_level = np.zeros((1, 1), np.float32)
    return whiten.smooth_binned(masked.image, no_level, max(masked.image.shape), whiten.even_taps(psf_sigma_px), 30.0)


def take_out_near(
    masked: MaskedImage, view: DetectorView, segments: NDArray[np.float64], *, below_snr: float, within_px: float, halo_px: float
) -> None:
    """Take the stars fainter than `below_snr` near some segments (n, 4) out of an image as well, in place."""
    faint = np.flatnonzero(view.stars.snr < below_snr)
    for row0, col0, row1, col1 in segments:
        row, col = view.stars.row[faint], view.stars.col[faint]
        beside = (row > min(row0, row1) - within_px) & (row < max(row0, row1) + within_px)
        beside &= (col > min(col0, col1) - within_px) & (col < max(col0, col1) + within_px)
        index = faint[beside]
        row, col, drow, dcol = row[beside] - row0, col[beside] - col0, row1 - row0, col1 - col0
        share = np.clip((row * drow + col * dcol) / max(drow**2 + dcol**2, 1e-12), 0.0, 1.0)
        _take_out(masked, view, index[np.hypot(row - share * drow, col - share * dcol) < within_px], halo_px)


def _take_out(masked: MaskedImage, view: DetectorView, chosen: NDArray[np.intp], halo_px: float) -> None:
    """Blank the chosen entries of the star list that are stars; faint ones are told from trails on a smoothed image."""
    if len(chosen) == 0:
        return
    chosen = chosen[star_mask.by_row(view.stars.row[chosen])]
    stars, background = view.stars, view.background
    row, col, snr = stars.row[chosen], stars.col[chosen], stars.snr[chosen]
    faint = snr < star_mask.FAINT_SNR
    residual, sigma, tile_px = view.residual_adu, background.sigma_adu, background.tile_px
    corner, smooth = (0, 0), np.zeros((1, 1), np.int8)
    if faint.any():
        window = _around(row, col, view.mask.shape, tile_px)
        corner = (window[0].start, window[1].start)
        piece, level = masked.image[window], np.zeros((1, 1), np.float32)
        smooth = whiten.smooth(piece, level, max(piece.shape), whiten.odd_taps(view.psf_sigma_px), 7.0)
        residual, sigma = residual[window], sigma[corner[0] // tile_px :, corner[1] // tile_px :]
    trail = star_mask.trail_pieces(
        residual, smooth, sigma, tile_px, row - corner[0], col - corner[1], snr, view.psf_sigma_px, stars.psf_sigma_px is not None
    )
    radius = star_mask.mask_radii_px(snr[~trail], view.psf_sigma_px, halo_px)
    whiten.blank_discs(masked.image, masked.blocked, row[~trail], col[~trail], radius)


def _around(row: NDArray[np.float64], col: NDArray[np.float64], shape: tuple[int, ...], tile_px: int) -> tuple[slice, slice]:
    """The part of a frame, from the corner of a mesh tile on, with some points and what tells stars from trails about them."""
    parts = []
    for values, size in ((row, shape[0]), (col, shape[1])):
        first = max(math.floor(float(values.min())) - AROUND_PX, 0) // tile_px * tile_px
        parts.append(slice(first, min(math.ceil(float(values.max())) + AROUND_PX + 1, size)))
    return parts[0], parts[1]


def segment_snr(masked: MaskedImage, ends: NDArray[np.float64], psf_sigma_px: float) -> float:
    """Matched-filter S/N along a straight segment; ends (row0, col0, row1, col1) px."""
    row0, col0, row1, col1 = ends
    image, blocked = masked.image, masked.blocked
    if abs(row1 - row0) < abs(col1 - col0):
        image, blocked = image.T, blocked.T
        row0, col0, row1, col1 = col0, row0, col1, row1
    if row1 < row0:
        row0, col0, row1, col1 = row1, col1, row0, col0
    room = math.ceil(row1 - row0) + 3
    signal, weight = np.zeros(room), np.zeros(room)
    _, n = cross_profile(
        image,
        blocked,
        np.zeros((1, 1), np.float32),
        max(image.shape),
        row0,
        col0,
        max(row1, row0 + 1.0),
        col1,
        0.0,
        0,
        psf_sigma_px,
        signal,
        weight,
    )
    total = float(weight[:n].sum())
    return float(signal[:n].sum()) / math.sqrt(total) if total > 0.0 else 0.0


def elongated_components(
    above: NDArray[np.bool_], *, min_length_px: float, min_axis_ratio: float, min_area_px: int = 1
) -> NDArray[np.float64]:
    """Segments (n, 4) row0, col0, row1, col1 of the components that are large, long and thin enough.

    Length and axis ratio from the second moments of the pixels: a uniform bar of length L has variance L^2/12 along it.
    """
    import cv2  # takes 20 MB of memory that `threshold` does not need

    count, labels, _, _ = cv2.connectedComponentsWithStatsWithAlgorithm(above.astype(np.uint8), 8, cv2.CV_32S, cv2.CCL_BBDT)
    row, col = np.nonzero(labels)
    label = labels[row, col]
    area = np.maximum(np.bincount(label, minlength=count), 1)
    mean_row = np.bincount(label, weights=row, minlength=count) / area
    mean_col = np.bincount(label, weights=col, minlength=count) / area
    d_row, d_col = row - mean_row[label], col - mean_col[label]
    var_row = np.bincount(label, weights=d_row**2, minlength=count) / area + 1.0 / 12.0
    var_col = np.bincount(label, weights=d_col**2, minlength=count) / area + 1.0 / 12.0
    cov = np.bincount(label, weights=d_row * d_col, minlength=count) / area
    spread = np.hypot(0.5 * (var_row - var_col), cov)
    major, minor = 0.5 * (var_row + var_col) + spread, 0.5 * (var_row + var_col) - spread
    length = np.sqrt(12.0 * major)
    ratio = np.sqrt(major / np.maximum(minor, 1.0 / 12.0))
    angle = 0.5 * np.arctan2(2.0 * cov, var_col - var_row)
    kept = np.flatnonzero((length >= min_length_px) & (ratio >= min_axis_ratio) & (area >= min_area_px))
    kept = kept[kept > 0]
    half_row, half_col = 0.5 * length * np.sin(angle), 0.5 * length * np.cos(angle)
    ends = np.stack([mean_row - half_row, mean_col - half_col, mean_row + half_row, mean_col + half_col], axis=1)
    return ends[kept]


def join_collinear(segments: NDArray[np.float64], *, gap_px: float, across_px: float) -> NDArray[np.float64]:
    """Join segments (n, 4) that continue each other: longest first, gaps up to gap_px or half of the longer one's length."""
    todo = list(segments[np.argsort(-np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]))])
    done: list[NDArray[np.float64]] = []
    while todo:
        main = todo.pop(0)
        grown = True
        while grown:
            grown = False
            direction = np.array([main[2] - main[0], main[3] - main[1]])
            length = float(np.hypot(*direction))
            unit = direction / max(length, 1e-9)
            for k, other in enumerate(todo):
                points = other.reshape(2, 2) - main[:2]
                along, across = points @ unit, points @ np.array([-unit[1], unit[0]])
                gap = max(along.min() - length, -along.max(), 0.0)
                if np.abs(across).max() <= across_px + 0.02 * gap and gap <= max(gap_px, 0.5 * length):
                    reach = np.concatenate([[0.0, length], along])
                    offset = np.concatenate([[0.0, 0.0], across])
                    i, j = int(np.argmin(reach)), int(np.argmax(reach))
                    normal = np.array([-unit[1], unit[0]])
                    start = main[:2] + unit * reach[i] + normal * offset[i]
                    stop = main[:2] + unit * reach[j] + normal * offset[j]
                    main = np.concatenate([start, stop])
                    todo.pop(k)
                    grown = True
                    break
        done.append(main)
    return np.array(done).reshape(-1, 4)


def to_detections(
    masked: MaskedImage, segments: NDArray[np.float64], *, psf_sigma_px: float, min_snr: float, max_detections: int
) -> tuple[Detection, ...]:
    """Segments inside the frame above a matched-filter S/N, as contract records by falling S/N."""
    rows, cols = masked.image.shape
    top = np.array([rows - 1.0, cols - 1.0, rows - 1.0, cols - 1.0])
    out = []
    for ends in segments:
        clipped = np.clip(ends, 0.0, top)
        snr = segment_snr(masked, clipped, psf_sigma_px)
        if snr < min_snr:
            continue
        flags = StreakFlag(0)
        for k, flag in ((0, StreakFlag.EDGE0), (2, StreakFlag.EDGE1)):
            if min(clipped[k], clipped[k + 1], rows - 1 - clipped[k], cols - 1 - clipped[k + 1]) < 3.0:
                flags |= flag
        if math.hypot(clipped[2] - clipped[0], clipped[3] - clipped[1]) < 2.0 * FWHM * psf_sigma_px:
            flags |= StreakFlag.POINT_LIKE
        row0, col0, row1, col1 = (float(value) for value in clipped)
        out.append(Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=snr, flags=flags))
    return tuple(sorted(out, key=lambda d: -d.snr)[:max_detections])
