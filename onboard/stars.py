"""Star list: PSF-matched filter, peaks, maximum-likelihood centroids.

The smoothed image never exists as a whole: three rows of it are held while peaks are looked for. Each peak is then
fitted with the PSF in a small window, every pixel weighted by its own noise (sky and the star's photons), which is
what the Cramer-Rao bound asks for (King 1983, PASP 95, 163).
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.calibrate import expand_nodes
from onboard.star_shape import MOST_STARS, FieldShape, measure_shape
from sboc_e2e.icd.flags import MaskBit, StarFlag
from sboc_e2e.icd.signals import DetectorView, StarList

SATURATED = int(MaskBit.SATURATED)
EDGE, BLENDED, DEFECT = int(StarFlag.EDGE), int(StarFlag.BLENDED), int(StarFlag.DEFECT)
SATURATED_STAR = int(StarFlag.SATURATED)
BRIGHT_PEAK_SIGMA = 12.0
"""Stars with a brighter central pixel are fitted in the larger window."""

SETTLED_PX2 = 1e-4
SETTLED_VARIANCE = 0.03
"""A step shorter than 0.01 px, or than 0.17 of the error of the position, is the last one: Gauss-Newton squares it."""

COSMIC_SHARPNESS = 1.7
"""A peak is sharper than a star when its contrast exceeds the PSF's by this factor at 5 sigma significance."""

CANDIDATES_PER_STAR = 40
"""The brightest so many times the wanted number take part in the choice of well-spread stars."""

SHAPE_SNR = 40.0
"""Stars above this S/N show the shape of the PSF."""

TRAILED_OVER_PSF = 1.5
"""Stars are called trailed when the smear is longer than this many PSF sigmas."""


