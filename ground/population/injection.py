"""Efficiency of detection: synthetic streaks injected into the pixels that came down, and searched by a plain matched filter.

Ground does not know the on-board detector, but it knows the sent regions. Every region carries the S/N of its detection, and none
is below the threshold. The filter here uses that threshold on whole frames with their real stars, noise, columns and hits.
Without whole frames it uses noise as the background mesh describes it, with the share of pixels that was masked on board.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, zoom
from scipy.special import ndtr

from ground.ingest.assembly import is_of_track_only
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup

Array = NDArray[np.float64]

SNR_GRID: Final = (3.0, 4.0, 5.0, 6.0, 6.5, 7.0, 7.5, 8.0, 9.0, 10.0, 12.0, 15.0, 20.0, 40.0)
"""Densest about the thresholds of detectors (6 to 8), where the share found rises from 0 to 1."""
LENGTHS_PX: Final = (10.0, 30.0, 100.0, 300.0)
"""Half-decade steps from short trails to those of a good part of a frame."""
TRIALS: Final = 24
"""Injections at each S/N and length."""

MASK_SIGMAS: Final = 5.0
"""Pixels this bright in the frame itself are stars, hits and columns, which the detector leaves out."""

STAR_SIGMAS: Final = 0.3
"""Stars of the list hide pixels where they are brighter than this share of the noise. Chosen, not measured."""
LEAST_RADIUS_PX: Final = 1.5
"""Least radius of such a star: the pixels next to it."""
DEFAULT_WIDTH_PX: Final = 0.9
"""PSF sigma of a frame that states none: a critically sampled camera. It only sets the radius of masks."""
PIXEL_SIGMA_PX: Final = 12.0**-0.5
"""Second moment of a unit square, as a width."""

SHIFTS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Displacements across the trail in PSF widths at which the filter looks: the best of them counts, as in a search."""

REACH_WIDTHS: Final = 4.0
"""Pixels farther away than this have less than exp(-8) = 3e-4 of the peak."""
MOST_FRAMES: Final = 2
"""Whole frames used, the first and the last: a limit of memory."""
DEFAULT_THRESHOLD: Final = 7.2
"""Threshold of the default detector, for a downlink without a region from which it could be read."""

NOT_TELLING: Final = StreakFlag.COSMIC_LIKE | StreakFlag.SPIKE_LIKE | StreakFlag.STATIC | StreakFlag.POINT_LIKE


@dataclass(frozen=True, kw_only=True, eq=False)
class Image:
    """Pixels to inject into: electrons above the sky, noise of each, and which count. All (rows, cols)."""

    value_e: Array
    sigma_e: Array
    usable: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Efficiency:
    """Share found: found and tried (len(SNR_GRID), len(lengths)). control : S/N of the filter where nothing was injected (m,).

    images : "whole frames" or "background mesh and noise". threshold : S/N, and from how many detections it was read.
    """

    found: NDArray[np.int64]
    tried: NDArray[np.int64]
    lengths_px: tuple[float, ...]
    control: Array
    images: str
    n_images: int
    threshold: float
    n_threshold: int

    def share(self, snr: Array, length_px: Array) -> Array:
        """Probability of being found, bilinear in S/N and in the logarithm of length; 0 below the grid, constant above."""
        table = (self.found + 0.5) / (self.tried + 1.0)
        table = np.maximum.accumulate(table, axis=0)
        lengths = np.log(self.lengths_px)
        place = np.clip(np.interp(np.log(np.maximum(length_px, 1.0)), lengths, np.arange(len(lengths))), 0, len(lengths) - 1)
        low = np.minimum(place.astype(int), max(len(lengths) - 2, 0))
        high = np.minimum(low + 1, len(lengths) - 1)
        along = np.interp(snr, SNR_GRID, np.arange(len(SNR_GRID)))
        i = np.minimum(along.astype(int), len(SNR_GRID) - 2)
        rest, across = along - i, place - low

        def at(column: NDArray[np.int64]) -> Array:
            return np.asarray(table[i, column] * (1.0 - rest) + table[i + 1, column] * rest)

        return np.where(np.asarray(snr) < SNR_GRID[0], 0.0, at(low) * (1.0 - across) + at(high) * across)


def threshold_of(frames: Sequence[DownlinkFrame]) -> tuple[float, int]:
    """The detector's threshold estimated from its detections, and the number of detections used.

    If n detections have S/N above T with a density that falls like S^-3, the least lies T / (2 n) above T. Detections that passed
    a storm's limit or another channel (hits, spikes, points) are not used. Nor are members that only a track over several frames
    found: their own S/N may be far below T.
    """
    snr = [
        group.detection.snr
        for frame in frames
        if not frame.flags & FrameFlag.STORM
        for group in frame.rois
        if not group.detection.flags & NOT_TELLING and _has_own_detection(group)
    ]
    if not snr:
        return DEFAULT_THRESHOLD, 0
    return min(snr) / (1.0 + 0.5 / len(snr)), len(snr)


