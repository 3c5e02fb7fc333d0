"""Second measurement of the sky, without the stars: level, noise, and offsets of single rows and columns.

Wings of listed stars below the clipping threshold raise a clipped mean by about 0.02 sigma. This does not matter for one pixel,
but a trail of 1,000 px sums it to one sigma of its matched-filter S/N. The star list allows their pixels to be left out.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image.background import LEAST_SAMPLES, continued, fill_gaps, neighbourhoods
from onboard.image.calibrate import LINE_LIMIT_SIGMA, LineSums, between_nodes, expand_nodes
from onboard.image.fine_sky import bent_tiles, continued_on_parabolas, fine_nodes, structured_tiles
from onboard.image.least_noise import with_least_noise
from sboc_e2e.icd.signals import BackgroundModel, StarList

ROW_STEP = 8
"""Every n-th row is used."""

FAINT_SIGMA = 0.03
"""Stars are cut out to the radius where their light falls to this share of the noise."""

CLIP_SIGMA = 4.0  # values beyond do not count in the moments of a tile
MOST_STAR_RADIUS_PX = 64.0  # bounds the time of wide, bright blurs; with a PSF of 1 px a star of S/N 1e6 has 6 px
LINE_NEIGHBOURS = 65  # of the running median, odd: a tile of the mesh, which follows nothing shorter than two
LINE_CLIP = 4.0  # largest offset over the scatter of offsets; what is beyond is a trail along the line
LEAST_LINES = 32  # fewer say nothing of the scatter. Chosen, not measured
SLOW_OVER_FAST = 4.0  # a quarter of the scatter beyond pixel noise takes the whole slow part out. Chosen, not measured
CLIPPED_RESPONSE = 1.0 - 2.0 * LINE_LIMIT_SIGMA * math.exp(-0.5 * LINE_LIMIT_SIGMA**2) / (
    math.sqrt(2.0 * math.pi) * math.erf(LINE_LIMIT_SIGMA / math.sqrt(2.0))
)
"""Change of the mean of normal values within +-`LINE_LIMIT_SIGMA` with a small offset of all of them, and the variance of these
values over that of all: 0.911."""


@njit(cache=True)
def mark_stars(
    row: NDArray[np.float64], col: NDArray[np.float64], reach: NDArray[np.float64], row_step: int, out: NDArray[np.uint8]
) -> None:
    """Set 1 in out (n, cols), whose line k is row ``k * row_step``, within `reach` px of each star."""
    lines, cols = out.shape
    for n in range(row.size):
        first = max(0, math.ceil((row[n] - reach[n]) / row_step))
        last = min(lines - 1, math.floor((row[n] + reach[n]) / row_step))
        for line in range(first, last + 1):
            away = line * row_step - row[n]
            half = math.sqrt(max(reach[n] * reach[n] - away * away, 0.0))
            for k in range(max(0, math.ceil(col[n] - half)), min(cols - 1, math.floor(col[n] + half)) + 1):
                out[line, k] = 1


@njit(cache=True, fastmath={"contract", "nsz"})
def _add_usable(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    marked: NDArray[np.uint8],
    limit: NDArray[np.float32],
    number: NDArray[np.float32],
    total: NDArray[np.float32],
    squares: NDArray[np.float32],
) -> None:
    """Add a row's unmarked, unmasked values within +-limit to sums of columns; a loop of vector instructions."""
    for col in range(residual.size):
        value = residual[col]
        good = (mask[col] | marked[col]) == 0 and abs(value) < limit[col]
        kept = value if good else np.float32(0.0)
        number[col] += np.float32(1.0) if good else np.float32(0.0)
        total[col] += kept
        squares[col] += kept * kept


