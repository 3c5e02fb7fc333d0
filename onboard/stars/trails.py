"""Stars as trails, when the pointing follows something else or rolls: found and centred with the trail as template.

The motion of the stars (`star_motion`) gives the shape of each trail. Sums of the PSF-smoothed image along this shape have maxima
at the trails. The brightest trails are fitted. The centre of a trail is the position at mid-exposure, as for a point.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.stars.fits import BLENDED, DEFECT, EDGE, SATURATED, SATURATED_STAR
from onboard.stars.star_motion import longest_px
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import DetectorView, StarMotion

FIT_STEPS: Final = 8  # of Gauss-Newton, the first for the flux alone; four are usual
FIT_WORK: Final = 250.0  # per pixel of it ...
BOX_WORK: Final = 4.0  # ... per pixel around it ...
SUM_WORK: Final = 0.25
"""Operations of a trail's fit per pixel of it (four steps) and per pixel around it, and of a step of a sum along the trails."""

BLOCK_PX: Final = 128
"""Side of the parts of a frame that have one trail each when the frame turns."""

UNIT: Final = 16.0  # steps of the smoothed image in a sigma, as `detect.whiten.UNIT`
CLIP_SIGMA: Final = 7.5  # with the growth to 1,000 times it 100 px sum to 28,600, which 16 bits hold
GROWTH: Final = 0.2
"""Above `CLIP_SIGMA` the smoothed image grows as a logarithm, scaled by `GROWTH`. A bright point then lights up no more of a path
than its own width, and every trail is still brightest in its middle."""

LONGEST_PX: Final = 100.0
"""Longest trail whose sum is held by 16 bits."""

SHORT_PX: Final = 4.0
"""Shorter trails are stars as points; there are none of the others where the motion is so small."""

DARK_QUARTER: Final = 0.15
"""A path is a trail if each of its quarters has more than this share of the expected light ..."""

BRIGHT_SIGMA: Final = 3.0  # S/N of its pixels, below which noise hides what the ends have. Chosen, not measured
DARK_END: Final = 0.25  # the end of a trail has half of its light in its last pixel, noise aside. Chosen, not measured
LEAST_SHAPE_PX: Final = 12
"""... and its ends exceed the share `DARK_END` of its median. Ends are judged where the median exceeds `BRIGHT_SIGMA` and the
path has `LEAST_SHAPE_PX` pixels."""

POINT_SIGMA: Final = 5.0  # noise makes one pixel in 3.5 million so bright
POINT_PX: Final = 3  # 3.4 sigma of a PSF of 0.87 px, beyond which a point has no light
LEAST_BESIDE: Final = 2.0
"""A path with a pixel above `POINT_SIGMA` shows a point when the others, but for those within `POINT_PX` of it, add up to less
than `LEAST_BESIDE` sigma."""

CORE: Final = 1  # bit of its own width
AROUND: Final = 2  # bit of its light
ABOVE_SIDES: Final = 1.5
"""Bits of a map of trails: within the trail's own width, and as far as its light matters. There another trail must be
`ABOVE_SIDES` times as bright as what lies beside it."""

FULL_SIGMA: Final = 1e4
"""Saturated pixels, over the noise."""


class ResidualImage(NamedTuple):
    """residual : (rows, cols) ADU above the background; mask : `PixelFlag` bits; noise_adu : of a pixel without stars."""

    residual: NDArray[np.float32]
    mask: NDArray[np.uint8]
    noise_adu: float


@njit(cache=True)
def trail_model(drow: float, dcol: float, half_row: float, half_col: float, sigma: float) -> tuple[float, float, float]:
    """A trail of unit flux at (drow, dcol) from its centre, and minus its slopes along row and col of that offset.

    half_row, half_col : from centre to end. The Gaussian PSF is integrated along the trail (error functions).
    """
    half = math.hypot(half_row, half_col)
    unit_row, unit_col = (half_row / half, half_col / half) if half > 1e-9 else (1.0, 0.0)
    half = max(half, 1e-3)
    u, v = drow * unit_row + dcol * unit_col, -drow * unit_col + dcol * unit_row
    scale = 1.0 / (sigma * math.sqrt(2.0))
    across = math.exp(-(v * v) * scale * scale) / (sigma * math.sqrt(2.0 * math.pi))
    along = (math.erf((u + half) * scale) - math.erf((u - half) * scale)) / (4.0 * half)
    ends = math.exp(-(((u + half) * scale) ** 2)) - math.exp(-(((u - half) * scale) ** 2))
    slope_u = -across * ends / (2.0 * half * sigma * math.sqrt(2.0 * math.pi))
    slope_v = across * along * v / (sigma * sigma)
    return across * along, slope_u * unit_row - slope_v * unit_col, slope_u * unit_col + slope_v * unit_row


