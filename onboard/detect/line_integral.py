"""`onboard.detector: line_integral`: matched-filter line integrals over all positions, angles and lengths.

noise-normalise, mask stars -> smooth by the PSF, bin 2 x 2 -> sums over dyadic segments of all lines -> candidates above a
low threshold -> continuous maximum of the matched filter at full resolution -> threshold, uniformity, one detection a streak.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect import dyadic, refine, star_mask, static_sky, whiten
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView

TILE_PX: Final = 64
"""Tiles of the level that the background mesh left over."""

MIN_ROWS: Final = 4
"""Shortest blocks searched, in rows of the half-resolution image (8 px)."""

MAX_CANDIDATES: Final = 50_000
"""Room for candidates of one quadrant of angles."""

SUBTRACT_SNR: Final = 8.0
"""Stars up to this S/N are subtracted; brighter ones leave too much Poisson noise and PSF error and are masked."""

STATIC_EACH: Final = 24
"""A faint star shows at least 1.5 sigma in each of two frames ..."""

STATIC_BOTH: Final = 81
"""... and 3.6 sigma in their mean (3.6 sqrt 2 sigma in the sum), in sigma/16."""

FOUND_BIT: Final = 4
"""Bit of the working mask under detections already made."""

POINT_CLIP_SIGMA: Final = 7.5
"""Clip of the full-resolution smoothed image: what 8 bits hold."""


def half_resolution_noise(binned: NDArray[np.int16], taps: NDArray[np.int16], blocked: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Variance per row of a line sum of the half-resolution image, for slope 0 and slope 1 (shape (2,))."""
    kernel = np.concatenate([taps[::-1], taps]).astype(np.float64)
    correlation = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :: 2]
    correlation = correlation[1:] / correlation[0]
    good = 1.0 - float(np.count_nonzero(blocked[::4, ::4])) / blocked[::4, ::4].size
    variance = (2.0 * whiten.UNIT) ** 2 * max(good, 0.01)
    return variance * np.array([1.0 + 2.0 * correlation.sum(), 1.0 + 2.0 * (correlation**2).sum()])


def coarse_segments(
    binned: NDArray[np.int16], noise: NDArray[np.float64], threshold_sigma: float, min_rows: int, max_found: int
) -> NDArray[np.float64]:
    """Candidates of all four quadrants of angles, (n, 6): axis, major0, minor0, major1, minor1 (px), S/N; best first."""
    tables = []
    for axis in (0, 1):
        image = np.ascontiguousarray(binned.T) if axis else binned
        for mirrored in (False, True):
            source = np.ascontiguousarray(image[:, ::-1]) if mirrored else image
            found = dyadic.line_sums(source, noise, threshold_sigma, min_rows, max_found).astype(np.float64)
            first = found[:, 2]
            last = first + found[:, 3]
            if mirrored:
                first, last = image.shape[1] - 1 - first, image.shape[1] - 1 - last
            table = np.empty((len(found), 6))
            table[:, 0] = axis
            table[:, 1] = 2.0 * found[:, 0] + 0.5
            table[:, 2] = 2.0 * first + 0.5
            table[:, 3] = 2.0 * (found[:, 0] + found[:, 1] - 1) + 0.5
            table[:, 4] = 2.0 * last + 0.5
            table[:, 5] = found[:, 4]
            tables.append(table)
    joined = np.concatenate(tables)
    return joined[np.argsort(-joined[:, 5], kind="stable")]