@njit(cache=True)
def star_free_moments(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    marked: NDArray[np.uint8],
    row_step: int,
    tile_px: int,
    sigma_nodes: NDArray[np.float32],
    mean: NDArray[np.float32],
    deviation: NDArray[np.float32],
) -> None:
    """Mean and standard deviation of unmarked, unmasked values of each tile within 4 sigma; NaN where too few."""
    rows, cols = residual.shape
    sums, limit = np.empty((3, cols), np.float32), np.empty(cols, np.float32)
    for i in range(mean.shape[0]):
        for col in range(cols):
            limit[col] = np.float32(CLIP_SIGMA) * sigma_nodes[i, col // tile_px]
        sums[:] = 0.0
        for line in range(-(-i * tile_px // row_step), marked.shape[0]):
            row = line * row_step
            if row >= min((i + 1) * tile_px, rows):
                break
            _add_usable(residual[row], mask[row], marked[line], limit, sums[0], sums[1], sums[2])
        for j in range(mean.shape[1]):
            number, total, squares = 0.0, 0.0, 0.0
            for col in range(j * tile_px, min((j + 1) * tile_px, cols)):
                number, total, squares = number + sums[0, col], total + sums[1, col], squares + sums[2, col]
            mean[i, j], deviation[i, j] = np.nan, np.nan
            if number >= LEAST_SAMPLES:
                mean[i, j] = total / number
                deviation[i, j] = math.sqrt(max(squares / number - (total / number) ** 2, 0.0))


@njit(cache=True)
def running_median(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Median of the `width` (odd) values about each; the end values are mirrored beyond the ends."""
    n, half = values.size, width // 2
    out = np.empty(n)
    window = np.empty(width)
    for k in range(-half, half + 1):
        window[k + half] = values[_mirrored(k, n)]
    window.sort()
    for k in range(n):
        out[k] = window[half]
        leaving, entering = values[_mirrored(k - half, n)], values[_mirrored(k + half + 1, n)]
        place = np.searchsorted(window, leaving)
        while place + 1 < width and window[place + 1] < entering:
            window[place] = window[place + 1]
            place += 1
        while place > 0 and window[place - 1] > entering:
            window[place] = window[place - 1]
            place -= 1
        window[place] = entering
    return out


@njit(cache=True)
def _mirrored(k: int, n: int) -> int:
    """Index of a value beyond the ends of an array of n: d c b a | a b c d | d c b a."""
    k = k % (2 * n)
    return k if k < n else 2 * n - 1 - k


def line_offsets(sums: NDArray[np.float32], pixels: int, sigma_adu: float) -> NDArray[np.float32]:
    """Offsets that the readout gave to whole rows (or whole columns), ADU.

    sums : (2, lines) number and sum of each line's usable values (`onboard.image.calibrate.LineSums`), of `pixels` each.
    An offset of a tenth of the noise makes an edge-to-edge trail of S/N 6 out of one line of 4,096 px. Offsets are shrunk by
    the share of their scatter about neighbouring lines that pixel noise explains, and limited to `LINE_CLIP` of it, so that a
    readout without such noise changes nothing and a bright trail along a line is hardly touched. Where there is such noise, its
    slow part (the spectrum of amplifiers is 1/f) is taken out as well: the mesh follows nothing shorter than two tiles.
    """
    lines, number = sums.shape[1], sums[0].astype(np.float64)
    full = number > 0.25 * pixels
    if np.count_nonzero(full) < LEAST_LINES:
        return np.zeros(lines, dtype=np.float32)
    mean = sums[1] / np.maximum(number, 1.0) / CLIPPED_RESPONSE
    offset = np.where(full, mean - np.median(mean[full]), 0.0)
    apart = offset - running_median(offset, LINE_NEIGHBOURS)
    scatter2 = (1.4826 * float(np.median(np.abs(apart[full])))) ** 2
    noise2 = sigma_adu**2 / (float(np.median(number[full])) * CLIPPED_RESPONSE)
    share = max(scatter2 - 1.3 * noise2, 0.0) / max(scatter2, 1e-30)
    reach = LINE_CLIP * math.sqrt(scatter2)
    # many lines tell the slow part, so it needs no shrinking once the share says that there is such noise
    slow_share = min(1.0, SLOW_OVER_FAST * share)
    return (slow_share * (offset - apart) + share * np.clip(apart, -reach, reach)).astype(np.float32)


@njit(cache=True)
def _shift_row(residual: NDArray[np.float32], mask: NDArray[np.uint8], shift: NDArray[np.float32]) -> None:
    """Take `shift` away from usable pixels."""
    for col in range(residual.size):
        residual[col] -= shift[col] if mask[col] == 0 else np.float32(0.0)


@njit(cache=True)
def shift_level(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    nodes: NDArray[np.float32],
    tile_px: int,
    row_offset: NDArray[np.float32],
    col_offset: NDArray[np.float32],
) -> None:
    """Take an interpolated mesh and an offset of each row and column away from the image in place; masked pixels keep their 0.

    nodes : with one beyond each edge.
    """
    rows, cols = residual.shape
    upper, lower = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    shift = np.empty(cols, dtype=np.float32)
    held = -1
    for row in range(rows):
        above, place = between_nodes(row, nodes.shape[0], tile_px, rows)
        if above != held:
            expand_nodes(nodes[above], tile_px, upper)
            expand_nodes(nodes[above + 1], tile_px, lower)
            held = above
        share = np.float32(place)
        for col in range(cols):
            shift[col] = upper[col] + share * (lower[col] - upper[col]) + row_offset[row] + col_offset[col]
        _shift_row(residual[row], mask[row], shift)


def tile_means(line: NDArray[np.float32], tile_px: int) -> NDArray[np.float32]:
    """Means of a line of values over tiles; the last one may be shorter."""
    first = np.arange(0, line.size, tile_px)
    return np.asarray(np.add.reduceat(line, first) / np.diff(np.append(first, line.size)), dtype=np.float32)


def star_reach_px(stars: StarList, sigma_e: float, psf_sigma_px: float) -> NDArray[np.float64]:
    """Distance at which a Gaussian star's light falls to `FAINT_SIGMA` of the noise; listed positions are exact enough."""
    variance = psf_sigma_px**2 + 1.0 / 12.0
    peak = stars.flux_e.astype(np.float64) / (2.0 * math.pi * variance)
    ratio = np.maximum(peak / max(FAINT_SIGMA * sigma_e, 1e-9), 1.0)
    return np.minimum(np.sqrt(2.0 * variance * np.log(ratio)) + 0.5, MOST_STAR_RADIUS_PX)


def _take_out_structure(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    stars: StarList,
    reach: NDArray[np.float64],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    structured: NDArray[np.bool_],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bring structured tiles of the image to a level on tiles of half the size, in place; the change of the mesh, and the noise
    within such tiles, NaN where too few pixels tell: within whole tiles the structure passes for noise.
    """
    half = tile_px // 2
    shape = tuple(-(-n // half) for n in residual.shape)
    marked = np.zeros(residual.shape, dtype=np.uint8)
    mark_stars(stars.row, stars.col, reach, 1, marked)
    half_sigma = np.repeat(np.repeat(sigma_adu, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]]
    half_structured = np.repeat(np.repeat(structured, 2, axis=0), 2, axis=1)[: shape[0], : shape[1]]
    mean, deviation = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    star_free_moments(residual, mask, marked, 1, half, half_sigma, mean, deviation)
    nodes = fine_nodes(mean, half_sigma / np.float32(half), half_structured)
    none = [np.zeros(n, dtype=np.float32) for n in residual.shape]
    shift_level(residual, mask, continued_on_parabolas(nodes, float(np.median(sigma_adu))), half, *none)
    return _of_whole_tiles(nodes), np.sqrt(_of_whole_tiles(deviation**2))


def _of_whole_tiles(halves: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means over 2 x 2 tiles of half the size; those beyond the edge are the last ones again."""
    even = np.pad(halves, [(0, n % 2) for n in halves.shape], mode="edge")
    return np.asarray(even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).mean(axis=(1, 3)), dtype=np.float32)


def without_stars(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sums: LineSums,
    stars: StarList,
    background: BackgroundModel,
    *,
    gain_e_adu: float,
    psf_sigma_px: float,
    quantum_adu: float = 1.0,
) -> BackgroundModel:
    """The background measured beside the stars; `residual` is brought to its level in place.

    sums : of `residual` before the change. quantum_adu : of the counts.
    """
    tile_px, shape = background.tile_px, background.level_adu.shape
    row_step = ROW_STEP if tile_px >= 4 * ROW_STEP else 1
    marked = np.zeros((-(-residual.shape[0] // row_step), residual.shape[1]), dtype=np.uint8)
    sigma_e = float(np.median(background.sigma_adu)) * gain_e_adu
    mark_stars(stars.row, stars.col, star_reach_px(stars, sigma_e, psf_sigma_px), row_step, marked)
    mean, deviation = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    star_free_moments(residual, mask, marked, row_step, tile_px, background.sigma_adu, mean, deviation)
    sigma = np.where(np.isfinite(deviation) & (deviation > 0.0), deviation, background.sigma_adu).astype(np.float32)
    sigma = with_least_noise(sigma, quantum_adu)
    noise = float(np.median(sigma))
    rows, cols = residual.shape
    row_offset, col_offset = line_offsets(sums.rows, cols, noise), line_offsets(sums.cols, rows, noise)
    mean -= tile_means(row_offset, tile_px)[:, None] + tile_means(col_offset, tile_px)
    shift = neighbourhoods(fill_gaps(mean, 0.0)).mean(axis=0)
    shift_level(residual, mask, continued(shift, noise), tile_px, row_offset, col_offset)
    # a second look at what the mesh left over: the first one's means are relative to the level before
    star_free_moments(residual, mask, marked, row_step, tile_px, background.sigma_adu, mean, deviation)
    structured = structured_tiles(mean, sigma, tile_px * tile_px // row_step) | bent_tiles(background.level_adu, sigma)
    if structured.any() and tile_px % 2 == 0:
        # beyond the outer nodes a straight line leaves three times as much as between nodes, and their means do not show it
        structured[[0, -1]] = structured[:, [0, -1]] = True
        reach = star_reach_px(stars, sigma_e, psf_sigma_px)
        change, within = _take_out_structure(residual, mask, stars, reach, background.sigma_adu, tile_px, structured)
        shift, sigma = shift + change, with_least_noise(np.where(structured & (within > 0.0), within, sigma), quantum_adu)
    return BackgroundModel(
        tile_px=tile_px,
        level_adu=background.level_adu + shift,
        sigma_adu=neighbourhoods(sigma).mean(axis=0),
    )
