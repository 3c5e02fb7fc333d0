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
from sboc_e2e.icd.flags import MaskBit, StarFlag
from sboc_e2e.icd.signals import DetectorView, StarList

SATURATED = int(MaskBit.SATURATED)
BLOCK = 32
"""Columns that are tested for a hit together; the test is vectorised, the search within a block is not."""

COSMIC_SHARPNESS = 1.7
"""A peak is sharper than a star when its contrast exceeds the PSF's by this factor at 5 sigma significance."""

RIM_PX = 2
"""Peaks this close to a saturated pixel belong to the saturated star's rim."""


@njit(cache=True)
def _smooth_row(
    residual: NDArray[np.float32], row: int, kernel: NDArray[np.float32], padded: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """One row of the separable convolution; zeros outside the frame. kernel: centre and one side."""
    rows, cols = residual.shape
    radius = kernel.size - 1
    middle = padded[radius : radius + cols]
    source = residual[row]
    for col in range(cols):
        middle[col] = kernel[0] * source[col]
    for k in range(1, radius + 1):
        for neighbour in (row - k, row + k):
            if 0 <= neighbour < rows:
                source = residual[neighbour]
                for col in range(cols):
                    middle[col] += kernel[k] * source[col]
    for col in range(cols):
        out[col] = kernel[0] * padded[col + radius]
    for k in range(1, radius + 1):
        left, right = padded[radius - k : radius - k + cols], padded[radius + k : radius + k + cols]
        for col in range(cols):
            out[col] += kernel[k] * (left[col] + right[col])


@njit(cache=True)
def _count_above(values: NDArray[np.float32], threshold: NDArray[np.float32]) -> int:
    """How many values exceed their threshold."""
    number = np.int32(0)
    for k in range(values.size):
        number += np.int32(values[k] > threshold[k])
    return number


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

    kernel : centre and one side of the separable smoothing kernel. peaks : (capacity, 3) row, col, smoothed value.
    """
    rows, cols = residual.shape
    padded = np.zeros(cols + 2 * (kernel.size - 1), dtype=np.float32)
    ring = np.zeros((3, cols), dtype=np.float32)
    limit = np.empty(cols, dtype=np.float32)
    count, held = 0, -1
    _smooth_row(residual, 0, kernel, padded, ring[0])
    for row in range(rows):
        if row + 1 < rows:
            _smooth_row(residual, row + 1, kernel, padded, ring[(row + 1) % 3])
        else:
            ring[(row + 1) % 3, :] = 0.0
        tile = min(row // tile_px, sigma_nodes.shape[0] - 1)
        if tile != held:
            expand_nodes(sigma_nodes[tile], tile_px, limit)
            limit *= np.float32(threshold)
            held = tile
        here, above, below = ring[row % 3], ring[(row + 2) % 3], ring[(row + 1) % 3]
        for start in range(0, cols, BLOCK):
            stop = min(start + BLOCK, cols)
            if _count_above(here[start:stop], limit[start:stop]) == 0:
                continue
            for col in range(max(start, 1), min(stop, cols - 1)):
                value = here[col]
                if value <= limit[col] or value < here[col - 1] or value <= here[col + 1]:
                    continue
                if value < above[col] or value < above[col - 1] or value < above[col + 1]:
                    continue
                if value <= below[col] or value <= below[col - 1] or value <= below[col + 1]:
                    continue
                if count == peaks.shape[0]:
                    return count
                peaks[count, 0], peaks[count, 1], peaks[count, 2] = row, col, value
                count += 1
    return count


@njit(cache=True)
def fit_stars(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_nodes: NDArray[np.float32],
    tile_px: int,
    peaks: NDArray[np.float32],
    shape_inverse: tuple[float, float, float],
    radius: int,
    gain_e_adu: float,
    out: NDArray[np.float64],
    flags: NDArray[np.uint8],
) -> None:
    """Gauss-Newton maximum likelihood of amplitude and position at every peak.

    shape_inverse : inverse covariance of the Gaussian PSF (rr, rc, cc), 1/px^2.
    out : (n, 5) row, col, flux ADU, S/N, contrast of the central pixel over the PSF's; flags: `StarFlag` bits.
    """
    rows, cols = residual.shape
    inv_rr, inv_rc, inv_cc = shape_inverse
    norm = 2.0 * math.pi / math.sqrt(inv_rr * inv_cc - inv_rc * inv_rc)
    width = 2 * radius + 1
    row_factor, col_factor = np.empty(width), np.empty(width)
    for n in range(peaks.shape[0]):
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        sigma = sigma_nodes[min(row0 // tile_px, sigma_nodes.shape[0] - 1), min(col0 // tile_px, sigma_nodes.shape[1] - 1)]
        variance = float(sigma) * float(sigma)
        row, col, flux = float(row0), float(col0), max(float(peaks[n, 2]), 0.1 * sigma) * 2.0 * norm
        information = 1e-9
        flag = np.uint8(0)
        if row0 < radius or col0 < radius or row0 >= rows - radius or col0 >= cols - radius:
            flag |= np.uint8(2)
        for iteration in range(6):
            for k in range(width):
                row_factor[k] = math.exp(-0.5 * inv_rr * (row0 + k - radius - row) ** 2)
                col_factor[k] = math.exp(-0.5 * inv_cc * (col0 + k - radius - col) ** 2)
            ff, fr, fc, rr, rc, cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            gf, gr, gc, information = 0.0, 0.0, 0.0, 0.0
            for i in range(max(0, row0 - radius), min(rows, row0 + radius + 1)):
                drow = i - row
                for j in range(max(0, col0 - radius), min(cols, col0 + radius + 1)):
                    if mask[i, j] != 0:
                        if iteration == 0:
                            flag |= np.uint8(8)
                        continue
                    dcol = j - col
                    psf = row_factor[i - row0 + radius] * col_factor[j - col0 + radius] / norm
                    if inv_rc != 0.0:
                        psf *= math.exp(-inv_rc * drow * dcol)
                    model = flux * psf
                    weight = 1.0 / (variance + max(model, 0.0) / gain_e_adu)
                    slope_row = model * (inv_rr * drow + inv_rc * dcol)
                    slope_col = model * (inv_cc * dcol + inv_rc * drow)
                    misfit = (residual[i, j] - model) * weight
                    gf += misfit * psf
                    gr += misfit * slope_row
                    gc += misfit * slope_col
                    ff += weight * psf * psf
                    fr += weight * psf * slope_row
                    fc += weight * psf * slope_col
                    rr += weight * slope_row * slope_row
                    rc += weight * slope_row * slope_col
                    cc += weight * slope_col * slope_col
                    information += psf * psf
            if ff <= 0.0:
                break
            # the curvature of the positions is bounded below, or a flux near zero would throw the star away
            floor = 0.05 * ff * flux * flux * math.sqrt(inv_rr * inv_cc) + 1e-12
            rr, cc = rr + floor * (rr < floor), cc + floor * (cc < floor)
            det = ff * (rr * cc - rc * rc) - fr * (fr * cc - rc * fc) + fc * (fr * rc - rr * fc)
            if det <= 0.0:
                break
            step_flux = (gf * (rr * cc - rc * rc) - fr * (gr * cc - rc * gc) + fc * (gr * rc - rr * gc)) / det
            step_row = (ff * (gr * cc - gc * rc) - gf * (fr * cc - rc * fc) + fc * (fr * gc - gr * fc)) / det
            step_col = (ff * (rr * gc - rc * gr) - fr * (fr * gc - gr * fc) + gf * (fr * rc - rr * fc)) / det
            step_row, step_col = min(max(step_row, -0.7), 0.7), min(max(step_col, -0.7), 0.7)
            row, col, flux = row + step_row, col + step_col, max(flux + step_flux, 0.1 * flux)
            if step_row * step_row + step_col * step_col < 1e-7 and abs(step_flux) < 1e-4 * flux:
                break
        if abs(row - row0) > 1.5 or abs(col - col0) > 1.5:
            row, col, flag = float(row0), float(col0), flag | np.uint8(4)
        out[n, 0], out[n, 1], out[n, 2] = row, col, flux
        out[n, 3] = flux * math.sqrt(information) / sigma
        out[n, 4] = _contrast(residual, row0, col0) * norm / flux
        flags[n] = flag


@njit(cache=True)
def _contrast(residual: NDArray[np.float32], row: int, col: int) -> float:
    """Central pixel minus the mean of its four neighbours."""
    rows, cols = residual.shape
    around = residual[max(row - 1, 0), col] + residual[min(row + 1, rows - 1), col]
    around += residual[row, max(col - 1, 0)] + residual[row, min(col + 1, cols - 1)]
    return residual[row, col] - 0.25 * around


@njit(cache=True)
def near_saturation(mask: NDArray[np.uint8], peaks: NDArray[np.float32], reach: int) -> NDArray[np.bool_]:
    """Whether a saturated pixel lies within `reach` of each peak."""
    rows, cols = mask.shape
    out = np.zeros(peaks.shape[0], dtype=np.bool_)
    for n in range(peaks.shape[0]):
        row, col = int(peaks[n, 0]), int(peaks[n, 1])
        for i in range(max(0, row - reach), min(rows, row + reach + 1)):
            for j in range(max(0, col - reach), min(cols, col + reach + 1)):
                if mask[i, j] & 4:
                    out[n] = True
    return out


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
            hits += np.int32((line[col] & 4) != 0)
        if hits == 0:
            continue
        for col in range(cols):
            if line[col] & 4:
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
    """Centre and one side of a Gaussian of unit sum, out to three sigma."""
    offsets = np.arange(max(2, math.ceil(3.0 * sigma_px)) + 1)
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
        peaks = np.empty((self.max_stars, 3), dtype=np.float32)
        sigma_nodes, tile_px = view.background.sigma_adu, view.background.tile_px
        count = find_peaks(view.residual_adu, sigma_nodes, tile_px, kernel, self.n_sigma * noise, peaks)
        peaks = peaks[:count]
        peaks = peaks[~near_saturation(view.mask, peaks, RIM_PX)]
        gain = view.header.gain_e_adu if view.header.gain_e_adu is not None else 1.0
        variance = view.psf_sigma_px**2 + 1.0 / 12.0
        fits, flags = np.empty((len(peaks), 5)), np.zeros(len(peaks), dtype=np.uint8)
        shape_inverse = (1.0 / variance, 0.0, 1.0 / variance)
        radius = max(3, math.ceil(3.5 * view.psf_sigma_px))
        fit_stars(view.residual_adu, view.mask, sigma_nodes, tile_px, peaks, shape_inverse, radius, gain, fits, flags)
        psf_contrast = 1.0 - math.exp(-0.5 / variance)
        sharp = fits[:, 4] - COSMIC_SHARPNESS * psf_contrast > 5.0 / np.maximum(fits[:, 3], 1.0)
        flags[sharp] |= np.uint8(StarFlag.COSMIC_LIKE)
        saturation = view.header.saturation_adu if view.header.saturation_adu is not None else 65535.0
        bright = saturated_stars(view, saturation)
        bright_snr = bright[:, 2] / max(float(np.median(sigma_nodes)) * math.sqrt(4.0 * math.pi * variance), 1e-9)
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


def best_spread(stars: StarList, shape: tuple[int, int], number: int, cells: int = 8) -> NDArray[np.intp]:
    """Indices of up to `number` stars for a camera solution: the brightest of each of cells x cells fields in turn.

    Clean stars go before blended ones and those with defects or edges in their window; saturated and cosmic-like
    entries come last.
    """
    if len(stars) == 0 or number == 0:
        return np.zeros(0, dtype=np.intp)
    worst = StarFlag.SATURATED | StarFlag.COSMIC_LIKE
    poor = StarFlag.EDGE | StarFlag.DEFECT | StarFlag.BLENDED
    grade = np.where(stars.flags & worst, 2, np.where(stars.flags & poor, 1, 0))
    cell_row = np.clip(stars.row * cells / shape[0], 0, cells - 1).astype(np.intp)
    cell_col = np.clip(stars.col * cells / shape[1], 0, cells - 1).astype(np.intp)
    cell = cell_row * cells + cell_col
    order = np.lexsort((-stars.flux_e, grade, cell))
    first = np.concatenate(([True], cell[order][1:] != cell[order][:-1]))
    start = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    turn = np.arange(len(order)) - start
    chosen = order[np.lexsort((-stars.flux_e[order], turn, grade[order]))][:number]
    return np.sort(chosen)