@nb.njit(cache=True)
def _accept(
    image: NDArray[np.int8], smooth: NDArray[np.int8], blocked: NDArray[np.uint8], level: NDArray[np.float32],
    candidate: NDArray[np.float64], psf_sigma_px: float, n_sigma: float, first_sigma: float, min_length_px: float,
    segment: NDArray[np.float64], sums: NDArray[np.int32], counts: NDArray[np.int32],
    signal: NDArray[np.float64], weight: NDArray[np.float64], points: NDArray[np.float64],
) -> float:
    """S/N of the trail at a candidate, 0 when there is none; a trail and false points on the way are taken out of the images."""
    snr = 0.0
    for turn in range(4):
        if turn == 0 and refine.locate(smooth, candidate, psf_sigma_px, segment, sums, counts) < first_sigma:
            return 0.0
        snr = refine.polish(image, blocked, level, TILE_PX, segment, psf_sigma_px, signal, weight)
        length = math.hypot(segment[2] - segment[0], segment[3] - segment[1])
        if snr < n_sigma or length < min_length_px:
            return 0.0
        expected = snr * math.sqrt(2.0 * math.sqrt(math.pi) * psf_sigma_px / length)
        if refine.blank_stars_on_path(image, smooth, blocked, segment, expected + 2.8) == 0:
            break
    if not refine.looks_like_trail(
        image, smooth, blocked, level, TILE_PX, segment, snr, psf_sigma_px, signal, weight, points
    ):
        return 0.0
    refine.blank_path(image, smooth, blocked, segment, 3.0 * psf_sigma_px + 1.0)
    return snr


@nb.njit(cache=True)
def resolve(
    image: NDArray[np.int8], smooth: NDArray[np.int8], blocked: NDArray[np.uint8], level: NDArray[np.float32],
    candidates: NDArray[np.float64], psf_sigma_px: float, n_sigma: float, first_sigma: float, min_length_px: float, max_found: int,
) -> NDArray[np.float64]:
    """Refine candidates best first; each accepted segment is taken out of the images before the next one is looked at.

    Returns (n, 7): axis, major0, minor0, major1, minor1, sagitta along minor (px), S/N.
    """
    image_t, smooth_t, blocked_t, level_t = image.T, smooth.T, blocked.T, level.T
    found = np.empty((max_found, 7))
    n_found = 0
    sums = np.empty((refine.PIECES, refine.OFFSETS), np.int32)
    counts = np.empty((refine.PIECES, refine.OFFSETS), np.int32)
    signal = np.empty(max(image.shape) + 1)
    weight = np.empty(max(image.shape) + 1)
    segment, points = np.empty(5), np.zeros((2, 3))
    for c in range(candidates.shape[0]):
        if n_found == max_found:
            break
        if candidates[c, 0] == 0.0:
            snr = _accept(
                image, smooth, blocked, level, candidates[c, 1:5], psf_sigma_px, n_sigma, first_sigma, min_length_px, segment,
                sums, counts, signal, weight, points,
            )
        else:
            snr = _accept(
                image_t, smooth_t, blocked_t, level_t, candidates[c, 1:5], psf_sigma_px, n_sigma, first_sigma, min_length_px,
                segment, sums, counts, signal, weight, points,
            )
        if snr >= n_sigma:
            found[n_found, 0] = candidates[c, 0]
            found[n_found, 1:6] = segment
            found[n_found, 6] = snr
            n_found += 1
    return found[:n_found]


def to_detection(row: NDArray[np.float64], shape: tuple[int, int]) -> Detection:
    """A row of `resolve` as a contract record: ends inside the frame, end 0 at smaller major coordinate."""
    axis = int(row[0])
    ends = [(row[1], row[2]), (row[3], row[4])]
    slope = (row[4] - row[2]) / max(row[3] - row[1], 1e-6)
    flags = StreakFlag(0)
    limits = shape if axis == 0 else shape[::-1]
    clipped = []
    for k, (major, minor) in enumerate(ends):
        if min(major, limits[0] - 1 - major, minor, limits[1] - 1 - minor) < 3.0:
            flags |= StreakFlag.EDGE0 if k == 0 else StreakFlag.EDGE1
        clipped.append((min(max(major, 0.0), limits[0] - 1.0), min(max(minor, 0.0), limits[1] - 1.0)))
    (a0, b0), (a1, b1) = clipped
    row0, col0, row1, col1 = (a0, b0, a1, b1) if axis == 0 else (b0, a0, b1, a1)
    sagitta = float(row[5]) / math.sqrt(1.0 + slope * slope)
    if abs(sagitta) < 0.3:
        sagitta = 0.0
    else:
        flags |= StreakFlag.CURVED
    # the contract's positive side is (+drow, -dcol) rotated from the chord: growing row for a chord along growing col
    signed = sagitta if axis == 1 else -sagitta
    return Detection(
        row0=float(row0), col0=float(col0), row1=float(row1), col1=float(col1), snr=float(row[6]), sagitta_px=signed, flags=flags
    )