@njit(cache=True)
def fit_trails(
    frame: ResidualImage,
    peaks: NDArray[np.float32],
    half: NDArray[np.float64],
    psf_sigma_px: float,
    gain_e_adu: float,
    out: NDArray[np.float64],
    flags: NDArray[np.uint8],
) -> None:
    """Maximum-likelihood centre and flux of trails of known vector, Gauss-Newton.

    peaks : (n, >= 2) row, col. half : (n, 2) from centre to end.
    out : (n, 4) row, col, flux ADU, S/N. flags : `StarFlag` bits SATURATED, EDGE, BLENDED and DEFECT.
    """
    residual, mask, noise_adu = frame.residual, frame.mask, frame.noise_adu
    rows, cols = residual.shape
    for n in range(peaks.shape[0]):
        half_row, half_col = half[n, 0], half[n, 1]
        length = max(2.0 * math.hypot(half_row, half_col), 1e-6)
        reach_row = int(math.ceil(abs(half_row) + 3.5 * psf_sigma_px))  # noqa: RUF046 - numba's ceil is a float
        reach_col = int(math.ceil(abs(half_col) + 3.5 * psf_sigma_px))  # noqa: RUF046 - numba's ceil is a float
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        row, col, flux, squares = float(row0), float(col0), -1.0, 0.0
        flag = 0
        for step in range(FIT_STEPS):
            gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(row0 - reach_row, row0 + reach_row + 1):
                for j in range(col0 - reach_col, col0 + reach_col + 1):
                    if abs((i - row0) * half_col - (j - col0) * half_row) > 0.5 * length * (3.5 * psf_sigma_px + 1.0):
                        continue
                    if i < 0 or j < 0 or i >= rows or j >= cols:
                        flag |= EDGE
                        continue
                    if mask[i, j] != 0:
                        flag |= SATURATED_STAR if mask[i, j] & SATURATED else DEFECT
                        continue
                    t, tr, tc = trail_model(i - row, j - col, half_row, half_col, psf_sigma_px)
                    weight = 1.0 / (noise_adu * noise_adu + max(flux, 0.0) * t / gain_e_adu)
                    misfit = (residual[i, j] - max(flux, 0.0) * t) * weight
                    tr, tc = flux * tr, flux * tc
                    gf, gr, gc = gf + misfit * t, gr + misfit * tr, gc + misfit * tc
                    ff, fr, fc = ff + weight * t * t, fr + weight * t * tr, fc + weight * t * tc
                    rr, rc, cc = rr + weight * tr * tr, rc + weight * tr * tc, cc + weight * tc * tc
                    squares += t * t
            if ff <= 0.0:
                break
            if step == 0:  # the flux first: without it the position has no gradient
                flux = max(gf / ff, 0.1 * noise_adu)
                continue
            determinant = ff * (rr * cc - rc * rc) - fr * (fr * cc - rc * fc) + fc * (fr * rc - rr * fc)
            if determinant <= 1e-9 * ff * rr * cc:
                flag |= BLENDED
                break
            step_flux = ((rr * cc - rc * rc) * gf + (fc * rc - fr * cc) * gr + (fr * rc - fc * rr) * gc) / determinant
            step_row = ((fc * rc - fr * cc) * gf + (ff * cc - fc * fc) * gr + (fr * fc - ff * rc) * gc) / determinant
            step_col = ((fr * rc - fc * rr) * gf + (fr * fc - ff * rc) * gr + (ff * rr - fr * fr) * gc) / determinant
            row, col = row + min(max(step_row, -2.0), 2.0), col + min(max(step_col, -2.0), 2.0)
            flux = max(flux + step_flux, 0.2 * flux)
            if step_row * step_row + step_col * step_col < 1e-4:
                break
        if abs(row - row0) > reach_row or abs(col - col0) > reach_col:
            row, col, flag = float(row0), float(col0), flag | 4
        out[n, 0], out[n, 1], out[n, 2] = row, col, flux
        out[n, 3] = flux * math.sqrt(squares) / noise_adu
        flags[n] = flag