@njit(cache=True)
def _add_pair(k: np.float32, a: NDArray[np.float32], b: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """``out += k (a + b)``; a function of its own so that it is compiled to vector instructions."""
    for col in range(out.size):
        out[col] += k * (a[col] + b[col])


@njit(cache=True)
def _weigh_five(
    kernel: NDArray[np.float32],
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    e: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """``out = k2 (a + e) + k1 (b + d) + k0 c``."""
    k0, k1, k2 = kernel[0], kernel[1], kernel[2]
    for col in range(out.size):
        out[col] = k0 * c[col] + k1 * (b[col] + d[col]) + k2 * (a[col] + e[col])


@njit(cache=True)
def _smooth_row(
    residual: NDArray[np.float32],
    row: int,
    kernel: NDArray[np.float32],
    zeros: NDArray[np.float32],
    padded: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """One row of the separable convolution; zeros outside the frame. kernel: centre and one side, at least 3 values."""
    rows, cols = residual.shape
    radius = kernel.size - 1
    middle = padded[radius : radius + cols]
    _weigh_five(
        kernel,
        residual[row - 2] if row >= 2 else zeros,
        residual[row - 1] if row >= 1 else zeros,
        residual[row],
        residual[row + 1] if row + 1 < rows else zeros,
        residual[row + 2] if row + 2 < rows else zeros,
        middle,
    )
    for k in range(3, radius + 1):
        _add_pair(kernel[k], residual[row - k] if row >= k else zeros, residual[row + k] if row + k < rows else zeros, middle)
    _weigh_five(
        kernel,
        padded[radius - 2 : radius - 2 + cols],
        padded[radius - 1 : radius - 1 + cols],
        middle,
        padded[radius + 1 : radius + 1 + cols],
        padded[radius + 2 : radius + 2 + cols],
        out,
    )
    for k in range(3, radius + 1):
        _add_pair(kernel[k], padded[radius - k : radius - k + cols], padded[radius + k : radius + k + cols], out)


@njit(cache=True)
def _exceeds(values: NDArray[np.float32], threshold: NDArray[np.float32], out: NDArray[np.uint8]) -> None:
    """1 where a value exceeds its threshold."""
    for k in range(values.size):
        out[k] = np.uint8(values[k] > threshold[k])


@njit(cache=True)
def _vertex(before: np.float32, middle: np.float32, after: np.float32) -> np.float32:
    """Where the parabola through three neighbouring values, the middle one largest, has its top, px from the middle."""
    return np.float32(0.5) * (after - before) / (middle + middle - before - after)


@njit(cache=True)
def find_peaks(
    residual: NDArray[np.float32],
    sigma_nodes: NDArray[np.float32],
    tile_px: int,
    kernel: NDArray[np.float32],
    threshold: float,
    peaks: NDArray[np.float32],
) -> int:
    """Local maxima of the smoothed image above ``threshold * sigma``; returns how many of them fitted into `peaks`.

    kernel : centre and one side of the separable smoothing kernel. peaks : (capacity, 5) row, col, smoothed value, and
    the fractions of a
    pixel by which a parabola moves the peak.
    """
    rows, cols = residual.shape
    zeros = np.zeros(cols, dtype=np.float32)
    padded = np.zeros(cols + 2 * (kernel.size - 1), dtype=np.float32)
    ring = np.zeros((3, cols), dtype=np.float32)
    limit = np.empty(cols, dtype=np.float32)
    hits = np.zeros(-(-cols // 8) * 8, dtype=np.uint8)
    words = hits.view(np.uint64)
    count, held = 0, -1
    _smooth_row(residual, 0, kernel, zeros, padded, ring[0])
    for row in range(rows):
        if row + 1 < rows:
            _smooth_row(residual, row + 1, kernel, zeros, padded, ring[(row + 1) % 3])
        else:
            ring[(row + 1) % 3, :] = 0.0
        tile = min(row // tile_px, sigma_nodes.shape[0] - 1)
        if tile != held:
            expand_nodes(sigma_nodes[tile], tile_px, limit)
            limit *= np.float32(threshold)
            held = tile
        here, above, below = ring[row % 3], ring[(row + 2) % 3], ring[(row + 1) % 3]
        _exceeds(here, limit, hits[:cols])
        for word in range(words.size):
            if words[word] == 0:
                continue
            for col in range(max(8 * word, 1), min(8 * word + 8, cols - 1)):
                value = here[col]
                if hits[col] == 0 or value < here[col - 1] or value <= here[col + 1]:
                    continue
                if value < above[col] or value < above[col - 1] or value < above[col + 1]:
                    continue
                if value <= below[col] or value <= below[col - 1] or value <= below[col + 1]:
                    continue
                if count == peaks.shape[0]:
                    return count
                peaks[count, 0], peaks[count, 1], peaks[count, 2] = row, col, value
                peaks[count, 3] = _vertex(above[col], value, below[col])
                peaks[count, 4] = _vertex(here[col - 1], value, here[col + 1])
                count += 1
    return count


@njit(cache=True, fastmath={"reassoc", "contract", "nsz", "arcp"})  # sums over a window, all finite: order is free
def _normal_equations(
    data: NDArray[np.float64],
    usable: NDArray[np.float64],
    psf: NDArray[np.float64],
    drow: NDArray[np.float64],
    dcol: NDArray[np.float64],
    flux: float,
    row: float,
    col: float,
    variance: float,
    gain_e_adu: float,
    shape_inverse: tuple[float, float, float],
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Gradient (flux, row, col), information matrix (ff, fr, fc, rr, rc, cc) and sum of squared PSF over the window."""
    inv_rr, inv_rc, inv_cc = shape_inverse
    gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(data.size):
        t = psf[q]
        model = flux * t
        weight = usable[q] / (variance + model / gain_e_adu)
        u, v = drow[q] - row, dcol[q] - col
        slope_row = model * (inv_rr * u + inv_rc * v)
        slope_col = model * (inv_cc * v + inv_rc * u)
        misfit = (data[q] - model) * weight
        gf += misfit * t
        gr += misfit * slope_row
        gc += misfit * slope_col
        ff += weight * t * t
        fr += weight * t * slope_row
        fc += weight * t * slope_col
        rr += weight * slope_row * slope_row
        rc += weight * slope_row * slope_col
        cc += weight * slope_col * slope_col
        squares += usable[q] * t * t
    return gf, gr, gc, ff, fr, fc, rr, rc, cc, squares


@njit(cache=True)
def _psf_at(
    row: float,
    col: float,
    radius: int,
    shape_inverse: tuple[float, float, float],
    factors: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Gaussian PSF of unit flux sampled in the window, for a star at (row, col) from its centre."""
    inv_rr, inv_rc, inv_cc = shape_inverse
    norm = math.sqrt(inv_rr * inv_cc - inv_rc * inv_rc) / (2.0 * math.pi)
    side = 2 * radius + 1
    for k in range(side):
        factors[0, k] = norm * math.exp(-0.5 * inv_rr * (k - radius - row) ** 2)
        factors[1, k] = math.exp(-0.5 * inv_cc * (k - radius - col) ** 2)
    for i in range(side):
        for j in range(side):
            out[i * side + j] = factors[0, i] * factors[1, j]
    if abs(inv_rc) * radius * radius < 0.15:  # nearly upright: a series is exact to 6e-4 in the corners and much faster
        for i in range(side):
            for j in range(side):
                x = -inv_rc * (i - radius - row) * (j - radius - col)
                out[i * side + j] *= 1.0 + x * (1.0 + 0.5 * x)
    else:
        for i in range(side):
            for j in range(side):
                out[i * side + j] *= math.exp(-inv_rc * (i - radius - row) * (j - radius - col))


@njit(cache=True)
def _take_window(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    row0: int,
    col0: int,
    radius: int,
    data: NDArray[np.float64],
    usable: NDArray[np.float64],
) -> int:
    """Pixels around a peak; unusable ones get weight 0. Returns `StarFlag` bits EDGE, DEFECT and SATURATED."""
    rows, cols = residual.shape
    side, flag = 2 * radius + 1, 0
    if radius <= row0 < rows - radius and radius <= col0 < cols - radius:
        for i in range(side):
            for j in range(side):
                q, r, c = i * side + j, row0 - radius + i, col0 - radius + j
                data[q] = residual[r, c]
                usable[q] = 1.0
                if mask[r, c] != 0:
                    usable[q] = 0.0
                    flag |= SATURATED_STAR if mask[r, c] & SATURATED else DEFECT
        return flag
    for i in range(side):
        for j in range(side):
            q, r, c = i * side + j, row0 - radius + i, col0 - radius + j
            inside = 0 <= r < rows and 0 <= c < cols
            data[q] = residual[r, c] if inside else 0.0
            usable[q] = 1.0 if inside and mask[r, c] == 0 else 0.0
    return EDGE


@njit(cache=True)
def fit_stars(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_nodes: NDArray[np.float32],
    tile_px: int,
    peaks: NDArray[np.float32],
    covariances: NDArray[np.float64],
    radii: tuple[int, int],
    gain_e_adu: float,
    out: NDArray[np.float64],
    flags: NDArray[np.uint8],
) -> None:
    """Gauss-Newton maximum likelihood of flux and position at every peak.

    covariances : (n, 3) covariance (rr, rc, cc) of the Gaussian PSF at each peak, px^2. radii : half sides of the window of
    faint (sky noise rules, the information is in the core) and of bright stars. out : (n, 5) row, col, flux ADU, S/N,
    contrast of the central pixel over the PSF's; flags : `StarFlag` bits.
    """
    offsets = (_window_offsets(radii[0]), _window_offsets(radii[1]))
    largest = (2 * radii[1] + 1) ** 2
    data, usable, psf = np.empty(largest), np.empty(largest), np.empty(largest)
    factors = np.empty((2, 2 * radii[1] + 1))
    for n in range(peaks.shape[0]):
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        sigma = float(sigma_nodes[min(row0 // tile_px, sigma_nodes.shape[0] - 1), min(col0 // tile_px, sigma_nodes.shape[1] - 1)])
        crr, crc, ccc = covariances[n, 0], covariances[n, 1], covariances[n, 2]
        cdet = crr * ccc - crc * crc
        shape_inverse = (ccc / cdet, -crc / cdet, crr / cdet)
        peak_psf = 1.0 / (2.0 * math.pi * math.sqrt(cdet))
        bright = residual[row0, col0] > BRIGHT_PEAK_SIGMA * sigma
        radius = radii[1] if bright else radii[0]
        drow, dcol = offsets[1] if bright else offsets[0]
        size = drow.size
        flag = _take_window(residual, mask, row0, col0, radius, data, usable)
        row, col = float(peaks[n, 3]), float(peaks[n, 4])
        flux = 1.7 * max(float(peaks[n, 2]), 0.1 * sigma) / peak_psf
        squares = 0.0
        for _ in range(6):
            _psf_at(row, col, radius, shape_inverse, factors, psf)
            gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = _normal_equations(
                data[:size], usable[:size], psf[:size], drow, dcol, flux, row, col, sigma * sigma, gain_e_adu, shape_inverse
            )
            minor_f, minor_r, minor_c = rr * cc - rc * rc, ff * cc - fc * fc, ff * rr - fr * fr
            det = ff * minor_f - fr * (fr * cc - rc * fc) + fc * (fr * rc - rr * fc)
            if det <= 1e-9 * ff * rr * cc:
                flag |= BLENDED
                break
            mixed_fr, mixed_fc, mixed_rc = fc * rc - fr * cc, fr * rc - fc * rr, fr * fc - ff * rc
            step_flux = (minor_f * gf + mixed_fr * gr + mixed_fc * gc) / det
            step_row = (mixed_fr * gf + minor_r * gr + mixed_rc * gc) / det
            step_col = (mixed_fc * gf + mixed_rc * gr + minor_c * gc) / det
            step_row, step_col = min(max(step_row, -0.7), 0.7), min(max(step_col, -0.7), 0.7)
            row, col, flux = row + step_row, col + step_col, max(flux + step_flux, 0.2 * flux)
            if step_row * step_row + step_col * step_col < max(SETTLED_PX2, SETTLED_VARIANCE / rr) and (
                abs(step_flux) < 0.05 * flux
            ):
                break
        if abs(row) > 1.2 or abs(col) > 1.2:
            row, col, flag = 0.0, 0.0, flag | BLENDED
        out[n, 0], out[n, 1], out[n, 2] = row0 + row, col0 + col, flux
        out[n, 3] = flux * math.sqrt(squares) / sigma
        out[n, 4] = _contrast(residual, row0, col0) / (peak_psf * flux)
        flags[n] = flag


@njit(cache=True)
def _window_offsets(radius: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Row and col of each pixel of a square window from its centre, flattened."""
    side = 2 * radius + 1
    drow, dcol = np.empty(side * side), np.empty(side * side)
    for q in range(side * side):
        drow[q], dcol[q] = q // side - radius, q % side - radius
    return drow, dcol


@njit(cache=True)
def _contrast(residual: NDArray[np.float32], row: int, col: int) -> float:
    """Central pixel minus the mean of its four neighbours."""
    rows, cols = residual.shape
    around = residual[max(row - 1, 0), col] + residual[min(row + 1, rows - 1), col]
    around += residual[row, max(col - 1, 0)] + residual[row, min(col + 1, cols - 1)]
    return residual[row, col] - 0.25 * around


@njit(cache=True)
def saturated_pixels(mask: NDArray[np.uint8], capacity: int) -> NDArray[np.int32]:
    """Rows and cols, (n, 2), of saturated pixels in row order; at most `capacity` of them."""
    rows, cols = mask.shape
    out = np.empty((capacity, 2), dtype=np.int32)
    count = 0
    for row in range(rows):
        line = mask[row]
        hits = np.int32(0)
        for col in range(cols):
            hits += np.int32((line[col] & SATURATED) != 0)
        if hits == 0:
            continue
        for col in range(cols):
            if line[col] & SATURATED:
                if count == capacity:
                    return out
                out[count, 0], out[count, 1] = row, col
                count += 1
    return out[:count]


@njit(cache=True)
def group_pixels(pixels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Group number of each pixel; pixels within two rows and two cols of each other are one group. Row order."""
    n = pixels.shape[0]
    parent = np.arange(n).astype(np.int32)
    first = 0
    for k in range(n):
        while pixels[first, 0] < pixels[k, 0] - 2:
            first += 1
        for m in range(first, k):
            if abs(pixels[m, 1] - pixels[k, 1]) <= 2:
                a, b = np.int32(m), np.int32(k)
                while parent[a] != a:
                    parent[a] = parent[parent[a]]
                    a = parent[a]
                while parent[b] != b:
                    parent[b] = parent[parent[b]]
                    b = parent[b]
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
    for k in range(n):
        a = np.int32(k)
        while parent[a] != a:
            a = parent[a]
        parent[k] = a
    return parent


def saturated_stars(view: DetectorView, saturation_adu: float, capacity: int = 40000) -> NDArray[np.float64]:
    """Centres and least fluxes, (n, 3) row, col, flux ADU, of groups of saturated pixels."""
    pixels = saturated_pixels(view.mask, capacity)
    if len(pixels) == 0:
        return np.zeros((0, 3))
    groups, index = np.unique(group_pixels(pixels), return_inverse=True)
    number = np.bincount(index, minlength=len(groups))
    row = np.bincount(index, weights=pixels[:, 0]) / number
    col = np.bincount(index, weights=pixels[:, 1]) / number
    return np.column_stack((row, col, 2.0 * number * saturation_adu))


def gaussian_kernel(sigma_px: float) -> NDArray[np.float32]:
    """Centre and one side of a Gaussian of unit sum, out to 2.2 sigma."""
    offsets = np.arange(max(2, math.ceil(2.2 * sigma_px)) + 1)
    side = np.exp(-0.5 * (offsets / sigma_px) ** 2)
    return (side / (side[0] + 2.0 * side[1:].sum())).astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class MatchedStars:
    """`matched`: every star above a threshold, with maximum-likelihood centroids."""

    n_sigma: float = field(default=5.0, metadata={"doc": "least matched-filter S/N", "min": 3.0, "max": 100.0})
    max_stars: int = field(default=200_000, metadata={"doc": "most stars that are listed", "min": 1, "max": 1_000_000})

    def extract(self, view: DetectorView) -> StarList:
        """All stars found, by falling flux."""
        kernel = gaussian_kernel(view.psf_sigma_px)
        noise = float(kernel[0] ** 2 + 2.0 * np.sum(kernel[1:] ** 2))
        peaks = np.empty((self.max_stars, 5), dtype=np.float32)
        sigma_nodes, tile_px = view.background.sigma_adu, view.background.tile_px
        count = find_peaks(view.residual_adu, sigma_nodes, tile_px, kernel, self.n_sigma * noise, peaks)
        peaks = peaks[:count]
        sigma = float(np.median(sigma_nodes))
        shape = measure_shape(
            view.residual_adu,
            view.mask,
            _shape_stars(peaks, noise * sigma),
            FieldShape.nominal(view.psf_sigma_px, view.mask.shape),
        )
        covariances = shape.covariance(peaks)
        gain = view.header.gain_e_adu if view.header.gain_e_adu is not None else 1.0
        fits, flags = np.empty((len(peaks), 5)), np.zeros(len(peaks), dtype=np.uint8)
        width = math.sqrt(float(shape.coefficients[[0, 2], 0].max()))
        radii = (max(2, math.ceil(2.0 * width)), max(3, math.ceil(3.0 * width)))
        fit_stars(view.residual_adu, view.mask, sigma_nodes, tile_px, peaks, covariances, radii, gain, fits, flags)
        # what peaks beside saturated pixels belongs to the rim of the saturated star, which is listed below
        clean = (flags & SATURATED_STAR) == 0
        fits, flags, covariances = fits[clean], flags[clean], covariances[clean]
        psf_contrast = 1.0 - 0.5 * (np.exp(-0.5 / covariances[:, 0]) + np.exp(-0.5 / covariances[:, 2]))
        sharp = fits[:, 4] - COSMIC_SHARPNESS * psf_contrast > 5.0 / np.maximum(fits[:, 3], 1.0)
        flags[sharp] |= np.uint8(StarFlag.COSMIC_LIKE)
        if shape.smear_px > TRAILED_OVER_PSF * view.psf_sigma_px:
            flags |= np.uint8(StarFlag.TRAILED)
        saturation = view.header.saturation_adu if view.header.saturation_adu is not None else 65535.0
        bright = saturated_stars(view, saturation)
        bright_snr = bright[:, 2] / max(sigma * math.sqrt(4.0 * math.pi) * width, 1e-9)
        bright_flags = np.full(len(bright), int(StarFlag.SATURATED), dtype=np.uint8)
        flux = np.concatenate((fits[:, 2], bright[:, 2])) * gain
        order = np.argsort(-flux, kind="stable")
        return StarList(
            row=np.concatenate((fits[:, 0], bright[:, 0]))[order],
            col=np.concatenate((fits[:, 1], bright[:, 1]))[order],
            flux_e=flux[order].astype(np.float32),
            snr=np.concatenate((fits[:, 3], bright_snr))[order].astype(np.float32),
            flags=np.concatenate((flags, bright_flags))[order],
        )


def _shape_stars(peaks: NDArray[np.float32], noise_adu: float) -> NDArray[np.float32]:
    """Peaks bright enough for moments (40 sigma after smoothing), the brightest `MOST_STARS` of them."""
    bright = peaks[peaks[:, 2] > SHAPE_SNR * noise_adu]
    return bright[np.argsort(-bright[:, 2], kind="stable")[:MOST_STARS]]


def best_spread(stars: StarList, shape: tuple[int, int], number: int, cells: int = 8) -> NDArray[np.intp]:
    """Indices of up to `number` stars for a camera solution: the brightest of each of cells x cells fields in turn.

    Clean stars go before blended ones and those with defects or edges in their window; saturated and cosmic-like
    entries come last.
    """
    if len(stars) == 0 or number == 0:
        return np.zeros(0, dtype=np.intp)
    bright = np.sort(np.argsort(-stars.flux_e, kind="stable")[: CANDIDATES_PER_STAR * number])
    return bright[_spread(stars, bright, shape, number, cells)]


def _spread(stars: StarList, among: NDArray[np.intp], shape: tuple[int, int], number: int, cells: int) -> NDArray[np.intp]:
    """The choice of `best_spread` among some stars, as sorted indices into `among`."""
    flags, flux = stars.flags[among], stars.flux_e[among]
    worst = StarFlag.SATURATED | StarFlag.COSMIC_LIKE
    poor = StarFlag.EDGE | StarFlag.DEFECT | StarFlag.BLENDED
    grade = np.where(flags & worst, 2, np.where(flags & poor, 1, 0))
    cell_row = np.clip(stars.row[among] * cells / shape[0], 0, cells - 1).astype(np.intp)
    cell_col = np.clip(stars.col[among] * cells / shape[1], 0, cells - 1).astype(np.intp)
    cell = cell_row * cells + cell_col
    order = np.lexsort((-flux, grade, cell))
    first = np.concatenate(([True], cell[order][1:] != cell[order][:-1]))
    start = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    turn = np.arange(len(order)) - start
    chosen = order[np.lexsort((-flux[order], turn, grade[order]))][:number]
    return np.sort(chosen)