def _has_own_detection(group: RoiGroup) -> bool:
    """Whether a region's detection is that of its own frame. Where strips of a track's member are lost it may be the track's."""
    return not is_of_track_only(group.roi_id) and (group.track < 0 or len(group.strips) >= group.n_strips)


def images_of(frames: Sequence[DownlinkFrame], gain_e_adu: float) -> tuple[list[Image], str]:
    """Whole frames that came down, or one frame of noise by a mesh, or none. gain : where a header has none."""
    numbers = [k for k, frame in enumerate(frames) if frame.whole_frame is not None]
    if numbers:
        numbers = [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, MOST_FRAMES).round().astype(int))]
    whole = [image for image in (_from_pixels(frames[k], gain_e_adu) for k in numbers) if image is not None]
    if whole:
        return whole, "whole frames"
    for frame in frames:
        image = _from_mesh(frame, gain_e_adu)
        if image is not None:
            return [image], "background mesh and noise"
    return [], "none"


def _from_pixels(frame: DownlinkFrame, gain_e_adu: float) -> Image | None:
    """The frame's own pixels less the mesh of the sky; None without either."""
    if frame.whole_frame is None or frame.background is None:
        return None
    gain = frame.header.gain_e_adu or gain_e_adu
    level, sigma = _maps(frame.background, frame.header.rows, frame.header.cols)
    value = (np.asarray(frame.whole_frame, np.float64) * frame.adu_scale + frame.adu_offset - level) * gain
    sigma = np.maximum(sigma * gain, 1e-3)
    # The mesh may be off by a fraction of the noise. The median of the remainder is the level.
    value -= float(np.nanmedian(value))
    bright = binary_dilation(~(np.abs(value) < MASK_SIGMAS * sigma), iterations=1) | _under_stars(frame)
    return Image(value_e=np.where(bright, 0.0, value), sigma_e=sigma, usable=~bright)


def _under_stars(frame: DownlinkFrame) -> NDArray[np.bool_]:
    """Pixels (rows, cols) in which a star of the list is brighter than `STAR_SIGMAS` of the noise, as a Gaussian."""
    shape = frame.header.rows, frame.header.cols
    hidden = np.zeros(shape, dtype=bool)
    width = math.hypot(frame.psf_sigma_px or DEFAULT_WIDTH_PX, PIXEL_SIGMA_PX)
    for stars in (frame.stars, frame.remembered):
        for row, col, snr in zip(stars.row, stars.col, stars.snr, strict=True):
            # a matched filter's S/N is sqrt(pi) widths times that of the peak pixel
            peak = max(float(snr), 1.0) / (math.sqrt(math.pi) * width)
            radius = max(width * math.sqrt(2.0 * math.log(max(peak / STAR_SIGMAS, 1.0))), LEAST_RADIUS_PX)
            r0, r1 = max(math.floor(row - radius), 0), min(math.ceil(row + radius) + 1, shape[0])
            c0, c1 = max(math.floor(col - radius), 0), min(math.ceil(col + radius) + 1, shape[1])
            r, c = np.ogrid[r0:r1, c0:c1]
            hidden[r0:r1, c0:c1] |= (r - row) ** 2 + (c - col) ** 2 <= radius**2
    return hidden


def _from_mesh(frame: DownlinkFrame, gain_e_adu: float) -> Image | None:
    """Noise as strong as the mesh says, with as many unusable pixels as the housekeeping says; None without a mesh."""
    if frame.background is None:
        return None
    rows, cols = min(frame.header.rows, 1024), min(frame.header.cols, 1024)
    gain = frame.header.gain_e_adu or gain_e_adu
    sigma = np.full((rows, cols), max(float(np.nanmedian(frame.background.sigma_adu)) * gain, 1e-3))
    rng = np.random.default_rng(frame.header.frame)
    masked = 0.0 if frame.housekeeping is None else frame.housekeeping.n_masked / (frame.header.rows * frame.header.cols)
    return Image(value_e=rng.standard_normal((rows, cols)) * sigma, sigma_e=sigma, usable=rng.random((rows, cols)) >= masked)


def _maps(mesh: BackgroundModel, rows: int, cols: int) -> tuple[Array, Array]:
    """Level and noise of every pixel, bilinear between the middles of the mesh's tiles."""

    def spread(nodes: NDArray[np.float32]) -> Array:
        fine = zoom(np.pad(nodes.astype(np.float64), 1, mode="edge"), mesh.tile_px, order=1, mode="nearest", grid_mode=True)
        return np.asarray(fine[mesh.tile_px : mesh.tile_px + rows, mesh.tile_px : mesh.tile_px + cols])

    return spread(mesh.level_adu), spread(mesh.sigma_adu)