@njit(cache=True)
def _smoothed_rows(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma: NDArray[np.float32],
    tile_px: int,
    kernel: NDArray[np.float32],
    first: int,
    out: NDArray[np.int16],
    margin: int,
) -> None:
    """Rows first ... of the image over its noise, smoothed and compressed, in sigma/UNIT; zeros beyond the frame.

    kernel : centre and one side, of unit noise. out : (rows, cols + 2 margin).
    """
    rows, cols = residual.shape
    radius = kernel.size - 1
    ring = np.zeros((2 * radius + 1, cols), np.float32)
    line = np.zeros(cols + 2 * radius, np.float32)
    scale = np.zeros(cols, np.float32)
    out[:] = 0
    limit = np.float32(CLIP_SIGMA * UNIT)
    for k in range(-radius, out.shape[0] + radius):
        row = first + k
        slot = ring[row % (2 * radius + 1)]
        slot[:] = 0.0
        if 0 <= row < rows:
            nodes = sigma[min(row // tile_px, sigma.shape[0] - 1)]
            for col in range(cols):
                scale[col] = np.float32(UNIT) / max(nodes[min(col // tile_px, nodes.size - 1)], np.float32(1e-9))
            for col in range(cols):
                lit = residual[row, col] * scale[col]
                line[radius + col] = lit if mask[row, col] == 0 else np.float32(0.0)
            for col in range(cols):
                slot[col] = kernel[0] * line[radius + col]
            for m in range(1, radius + 1):
                for col in range(cols):
                    slot[col] += kernel[m] * (line[radius + col - m] + line[radius + col + m])
        at = k - radius
        if 0 <= at < out.shape[0] and 0 <= first + at < rows:
            line[:cols] = kernel[0] * ring[(first + at) % (2 * radius + 1)]
            for m in range(1, radius + 1):
                above, below = ring[(first + at - m) % (2 * radius + 1)], ring[(first + at + m) % (2 * radius + 1)]
                for col in range(cols):
                    line[col] += kernel[m] * (above[col] + below[col])
            for col in range(cols):
                out[at, margin + col] = np.int16(min(max(line[col], -limit), limit))
            for col in range(cols):
                if line[col] > limit:
                    out[at, margin + col] = np.int16(limit * (1.0 + GROWTH * math.log(min(line[col] / limit, 1e3))))
            line[:] = 0.0


@njit(cache=True)
def _add(total: NDArray[np.int16], values: NDArray[np.int16]) -> None:
    for k in range(total.size):
        total[k] += values[k]


@njit(cache=True)
def _collect(
    total: NDArray[np.int16],
    band: NDArray[np.int16],
    at: tuple[int, int],
    corner: tuple[int, int],
    path: NDArray[np.int32],
    least: float,
    unit: float,
    found: NDArray[np.float32],
    count: int,
) -> int:
    """Local maxima of the sums over a path, all of whose quarters are lit.

    total : with a rim of one pixel. at : row and column of total[0, 0] in the band, corner : in the frame.
    """
    n = path.shape[0]
    quarter = np.zeros(4)
    for i in range(1, total.shape[0] - 1):
        for j in range(1, total.shape[1] - 1):
            value = total[i, j]
            if value <= least or value < total[i - 1, j] or value < total[i, j - 1]:
                continue
            if value <= total[i + 1, j] or value <= total[i, j + 1]:
                continue
            if value < max(total[i - 1, j - 1], total[i - 1, j + 1]) or value <= max(total[i + 1, j - 1], total[i + 1, j + 1]):
                continue
            quarter[:] = 0.0
            for k in range(n):
                quarter[4 * k // n] += band[at[0] + i + path[k, 0], at[1] + j + path[k, 1]]
            quarter.sort()
            if quarter[0] < DARK_QUARTER * 0.25 * value:
                continue
            if count < found.shape[0]:
                found[count, 0], found[count, 1], found[count, 2] = corner[0] + i, corner[1] + j, value * unit
                count += 1
    return count


@njit(cache=True)
def trail_peaks(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma: NDArray[np.float32],
    tile_px: int,
    kernel: NDArray[np.float32],
    paths: NDArray[np.int32],
    steps: NDArray[np.int64],
    noise: NDArray[np.float64],
    block_cols: int,
    threshold: float,
    found: NDArray[np.float32],
) -> int:
    """Maxima of the PSF-smoothed image summed along the stars' trails, (row, col, S/N), block by block of the frame.

    paths : (blocks, steps, 2) pixels of the trail from its centre, block by block in rows. steps : (blocks,) how many of them.
    noise : (blocks,) standard deviation of the sum in sigma of a smoothed pixel. Returns how many fitted into `found`.
    """
    rows, cols = residual.shape
    margin = int(np.max(np.abs(paths))) + 2
    band = np.zeros((BLOCK_PX + 2 * margin, cols + 2 * margin), np.int16)
    total = np.zeros((BLOCK_PX + 2, block_cols + 2), np.int16)
    count, block = 0, 0
    for top in range(0, rows, BLOCK_PX):
        height = min(BLOCK_PX, rows - top)
        _smoothed_rows(residual, mask, sigma, tile_px, kernel, top - margin, band, margin)
        for left in range(0, cols, block_cols):
            width = min(block_cols, cols - left)
            if steps[block] > 0:
                path = paths[block, : steps[block]]
                part = total[: height + 2, : width + 2]
                for i in range(height + 2):
                    part[i] = 0
                    for k in range(path.shape[0]):
                        j = margin + left - 1 + path[k, 1]
                        _add(part[i], band[margin - 1 + i + path[k, 0], j : j + width + 2])
                unit = 1.0 / (UNIT * noise[block])
                at, corner = (margin - 1, margin + left - 1), (top - 1, left - 1)
                count = _collect(part, band, at, corner, path, threshold / unit, unit, found, count)
            block += 1
    return count


def sum_work(motion: StarMotion, shape: tuple[int, ...]) -> float:
    """Operations of the sums along the stars' trails at every pixel; 16-bit sums go many at once."""
    row, col = (np.linspace(0.0, n - 1.0, 9) for n in shape)
    steps = np.maximum(*(np.abs(part) for part in motion.at(*(axis.ravel() for axis in np.meshgrid(row, col, indexing="ij")))))
    return float(SUM_WORK * steps.mean() * shape[0] * shape[1])


def fit_work(motion: StarMotion, psf_sigma_px: float) -> float:
    """Operations of the fit of one of the longer trails: usual steps, and pixels within 3.5 sigma."""
    length = 0.7 * longest_px(motion)
    return FIT_WORK * (length + 7.0 * psf_sigma_px) * (7.0 * psf_sigma_px + 2.0) + BOX_WORK * length * length


def path_of(drow: float, dcol: float) -> NDArray[np.int32]:
    """Pixels (n, 2) of a trail from its centre, one for each step along its longer axis."""
    n = 1 + round(max(abs(drow), abs(dcol)))
    along = (np.arange(n) - 0.5 * (n - 1)) / max(n - 1, 1)
    # halves go one way: the middle of an even number of steps lies half a pixel before the centre
    return np.floor(np.outer(along, (drow, dcol)) + 0.5).astype(np.int32)


def matched_peaks(
    view: DetectorView, motion: StarMotion, psf_sigma_px: float, threshold: float, most: int
) -> NDArray[np.float32]:
    """Trails of the stars' motion (n, 3: row, col, S/N), brightest first; where they are short there are none."""
    rows, cols = view.residual_adu.shape
    block_cols = cols if motion.turn_rad == 0.0 else BLOCK_PX
    tops, lefts = np.arange(0, rows, BLOCK_PX), np.arange(0, cols, block_cols)
    at = np.stack(np.meshgrid(tops + 0.5 * BLOCK_PX, lefts + 0.5 * block_cols, indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = np.column_stack(motion.at(at[:, 0], at[:, 1]))
    each = [path_of(*v) if math.hypot(*v) > SHORT_PX else np.zeros((0, 2), np.int32) for v in vectors]
    steps = np.array([len(path) for path in each])
    paths = np.zeros((len(each), max(1, int(steps.max())), 2), np.int32)
    noise = np.ones(len(each))
    for k, path in enumerate(each):
        paths[k, : len(path)] = path
        apart = ((path[:, None, :] - path[None, :, :]) ** 2).sum(axis=-1)
        noise[k] = math.sqrt(max(1.0, float(np.exp(-0.25 * apart / psf_sigma_px**2).sum())))
    side = np.exp(-0.5 * (np.arange(max(2, math.ceil(2.2 * psf_sigma_px)) + 1) / psf_sigma_px) ** 2)
    kernel = (side / math.sqrt(side[0] ** 2 + 2.0 * float(np.sum(side[1:] ** 2)))).astype(np.float32)
    found = np.empty((most, 3), np.float32)
    background = view.background
    count = trail_peaks(
        view.residual_adu,
        view.mask,
        background.sigma_adu,
        background.tile_px,
        kernel,
        paths,
        steps,
        noise,
        block_cols,
        threshold,
        found,
    )
    return found[:count][np.argsort(-found[:count, 2], kind="stable")]


@njit(cache=True)
def paint_trail(out: NDArray[np.uint8], row: float, col: float, half_row: float, half_col: float, reach: float, bit: int) -> None:
    """Set a bit of `out` within `reach` px of a segment from centre and half vector, in place."""
    rows, cols = out.shape
    half = math.hypot(half_row, half_col)
    unit_row, unit_col = (half_row / half, half_col / half) if half > 1e-9 else (1.0, 0.0)
    reach_row, reach_col = abs(half_row) + reach, abs(half_col) + reach
    for i in range(max(0, math.ceil(row - reach_row)), min(rows - 1, math.floor(row + reach_row)) + 1):
        for j in range(max(0, math.ceil(col - reach_col)), min(cols - 1, math.floor(col + reach_col)) + 1):
            along = (i - row) * unit_row + (j - col) * unit_col
            across = (i - row) * unit_col - (j - col) * unit_row
            beyond = max(0.0, abs(along) - half)
            if beyond * beyond + across * across <= reach * reach:
                out[i, j] |= np.uint8(bit)


@njit(cache=True)
def _along(frame: ResidualImage, row: int, col: int, half_row: float, half_col: float) -> NDArray[np.float64]:
    """Pixels along a trail about a centre, over the noise; zeros beyond the frame."""
    rows, cols = frame.residual.shape
    values = np.zeros(2 * int(math.hypot(half_row, half_col)) + 1)
    for k in range(values.size):
        u = 2.0 * k / max(values.size - 1, 1) - 1.0
        i, j = round(row + u * half_row), round(col + u * half_col)
        if 0 <= i < rows and 0 <= j < cols:
            values[k] = frame.residual[i, j] / frame.noise_adu if frame.mask[i, j] & SATURATED == 0 else FULL_SIGMA
    return values


@njit(cache=True)
def keep_brightest(
    frame: ResidualImage,
    peaks: NDArray[np.float32],
    half: NDArray[np.float64],
    psf_sigma_px: float,
    painted: NDArray[np.uint8],
    keep: NDArray[np.bool_],
) -> None:
    """Which of the peaks (n, 3), brightest first, lie on no brighter one's trail; their S/N becomes that of the unclipped image.

    In the light around a brighter one a trail of its own is brighter than what lies on both sides of it, and has both its ends.
    half : (n, 2) half vectors. painted : zeros, becomes CORE and AROUND on the trails.
    """
    for n in range(peaks.shape[0]):
        row, col = int(peaks[n, 0]), int(peaks[n, 1])
        keep[n] = painted[row, col] & CORE == 0
        if not keep[n]:
            continue
        length = 2.0 * math.hypot(half[n, 0], half[n, 1])
        values = _along(frame, row, col, half[n, 0], half[n, 1])
        peak = float(np.median(values))
        quarter = max(1, values.size // 4)
        darkest = min(values[:quarter].mean(), values[-quarter:].mean())
        if painted[row, col] != 0:
            beside = 0.0
            for side in (-1.0, 1.0):
                across = side * (3.0 * psf_sigma_px + 1.0) / max(0.5 * length, 1e-6)
                i, j = round(row + across * half[n, 1]), round(col - across * half[n, 0])
                beside = max(beside, float(np.median(_along(frame, i, j, half[n, 0], half[n, 1]))))
            if peak < BRIGHT_SIGMA or peak < ABOVE_SIDES * beside or darkest < DARK_END * peak:
                keep[n] = False
                continue
        if values.size >= LEAST_SHAPE_PX and peak > BRIGHT_SIGMA and darkest < DARK_END * peak:
            keep[n] = False
            continue
        top = int(np.argmax(values))
        if values.size >= LEAST_SHAPE_PX and POINT_SIGMA < values[top] < FULL_SIGMA:
            others = np.concatenate((values[: max(0, top - POINT_PX)], values[top + POINT_PX + 1 :]))
            if others.sum() < LEAST_BESIDE * math.sqrt(max(1, others.size)):
                keep[n] = False
                continue
        peaks[n, 2] = max(peaks[n, 2], 1.331 * peak * math.sqrt(length * psf_sigma_px))
        reach = trail_reach_px(peak, psf_sigma_px)
        paint_trail(painted, float(row), float(col), half[n, 0], half[n, 1], reach, AROUND)
        paint_trail(painted, float(row), float(col), half[n, 0], half[n, 1], 2.0 * psf_sigma_px + 1.0, CORE)


@njit(cache=True)
def paint_trails(
    out: NDArray[np.uint8],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    half: NDArray[np.float64],
    snr: NDArray[np.float32],
    psf_sigma_px: float,
    bit: int,
) -> None:
    """Set a bit of `out` where trails (n,) of half vectors (n, 2) shine, in place."""
    for n in range(row.size):
        length = max(2.0 * math.hypot(half[n, 0], half[n, 1]), 3.5 * psf_sigma_px)
        peak = snr[n] / (1.331 * math.sqrt(length * psf_sigma_px))
        paint_trail(out, row[n], col[n], half[n, 0], half[n, 1], trail_reach_px(peak, psf_sigma_px), bit)


def matched_trails(
    view: DetectorView, motion: StarMotion, psf_sigma_px: float, threshold: float, most: int, noise_adu: float
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.uint8]]:
    """Trails of the stars' motion (n, 3: row, col, S/N), brightest first, each once; their half vectors (n, 2); a map of them."""
    found = matched_peaks(view, motion, psf_sigma_px, threshold, most)
    half = 0.5 * np.column_stack(motion.at(found[:, 0].astype(np.float64), found[:, 1].astype(np.float64)))
    painted, keep = np.zeros(view.mask.shape, np.uint8), np.zeros(len(found), np.bool_)
    keep_brightest(ResidualImage(view.residual_adu, view.mask, noise_adu), found, half, psf_sigma_px, painted, keep)
    order = np.flatnonzero(keep)
    order = order[np.argsort(-found[order, 2], kind="stable")]
    return found[order], half[order], painted


@njit(cache=True)
def trail_reach_px(peak_sigma: float, psf_sigma_px: float) -> float:
    """How far from a trail's line its light matters; peak_sigma : brightest pixel across, over the noise."""
    return 3.0 * psf_sigma_px + 1.0 + 1.5 * math.log2(max(1.0, peak_sigma))


def listed(
    view: DetectorView,
    peaks: NDArray[np.float32],
    half: NDArray[np.float64],
    psf_sigma_px: float,
    noise_adu: float,
    gain_e_adu: float,
    chosen: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Fits (n, 4: row, col, flux ADU, S/N) and flags of trails at peaks (n, 3); those not chosen keep their pixel, BLENDED.

    The flux of a trail of S/N S is S sigma sqrt(sum(t^2))^-1, with sum(t^2) = 1 / hypot(2 sqrt(pi) s L, 4 pi s^2) for a length L.
    """
    fits, flags = np.empty((len(peaks), 4)), np.full(len(peaks), BLENDED, dtype=np.uint8)
    length = 2.0 * np.hypot(half[:, 0], half[:, 1])
    light = np.sqrt(np.hypot(2.0 * math.sqrt(math.pi) * psf_sigma_px * length, 4.0 * math.pi * psf_sigma_px**2))
    fits[:, :2], fits[:, 3] = peaks[:, :2], peaks[:, 2]
    fits[:, 2] = peaks[:, 2] * noise_adu * light
    some, some_flags = np.empty((np.count_nonzero(chosen), 4)), np.zeros(np.count_nonzero(chosen), dtype=np.uint8)
    frame = ResidualImage(view.residual_adu, view.mask, noise_adu)
    fit_trails(frame, peaks[chosen], half[chosen], psf_sigma_px, gain_e_adu, some, some_flags)
    fits[chosen], flags[chosen] = some, some_flags
    return fits, flags | np.uint8(StarFlag.TRAILED)