def snr_before(
    earlier: static_sky.EarlierFrame, row: NDArray[np.float64], col: NDArray[np.float64], psf_sigma_px: float
) -> NDArray[np.float64]:
    """Point-source S/N in the earlier frame at the mapped places of points of this one, shape (n,), NaN where unknown."""
    then = earlier.view
    return static_sky.point_snr_before(
        then.residual_adu, then.mask, then.background.sigma_adu, then.background.tile_px, earlier.transform, row, col, psf_sigma_px
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkingImages:
    """image, smooth : int8, sigma/16; blocked : uint8 mask; level : mesh of what the background left over, sigma/16."""

    image: NDArray[np.int8]
    smooth: NDArray[np.int8]
    blocked: NDArray[np.uint8]
    level: NDArray[np.float32]
    binned: NDArray[np.int16]


def remove_stars_alone(view: DetectorView, image: NDArray[np.int8], blocked: NDArray[np.uint8], halo_px: float) -> None:
    """Mask the listed stars of a frame without a predecessor, in place; entries that are pieces of trails stay."""
    stars, psf_sigma_px = view.stars, view.psf_sigma_px
    no_level = np.zeros((1, 1), np.float32)
    smooth = whiten.smooth(image, no_level, max(image.shape), whiten.odd_taps(psf_sigma_px), POINT_CLIP_SIGMA)
    pieces = star_mask.trail_pieces(
        view.residual_adu, smooth, view.background.sigma_adu, view.background.tile_px, stars.row, stars.col, stars.snr, psf_sigma_px
    )
    radii = star_mask.mask_radii_px(stars.snr[~pieces], psf_sigma_px, halo_px)
    whiten.blank_discs(image, blocked, stars.row[~pieces], stars.col[~pieces], radii)


def remove_static_stars(
    view: DetectorView, earlier: static_sky.EarlierFrame, image: NDArray[np.int8], blocked: NDArray[np.uint8], halo_px: float
) -> None:
    """Mask bright stars and subtract faint ones that the earlier frame shows too, listed or not; in place.

    List entries that were not there are pieces of trails, movers or particle hits and stay in the image.
    """
    stars, psf_sigma_px = view.stars, view.psf_sigma_px
    before = snr_before(earlier, stars.row, stars.col, psf_sigma_px)
    # unknown (masked or outside then): a star; else a star of this brightness is almost never fainter than a third of it
    static = ~(before < np.maximum(1.5, 0.33 * stars.snr))
    faint = static & (stars.snr < SUBTRACT_SNR) & (before < 1.5 * SUBTRACT_SNR)
    bright = static & ~faint
    radii = star_mask.mask_radii_px(stars.snr[bright], psf_sigma_px, halo_px)
    whiten.blank_discs(image, blocked, stars.row[bright], stars.col[bright], radii)
    static_sky.subtract_stars(image, blocked, stars.row[faint], stars.col[faint], before[faint], psf_sigma_px)
    then, taps, no_level = earlier.view, whiten.odd_taps(psf_sigma_px), np.zeros((1, 1), np.float32)
    image_then = whiten.quantise(then.residual_adu, then.mask, then.background.sigma_adu, then.background.tile_px)
    smooth_then = whiten.smooth(image_then, no_level, max(image.shape), taps, POINT_CLIP_SIGMA)
    smooth_now = whiten.smooth(image, no_level, max(image.shape), taps, POINT_CLIP_SIGMA)
    places = np.empty((MAX_CANDIDATES * 4, 3))
    n = static_sky.faint_static_stars(smooth_now, smooth_then, earlier.transform, STATIC_EACH, STATIC_BOTH, TILE_PX, places)
    static_sky.subtract_stars(image, blocked, places[:n, 0], places[:n, 1], places[:n, 2], psf_sigma_px)


def working_images(
    view: DetectorView, earlier: static_sky.EarlierFrame | None, *, clip_sigma: float, halo_px: float
) -> WorkingImages:
    """Noise-normalised, star-free and PSF-smoothed images of a view."""
    image = whiten.quantise(view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px)
    blocked = (view.mask != 0).astype(np.uint8)
    if earlier is not None:
        remove_static_stars(view, earlier, image, blocked, halo_px)
    elif len(view.stars):
        remove_stars_alone(view, image, blocked, halo_px)
    level = whiten.local_level(image, blocked, TILE_PX)
    smooth = whiten.smooth(image, level, TILE_PX, whiten.odd_taps(view.psf_sigma_px), POINT_CLIP_SIGMA)
    binned = whiten.smooth_binned(image, level, TILE_PX, whiten.even_taps(view.psf_sigma_px), clip_sigma)
    return WorkingImages(image=image, smooth=smooth, blocked=blocked, level=level, binned=binned)


def stood_still(
    detection: Detection, view: DetectorView, earlier: static_sky.EarlierFrame, images: WorkingImages
) -> bool:
    """Whether the earlier frame shows the same segment, at the same place of the sky or of the sensor."""
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    then = earlier.view
    for transform in (earlier.transform, static_sky.IDENTITY):
        before = static_sky.segment_snr_before(
            then.residual_adu, then.mask, then.background.sigma_adu, then.background.tile_px, transform, images.blocked, FOUND_BIT,
            images.level, TILE_PX, ends, view.psf_sigma_px,
        )
        # a long segment gathers unlisted stars in the earlier frame, where none were removed
        if before > (0.45 if detection.length_px < 150.0 else 0.8) * detection.snr:
            return True
    return False


@dataclass(frozen=True, kw_only=True)
class LineIntegralDetector:
    """Detects segments whose matched-filter S/N exceeds `n_sigma`, whatever their length, angle and position."""

    n_sigma: float = field(default=7.0, metadata={"doc": "matched-filter S/N of a detection", "min": 4.0, "max": 100.0})
    coarse_sigma: float = field(default=4.5, metadata={"doc": "S/N on the coarse lattice worth refining", "min": 3.5, "max": 20.0})
    clip_sigma: float = field(default=3.0, metadata={"doc": "clip of the PSF-smoothed image", "min": 2.0, "max": 7.0})
    halo_px: float = field(default=1.0, metadata={"doc": "star mask growth per sqrt(S/N / 100)", "min": 0.0, "max": 20.0})
    min_length_px: float = field(default=10.0, metadata={"doc": "least length of a trail", "min": 4.0, "max": 1000.0})
    max_detections: int = field(default=200, metadata={"doc": "most detections of a frame", "min": 1, "max": 10000})
    reach_px: float = field(default=300.0, metadata={"doc": "largest shift of stars between frames", "min": 0.0, "max": 5000.0})

    @property
    def history_frames(self) -> int:
        """The preceding frame tells stars from movers."""
        return 1

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        if min(view.residual_adu.shape) < 16:
            return ()
        earlier = static_sky.earlier_frame(view, self.reach_px)
        images = working_images(view, earlier, clip_sigma=self.clip_sigma, halo_px=self.halo_px)
        noise = half_resolution_noise(images.binned, whiten.even_taps(view.psf_sigma_px), images.blocked)
        candidates = coarse_segments(images.binned, noise, self.coarse_sigma, MIN_ROWS, MAX_CANDIDATES)
        table = resolve(
            images.image, images.smooth, images.blocked, images.level, candidates, view.psf_sigma_px, self.n_sigma,
            self.n_sigma - 1.3, self.min_length_px, self.max_detections,
        )
        best_first = table[np.argsort(-table[:, 6], kind="stable")]
        found = [to_detection(row, view.residual_adu.shape) for row in best_first]
        if earlier is not None:
            found = [d for d in found if not stood_still(d, view, earlier, images)]
        return tuple(found)
