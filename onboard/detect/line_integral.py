"""`onboard.detector: line_integral`: matched-filter line integrals over all positions, angles and lengths.

noise-normalise, mask stars -> smooth by the PSF, bin 2 x 2 -> sums over dyadic segments of all lines -> candidates above a
low threshold -> continuous maximum of the matched filter at full resolution -> threshold, uniformity, one detection a streak.
"""

import math
from dataclasses import dataclass, field

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect import dyadic, refine, whiten
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView, StarList

TILE_PX = 64


def star_radii_px(snr: NDArray[np.float32], psf_sigma_px: float, halo_px: float) -> NDArray[np.float64]:
    """Radius at which a Gaussian star of matched-filter S/N `snr` falls to 0.4 sigma of a pixel, plus a halo ~ sqrt(snr)."""
    peak = np.maximum(np.asarray(snr, np.float64), 1.0) / (2.0 * math.sqrt(math.pi) * psf_sigma_px)
    core = psf_sigma_px * np.sqrt(2.0 * np.log(np.maximum(peak / 0.4, 1.65)))
    return core + 0.7 + halo_px * np.maximum(0.0, np.sqrt(np.asarray(snr, np.float64) / 100.0) - 1.0)


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
def resolve(
    image: NDArray[np.int8], smooth: NDArray[np.int8], blocked: NDArray[np.uint8], candidates: NDArray[np.float64],
    psf_sigma_px: float, n_sigma: float, first_sigma: float, max_found: int,
) -> NDArray[np.float64]:
    """Refine candidates best first; each accepted segment is taken out of the images before the next one is looked at.

    Returns (n, 8): axis, major0, minor0, major1, minor1, sagitta along minor (px), S/N, quarters chi-square.
    """
    image_t, smooth_t, blocked_t = image.T, smooth.T, blocked.T
    found = np.empty((max_found, 8))
    n_found = 0
    sums = np.empty((refine.PIECES, refine.OFFSETS), np.int32)
    counts = np.empty((refine.PIECES, refine.OFFSETS), np.int32)
    signal = np.empty(max(image.shape) + 1)
    weight = np.empty(max(image.shape) + 1)
    segment = np.empty(5)
    for c in range(candidates.shape[0]):
        if n_found == max_found:
            break
        if candidates[c, 0] == 0.0:
            snr, chi2 = refine.resolve_one(
                image, smooth, blocked, candidates[c, 1:5], psf_sigma_px, n_sigma, first_sigma, segment, sums, counts, signal, weight
            )
        else:
            snr, chi2 = refine.resolve_one(
                image_t, smooth_t, blocked_t, candidates[c, 1:5], psf_sigma_px, n_sigma, first_sigma, segment, sums, counts,
                signal, weight,
            )
        if snr < n_sigma:
            continue
        found[n_found, 0] = candidates[c, 0]
        found[n_found, 1:6] = segment
        found[n_found, 6] = snr
        found[n_found, 7] = chi2
        n_found += 1
        width = psf_sigma_px * 3.0 + 1.0
        if candidates[c, 0] == 0.0:
            refine.blank_path(image, smooth, blocked, segment, width)
        else:
            refine.blank_path(image_t, smooth_t, blocked_t, segment, width)
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


def find_segments(
    residual_adu: NDArray[np.float32], mask: NDArray[np.uint8], sigma_adu: NDArray[np.float32], tile_px: int, stars: StarList,
    *, psf_sigma_px: float, n_sigma: float, coarse_sigma: float, clip_sigma: float, halo_px: float, max_detections: int,
) -> NDArray[np.float64]:
    """Segments of one frame as rows of `resolve`."""
    image = whiten.quantise(residual_adu, mask, sigma_adu, tile_px)
    blocked = (mask != 0).astype(np.uint8)
    radii = star_radii_px(stars.snr, psf_sigma_px, halo_px)
    whiten.blank_discs(image, blocked, stars.row, stars.col, radii)
    level = whiten.local_level(image, blocked, TILE_PX)
    smooth = whiten.smooth(image, level, TILE_PX, whiten.odd_taps(psf_sigma_px), clip_sigma)
    taps = whiten.even_taps(psf_sigma_px)
    binned = whiten.smooth_binned(image, level, TILE_PX, taps, clip_sigma)
    noise = half_resolution_noise(binned, taps, blocked)
    candidates = coarse_segments(binned, noise, coarse_sigma, 8, 100_000)
    return resolve(image, smooth, blocked, candidates, psf_sigma_px, n_sigma, coarse_sigma + 0.5, max_detections)


@dataclass(frozen=True, kw_only=True)
class LineIntegralDetector:
    """Detects segments whose matched-filter S/N exceeds `n_sigma`, whatever their length, angle and position."""

    n_sigma: float = field(default=7.0, metadata={"doc": "matched-filter S/N of a detection", "min": 4.0, "max": 100.0})
    coarse_sigma: float = field(default=4.3, metadata={"doc": "S/N on the coarse lattice worth refining", "min": 3.5, "max": 20.0})
    clip_sigma: float = field(default=4.0, metadata={"doc": "clip of the PSF-smoothed image", "min": 2.0, "max": 7.0})
    halo_px: float = field(default=1.0, metadata={"doc": "star mask growth per sqrt(S/N / 100)", "min": 0.0, "max": 20.0})
    max_detections: int = field(default=200, metadata={"doc": "most detections of a frame", "min": 1, "max": 10000})
    history_frames: int = field(default=0, metadata={"doc": "earlier views wanted", "min": 0, "max": 1})

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N."""
        table = find_segments(
            view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px, view.stars,
            psf_sigma_px=view.psf_sigma_px, n_sigma=self.n_sigma, coarse_sigma=self.coarse_sigma, clip_sigma=self.clip_sigma,
            halo_px=self.halo_px, max_detections=self.max_detections,
        )
        uniform = table[table[:, 7] < 16.0 + (0.3 * table[:, 6]) ** 2]
        uniform = uniform[np.argsort(-uniform[:, 6], kind="stable")]
        return tuple(to_detection(row, view.residual_adu.shape) for row in uniform)
