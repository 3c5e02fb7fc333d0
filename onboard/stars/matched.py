"""Star list: matched-filter peaks, maximum-likelihood fits, saturated stars; and the choice of the stars to send."""

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.stars.fits import BLENDED, SATURATED, SATURATED_STAR, fit_stars
from onboard.stars.peaks import find_peaks, gaussian_kernel
from onboard.stars.shape import LEAST_STARS, MOST_STARS, FieldShape, measure_shape
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import DetectorView, StarList, StarMotion
from sboc_e2e.icd.work import Work, WorkMeter

COSMIC_SHARPNESS = 1.7
"""A peak is sharper than a star when its contrast exceeds the PSF's by this factor at 5 sigma significance."""

NOT_A_STAR = 0.2
"""Relative misfit of the PSF above which something else lies in the window: a neighbour, or a particle's track."""

CANDIDATES_PER_STAR = 40
"""Candidates for the choice of well-spread stars, as a multiple of the wanted number; the brightest are taken."""

SHAPE_SNR = 40.0
"""Stars above this S/N show the shape of the PSF."""

LONG_TRAIL_PX = 4.0
"""Longer trails are not near enough to Gaussians; they get a template of their own."""

ENOUGH_SETTLED = 0.4
"""If fewer of the bright stars than this share have the moments of a star, they are examined as trails ..."""

ENOUGH_POINTS = 0.15
"""... unless at least this share has the shape of a point. Then stars do not move, and trails are objects or particles."""

LEAST_TRAIL_SIGMA = 6.0  # above the 5 of points: a longer sum meets more neighbours. Chosen, not measured
MOST_BRIGHT_TRAILS = 60  # tried for the fit of the motion: five for each of the 12 that it wants
MOST_TRAILS = 60_000  # room: a full field, 3,600 per megapixel, of 4096 x 4096 pixels

FITTED_TRAILS = 600
"""Trails that are fitted, the brightest of each of `CELLS` x CELLS parts of the frame in turn; the others keep their pixel."""

CELLS = 8  # parts along either axis, so that a cluster in one leaves stars to 63. Chosen, not measured

MOTION_SHARE = 0.2
"""Share of the work for stars after which the search for a motion of all of them ends."""

LIST_WORK = 1_000.0  # operations of an entry of the list ...
FIT_WORK = 3_500.0  # ... and operations of its fit ...
LISTED_SHARE = 0.4
"""Operations of an entry of the list (looked up in the frame before, masked or subtracted) and of its fit; and the share of the
work for stars that is kept for entries."""

TOLD_APART_PX = 16.0
"""If stars move by less, a point may be a star, or the visible part of a star next to a brighter trail."""