def measured_efficiency(
    images: Sequence[Image], kind: str, threshold: tuple[float, int], width_px: float, rng: np.random.Generator
) -> Efficiency:
    """Inject and look. width_px : sigma of the PSF, pixel included."""
    smallest = min(min(image.value_e.shape) for image in images)
    lengths = tuple(length for length in LENGTHS_PX if length < 0.6 * smallest) or (0.3 * smallest,)
    best = np.zeros((len(SNR_GRID), len(lengths), TRIALS))
    control = []
    noise = [float(np.median(image.sigma_e)) for image in images]
    for j, length in enumerate(lengths):
        for i, snr in enumerate(SNR_GRID):
            for trial in range(TRIALS):
                k = int(rng.integers(len(images)))
                best[i, j, trial], without = _look(images[k], snr, length, width_px, noise[k], rng)
                control.append(without)
    # The S/N of a detector is relative to the scatter between trails. Where faint stars crowd, this exceeds the noise of the
    # mesh.
    found = (best > threshold[0] * max(robust_sigma(np.array(control)), 1.0)).sum(axis=2)
    return Efficiency(
        found=found,
        tried=np.full_like(found, TRIALS),
        lengths_px=lengths,
        control=np.array(control),
        images=kind,
        n_images=len(images),
        threshold=threshold[0],
        n_threshold=threshold[1],
    )


def robust_sigma(values: Array) -> float:
    """Standard deviation of normal noise about zero from the median of its squares."""
    return math.sqrt(float(np.median(values**2)) / 0.4549)


def _look(image: Image, snr: float, length: float, width: float, noise_e: float, rng: np.random.Generator) -> tuple[float, float]:
    """S/N that the filter finds with a trail at a random place, and at the same place without; a trail lies inside the image."""
    rows, cols = image.value_e.shape
    angle = rng.uniform(0.0, math.pi)
    d_row, d_col = 0.5 * length * math.sin(angle), 0.5 * length * math.cos(angle)
    row = rng.uniform(abs(d_row), rows - 1 - abs(d_row))
    col = rng.uniform(abs(d_col), cols - 1 - abs(d_col))
    r, c, u, v = _near_line(row, col, angle, length, width, (rows, cols))
    value, sigma, usable = image.value_e[r, c], image.sigma_e[r, c], image.usable[r, c]
    lit = ndtr((u + 0.5 * length) / width) - ndtr((u - 0.5 * length) / width)
    unit = lit * np.exp(-0.5 * (v / width) ** 2)
    trail = snr * noise_e / math.sqrt(float(np.sum(unit**2))) * unit
    seen = value + trail + np.sqrt(trail) * rng.standard_normal(len(trail))
    weight = np.where(usable, sigma**-2, 0.0)
    best, empty = -np.inf, 0.0
    for shift in SHIFTS:
        template = lit * np.exp(-0.5 * (v / width - shift) ** 2)
        norm = math.sqrt(max(float(np.sum(template**2 * weight)), 1e-30))
        best = max(best, float(np.sum(template * weight * seen)) / norm)
        if shift == 0.0:
            empty = float(np.sum(template * weight * value)) / norm
    return best, empty


def _near_line(
    row: float, col: float, angle: float, length: float, width: float, shape: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:
    """Pixels within reach of a segment: rows, columns, and coordinates along and across it (px from its middle)."""
    sine, cosine = math.sin(angle), math.cos(angle)
    reach = REACH_WIDTHS * width + 1.0
    steep = abs(sine) > abs(cosine)
    major_extent = 0.5 * length * max(abs(sine), abs(cosine)) + reach
    slope = (cosine / sine) if steep else (sine / cosine)
    minor_half = reach * math.sqrt(1.0 + slope**2)
    middle, other = (row, col) if steep else (col, row)
    major = np.arange(math.floor(middle - major_extent), math.ceil(middle + major_extent) + 1)
    minor0 = np.floor(other + (major - middle) * slope - minor_half).astype(np.int64)
    offset = np.arange(int(2.0 * minor_half) + 2)
    minor = (minor0[:, None] + offset).ravel()
    major = np.repeat(major, len(offset))
    r, c = (major, minor) if steep else (minor, major)
    inside = (r >= 0) & (r < shape[0]) & (c >= 0) & (c < shape[1])
    r, c = r[inside].astype(np.int64), c[inside].astype(np.int64)
    return r, c, (c - col) * cosine + (r - row) * sine, (r - row) * cosine - (c - col) * sine