TRAILED_OVER_PSF = 2.0
"""Stars are called trailed when the smear is longer than this many PSF sigmas."""


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
def _root(parent: NDArray[np.int32], k: int) -> np.int32:
    a = np.int32(k)
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit(cache=True)
def group_pixels(pixels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Number of the first pixel of each pixel's group; pixels within two rows and two cols of each other are one. Row order.

    By runs of a row, each held against those of the two rows before: work grows as the number of pixels.
    """
    n = pixels.shape[0]
    start, parent, out = np.empty(n + 1, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    runs = 0
    for k in range(n):
        if k == 0 or pixels[k, 0] != pixels[k - 1, 0] or pixels[k, 1] > pixels[k - 1, 1] + 2:
            start[runs], parent[runs] = k, runs
            runs += 1
    start[runs] = n
    for back in range(1, 3):
        other = 0
        for run in range(runs):
            row, left, right = pixels[start[run], 0], pixels[start[run], 1] - 2, pixels[start[run + 1] - 1, 1] + 2
            # what ends before this run begins, or lies in an earlier row, meets no later run either
            while pixels[start[other], 0] < row - back or (
                pixels[start[other], 0] == row - back and pixels[start[other + 1] - 1, 1] < left
            ):
                other += 1
            k = other
            while pixels[start[k], 0] == row - back and pixels[start[k], 1] <= right:
                a, b = _root(parent, run), _root(parent, k)
                parent[max(a, b)] = min(a, b)
                k += 1
    for run in range(runs):
        first = start[_root(parent, run)]
        for k in range(start[run], start[run + 1]):
            out[k] = first
    return out


def saturated_stars(view: DetectorView, saturation_adu: float, capacity: int = 200_000) -> NDArray[np.float64]:
    """Centres and least fluxes, (n, 3) row, col, flux ADU, of groups of saturated pixels."""
    pixels = saturated_pixels(view.mask, capacity)
    if len(pixels) == 0:
        return np.zeros((0, 3))
    groups, index = np.unique(group_pixels(pixels), return_inverse=True)
    number = np.bincount(index, minlength=len(groups))
    row = np.bincount(index, weights=pixels[:, 0]) / number
    col = np.bincount(index, weights=pixels[:, 1]) / number
    return np.column_stack((row, col, 2.0 * number * saturation_adu))


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
        gain = view.header.gain_e_adu if view.header.gain_e_adu is not None else 1.0
        sigma = float(np.median(sigma_nodes))
        candidates = _shape_stars(peaks, noise * sigma)
        nominal = FieldShape.nominal(view.psf_sigma_px, view.mask.shape)
        shape, share, like_point = measure_shape(view.residual_adu, view.mask, candidates, nominal)
        apart = shape.smear_px > LONG_TRAIL_PX or share < ENOUGH_SETTLED
        if len(candidates) >= LEAST_STARS and apart and like_point.mean() < ENOUGH_POINTS:
            stars = self._trailed(view, peaks, candidates, like_point, sigma, gain)
            if stars is not None:
                return stars
        peaks, n_fitted = within_work(peaks, view.mask.shape, view.work)
        fits, flags, width = self._points(view, peaks[:n_fitted], shape, gain)
        if n_fitted < len(peaks):
            unfitted = as_they_are(peaks[n_fitted:], noise * sigma, width)
            fits = np.vstack((fits, unfitted))
            flags = np.concatenate((flags, np.full(len(unfitted), BLENDED, np.uint8)))
        trailed = shape.smear_px > TRAILED_OVER_PSF * shape.sigma_px
        if trailed:
            flags |= np.uint8(StarFlag.TRAILED)
        saturation = view.header.saturation_adu if view.header.saturation_adu is not None else 65535.0
        bright = saturated_stars(view, saturation)
        bright_snr = bright[:, 2] / max(sigma * math.sqrt(4.0 * math.pi) * width, 1e-9)
        bright_flags = np.full(len(bright), int(StarFlag.SATURATED), dtype=np.uint8)
        every = np.vstack((fits[:, :4], np.column_stack((bright, bright_snr))))
        measured = shape.sigma_px if shape.n_stars > 0 and not trailed else None
        return by_flux(every, np.concatenate((flags, bright_flags)), gain, measured)

    def _points(
        self, view: DetectorView, peaks: NDArray[np.float32], shape: FieldShape, gain_e_adu: float
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], float]:
        """Fits (n, 6) and flags of peaks as stars of a shape, but for the rim of saturated ones; and the shape's width."""
        covariances = shape.covariance(peaks)
        fits, flags = np.empty((len(peaks), 6)), np.zeros(len(peaks), dtype=np.uint8)
        width = math.sqrt(float(shape.coefficients[[0, 2], 0].max()))
        radii = (max(2, math.ceil(2.0 * width)), max(3, math.ceil(3.0 * width)))
        nodes = view.background.sigma_adu
        fit_stars(
            view.residual_adu, view.mask, nodes, view.background.tile_px, peaks, covariances, radii, gain_e_adu, fits, flags
        )
        # Peaks next to saturated pixels belong to the rim of the saturated star, which has its own entry.
        clean = (flags & SATURATED_STAR) == 0
        fits, flags, covariances = fits[clean], flags[clean], covariances[clean]
        psf_contrast = 1.0 - 0.5 * (np.exp(-0.5 / covariances[:, 0]) + np.exp(-0.5 / covariances[:, 2]))
        sharp = fits[:, 4] - COSMIC_SHARPNESS * psf_contrast > 5.0 / np.maximum(fits[:, 3], 1.0)
        flags[sharp] |= np.uint8(StarFlag.COSMIC_LIKE)
        flags[fits[:, 5] > NOT_A_STAR] |= np.uint8(StarFlag.BLENDED)
        return fits, flags, width

    def _points_among_trails(
        self,
        view: DetectorView,
        peaks: NDArray[np.float32],
        bright: NDArray[np.float32],
        painted: NDArray[np.uint8],
        motion: StarMotion,
        gain_e_adu: float,
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Fits (n, 4) and flags of points that do not move while the stars trail: between the trails, and bright points on them.

        painted : 1 on trails. Where the stars themselves hardly move points are stars, flagged TRAILED as the others are.
        """
        row, col = peaks[:, 0].astype(np.intp), peaks[:, 1].astype(np.intp)
        on_trail = painted[row, col] != 0
        keys = row * view.mask.shape[1] + col
        on_trail &= ~np.isin(keys, bright[:, 0].astype(np.intp) * view.mask.shape[1] + bright[:, 1].astype(np.intp))
        nominal = FieldShape.nominal(view.psf_sigma_px, view.mask.shape)
        beside, n_fitted = within_work(peaks[~on_trail], view.mask.shape, view.work)
        fits, flags, _ = self._points(view, beside[:n_fitted], nominal, gain_e_adu)
        fits, flags = fits[(flags & BLENDED) == 0], flags[(flags & BLENDED) == 0]  # pieces of blends of trails
        still = np.hypot(*motion.at(fits[:, 0], fits[:, 1])) < TOLD_APART_PX
        flags[still] |= np.uint8(StarFlag.TRAILED)
        return fits[:, :4], flags

    def _trailed(
        self,
        view: DetectorView,
        peaks: NDArray[np.float32],
        bright: NDArray[np.float32],
        like_point: NDArray[np.bool_],
        sigma_adu: float,
        gain_e_adu: float,
    ) -> StarList | None:
        """Stars of a frame whose pointing moved by more than a few pixels; None when its stars share no such motion.

        Where more points stand still than trails share the motion, the points are the stars and the trails are objects: a few
        bright ones side by side outshine the stars of a poor field.
        peaks : of the frame as if stars were points. bright, like_point : the brightest, and which of them are points.
        """
        # kernels that frames with stars as points need not load
        from onboard.stars import star_motion, trail_fits, trail_peaks, trail_vectors, trails

        psf_sigma_px = math.sqrt(view.psf_sigma_px**2 + 1.0 / 12.0)
        threshold = max(self.n_sigma, LEAST_TRAIL_SIGMA)
        view.work.spend(Work.STARS, star_motion.VOTE_WORK)
        motion, places = star_motion.first_motion(view.residual_adu, _brightest_first(peaks), psf_sigma_px)
        if motion is None or not LONG_TRAIL_PX < star_motion.longest_px(motion) < trail_peaks.LONGEST_PX:
            return None
        some, most_work = places[:MOST_BRIGHT_TRAILS], MOTION_SHARE * view.work.left(Work.STARS)
        *fitted, work = trail_vectors.fitted_vectors(view.residual_adu, view.mask, some, motion, psf_sigma_px, most_work)
        view.work.spend(Work.STARS, work)
        motion = star_motion.refined_motion(fitted[0], fitted[1], motion)
        if motion is None:
            return None
        width = float(min(max(np.median(fitted[2]), 0.4), 3.0 * psf_sigma_px))
        found, half, painted = trails.matched_trails(view, motion, width, threshold, MOST_TRAILS, sigma_adu)
        view.work.spend(Work.STARS, trail_peaks.sum_work(motion, view.mask.shape))
        room = view.work.room(Work.STARS, trail_fits.fit_work(motion, width), 0.5)
        chosen = _turns(found, view.mask.shape) < min(FITTED_TRAILS, room)
        view.work.spend(Work.STARS, trail_fits.fit_work(motion, width) * np.count_nonzero(chosen))
        view.work.leave(Work.STARS, max(0, min(FITTED_TRAILS, len(found)) - int(np.count_nonzero(chosen))))
        fits, flags = trails.listed(view, found, half, width, sigma_adu, gain_e_adu, chosen)
        points, point_flags = self._points_among_trails(view, peaks, bright[like_point], painted, motion, gain_e_adu)
        still = (point_flags & np.uint8(StarFlag.TRAILED | StarFlag.COSMIC_LIKE)) == 0
        if np.count_nonzero(still & (points[:, 3] >= threshold)) > len(fits):
            return None
        return by_flux(np.vstack((fits, points)), np.concatenate((flags, point_flags)), gain_e_adu, motion=motion)


def within_work(peaks: NDArray[np.float32], shape: tuple[int, int], work: WorkMeter) -> tuple[NDArray[np.float32], int]:
    """The peaks (n, 5) that are listed, and how many of them, the first ones, are fitted; all, as they come, where work allows.

    Beyond that the brightest of each part of the frame in turn, so that a cluster or a storm in one leaves stars to the others.
    """
    listed = min(len(peaks), work.room(Work.STARS, LIST_WORK, LISTED_SHARE))
    fitted = min(listed, work.room(Work.STARS, FIT_WORK, 1.0 - LISTED_SHARE))
    if fitted < len(peaks):
        work.leave(Work.STARS, len(peaks) - fitted)
        peaks = _brightest_first(peaks)
        peaks = peaks[np.argsort(_turns(peaks, shape), kind="stable")[:listed]]
    work.spend(Work.STARS, LIST_WORK * listed + FIT_WORK * fitted)
    return peaks, fitted


def as_they_are(peaks: NDArray[np.float32], noise_adu: float, width_px: float) -> NDArray[np.float64]:
    """Rows (n, 6) as of fits for peaks (n, 5) that are not fitted: place of the parabola, flux from the smoothed value.

    noise_adu : of the smoothed image. The flux of a star of S/N S is S sigma sqrt(4 pi) s.
    """
    out = np.zeros((len(peaks), 6))
    out[:, :2] = peaks[:, :2] + np.clip(peaks[:, 3:5], -1.0, 1.0)
    out[:, 3] = peaks[:, 2] / max(noise_adu, 1e-9)
    out[:, 2] = 1.7 * peaks[:, 2] * 2.0 * math.pi * width_px**2
    return out


def _turns(peaks: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Rank (n,) of peaks (n, >= 2), brightest first as they come, when `CELLS` x `CELLS` parts of the frame take turns."""
    cell = (peaks[:, 0] * CELLS // shape[0]).astype(np.intp) * CELLS + (peaks[:, 1] * CELLS // shape[1]).astype(np.intp)
    order = np.argsort(cell, kind="stable")
    turn = np.empty(len(peaks), np.intp)
    turn[order] = np.arange(len(peaks)) - np.searchsorted(cell[order], cell[order], side="left")
    rank = np.empty(len(peaks), np.intp)
    rank[np.argsort(turn, kind="stable")] = np.arange(len(peaks))
    return rank


def by_flux(
    fits: NDArray[np.float64],
    flags: NDArray[np.uint8],
    gain_e_adu: float,
    psf_sigma_px: float | None = None,
    motion: StarMotion | None = None,
) -> StarList:
    """Star list by falling flux of fits (n, 4): row, col, flux ADU, S/N."""
    order = falling(fits[:, 2])
    row, col, flux_adu, snr = (column[order] for column in fits.T)  # copies: a view would keep the table
    return StarList(
        row=row,
        col=col,
        flux_e=(flux_adu * gain_e_adu).astype(np.float32),
        snr=snr.astype(np.float32),
        flags=flags[order],
        psf_sigma_px=psf_sigma_px,
        motion=motion,
    )


def falling(values: NDArray[np.float64]) -> NDArray[np.intp]:
    """Order of falling values, equal ones as they come: a stable sort, in a third of its time where few are equal."""
    order = np.argsort(-values)
    ordered = values[order]
    same = np.concatenate(([False], ordered[1:] == ordered[:-1], [False]))
    tied = np.flatnonzero(same[1:] | same[:-1])
    order[tied] = order[tied][np.lexsort((order[tied], -ordered[tied]))]
    return order


def _brightest_first(peaks: NDArray[np.float32]) -> NDArray[np.float32]:
    """Peaks by falling value: many lie on one trail."""
    return peaks[np.argsort(-peaks[:, 2], kind="stable")]


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
