"""A sky whose stars are the trails: they are taken out as the star list has them, and what stands still is the object.

The star list says how the stars moved during the exposure (`StarMotion`), and holds points that did not beside them. No star can
be a point then, so no earlier frame is needed to tell an object from one; a line along the motion is a star, or several in a row.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import star_mask, whiten
from onboard.detect.line_integral import halos, point_movers
from onboard.detect.line_integral.sharpness import measured_width_px
from onboard.detect.line_integral.star_removal import TILE_PX, WorkingImages
from onboard.stars.trail_map import paint_trails
from sboc_e2e.icd.flags import StarFlag, StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView, StarMotion

ALONG_PX: Final = 4.0
"""A line whose ends lie no farther from the stars' direction through its middle runs along it ..."""

MOST_LENGTHS: Final = 4.0
"""... and is no object when it is shorter than so many trails: longer rows of stars are not found by chance."""

MOST_HIDDEN: Final = 0.35
"""A line as short as that with this share of it on masks of trails is what they left over."""

BEFORE_THE_SEARCH: Final = 0xFF ^ whiten.FOUND_BIT ^ whiten.POINT_BIT
"""Bits that the search does not set: pixels that must not be used, and trails of listed stars."""

BESIDE_PX: Final = 3.0  # what the fit of a trail misses at its rim lies within the PSF of it, 3.4 sigma. Chosen, not measured
SURE_SNR: Final = 40.0
"""Points so near to masked pixels are what a mask left over, unless they are brighter."""

SIDE_PX: Final = 4.0  # the point's own light is gone: exp(-r^2 / 2 s^2) is 7e-5 for s^2 = 0.87^2 + 1/12
MOST_SIDE_PX: Final = 14.0  # ten places make the median; more would reach neighbouring stars. Chosen, not measured
SIDE_SHARE: Final = 0.2
"""A point is part of a trail when from SIDE_PX on, to one side along the stars' motion, pixels hold this share of its peak."""

NOT_AN_OBJECT: Final = int(StarFlag.TRAILED | StarFlag.EDGE | StarFlag.BLENDED | StarFlag.DEFECT | StarFlag.SATURATED)


def working_images(view: DetectorView, motion: StarMotion, *, halo_px: float) -> WorkingImages:
    """Noise-normalised image of a view without the trails of its stars, and without the points, which are `new`.

    halo_px : growth of the masks of bright points, see `star_mask.mask_radii_px`.
    """
    stars, psf_sigma_px = view.stars, view.psf_sigma_px
    image = whiten.quantise(view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px)
    blocked = whiten.unusable(view.mask)
    across = star_mask.pieces_across(
        view.residual_adu,
        view.background.sigma_adu,
        view.background.tile_px,
        stars.row,
        stars.col,
        *motion.at(stars.row, stars.col),
    )
    trailed = ((stars.flags & int(StarFlag.TRAILED)) != 0) & ~across
    row, col = stars.row[trailed], stars.col[trailed]
    half = 0.5 * np.column_stack(motion.at(row, col))
    paint_trails(blocked, row, col, half, stars.snr[trailed], measured_width_px(view), whiten.STAR_BIT)
    points = np.flatnonzero(((stars.flags & NOT_AN_OBJECT) == 0) & ~across)
    beside = _beside(blocked, stars.row[points], stars.col[points]) & (stars.snr[points] < SURE_SNR)
    lit = _on_lines(view, stars.row[points], stars.col[points], motion)
    cut = _near_edge(view.mask.shape, stars.row[points], stars.col[points], motion) & (stars.snr[points] < SURE_SNR)
    new = points[~beside & ~lit & ~cut]
    fraction = point_movers.peak_fraction(measured_width_px(view))
    sharp = point_movers.sharper_than_psf(
        view.residual_adu,
        view.background.sigma_adu,
        view.background.tile_px,
        stars.row[new],
        stars.col[new],
        stars.snr[new],
        fraction,
    )
    sharp |= (stars.flags[new] & int(StarFlag.COSMIC_LIKE)) != 0
    still = np.flatnonzero(~trailed & ~across)
    radii = star_mask.mask_radii_px(stars.snr[still], psf_sigma_px, halo_px)
    whiten.blank_discs(image, blocked, stars.row[still], stars.col[still], radii)
    image[blocked != 0] = 0
    level = whiten.local_level(image, blocked, TILE_PX)
    return WorkingImages(
        image=image,
        blocked=blocked,
        level=level,
        stars=trailed,
        subtracted=np.zeros((0, 3)),
        halos=halos.none(),
        new=new,
        sharp=sharp,
    )


def _beside(blocked: NDArray[np.uint8], row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which places (n,) lie beside a mask, but not on it: a bright point on a trail has been told from it already."""
    rows, cols = blocked.shape
    near = np.zeros(len(row), np.bool_)
    for k in range(8):
        angle = 0.25 * math.pi * k
        i = np.clip(np.rint(row + BESIDE_PX * math.sin(angle)), 0, rows - 1).astype(np.intp)
        j = np.clip(np.rint(col + BESIDE_PX * math.cos(angle)), 0, cols - 1).astype(np.intp)
        near |= (blocked[i, j] & whiten.STAR_BIT) != 0
    i, j = (np.clip(np.rint(at), 0, n - 1).astype(np.intp) for at, n in ((row, rows), (col, cols)))
    return np.asarray(near & ((blocked[i, j] & whiten.STAR_BIT) == 0))


def _on_lines(view: DetectorView, row: NDArray[np.float64], col: NDArray[np.float64], motion: StarMotion) -> NDArray[np.bool_]:
    """Which places (n,) go on along the stars' motion: pieces of trails that another one hid, (n,)."""
    rows, cols = view.residual_adu.shape
    d_row, d_col = motion.at(row, col)
    length = np.maximum(np.hypot(d_row, d_col), 1e-6)

    def light(along: NDArray[np.float64]) -> NDArray[np.float64]:
        """Image at distances (n,) along the motion."""
        i = np.clip(np.rint(row + along * d_row / length), 0, rows - 1).astype(np.intp)
        j = np.clip(np.rint(col + along * d_col / length), 0, cols - 1).astype(np.intp)
        return np.asarray(view.residual_adu[i, j], dtype=np.float64)

    # a little less than the brightest pixel, which need not be the nearest one
    peak = np.max([light(np.full(len(row), float(k))) for k in (-1, 0, 1)], axis=0)
    sides = []
    for sign in (-1.0, 1.0):
        values = [light(sign * np.minimum(k, length)) for k in np.arange(SIDE_PX, MOST_SIDE_PX, 1.0)]
        sides.append(np.median(values, axis=0))
    return np.asarray((np.max(sides, axis=0) > SIDE_SHARE * peak) & (length > SIDE_PX))


def _near_edge(
    shape: tuple[int, ...], row: NDArray[np.float64], col: NDArray[np.float64], motion: StarMotion
) -> NDArray[np.bool_]:
    """Which places (n,) are so near to the frame's edge that they may be the rest of a trail that lies beyond it."""
    reach = np.maximum(np.hypot(*motion.at(row, col)), SIDE_PX)
    return np.asarray((row < reach) | (col < reach) | (row > shape[0] - 1 - reach) | (col > shape[1] - 1 - reach))


def is_star(detection: Detection, motion: StarMotion) -> bool:
    """Whether a line runs along the stars' motion at its place and is no longer than a few of their trails."""
    middle = np.array([0.5 * (detection.row0 + detection.row1)]), np.array([0.5 * (detection.col0 + detection.col1)])
    d_row, d_col = (float(part[0]) for part in motion.at(*middle))
    length = math.hypot(d_row, d_col)
    if length == 0.0 or detection.length_px > MOST_LENGTHS * length:
        return False
    across = abs((detection.row1 - detection.row0) * d_col - (detection.col1 - detection.col0) * d_row) / length
    return 0.5 * across < ALONG_PX


def is_left_over(detection: Detection, blocked: NDArray[np.uint8], motion: StarMotion) -> bool:
    """Whether much of a line lies on the masks of trails: what they leave of two stars makes one, no longer than they are.

    blocked : (rows, cols) bits of `whiten`. An object crosses trails; as long as they are sparse enough to be listed, they hide
    little of its path.
    """
    n = 2 * math.ceil(detection.length_px) + 1
    row = np.clip(np.rint(np.linspace(detection.row0, detection.row1, n)), 0, blocked.shape[0] - 1).astype(np.intp)
    col = np.clip(np.rint(np.linspace(detection.col0, detection.col1, n)), 0, blocked.shape[1] - 1).astype(np.intp)
    hidden = float(np.mean((blocked[row, col] & BEFORE_THE_SEARCH) != 0))
    middle = np.array([0.5 * (detection.row0 + detection.row1)]), np.array([0.5 * (detection.col0 + detection.col1)])
    length = math.hypot(*(float(part[0]) for part in motion.at(*middle)))
    return hidden > MOST_HIDDEN and detection.length_px < MOST_LENGTHS * length


def still_points(view: DetectorView, images: WorkingImages, n_sigma: float) -> list[Detection]:
    """Points of the star list that stand still while the stars trail and are as wide as the PSF."""
    stars = view.stars
    return [
        Detection(
            row0=float(stars.row[k]),
            col0=float(stars.col[k]),
            row1=float(stars.row[k]),
            col1=float(stars.col[k]),
            snr=float(stars.snr[k]),
            flags=StreakFlag.POINT_LIKE,
        )
        for k in images.new[~images.sharp]
        if stars.snr[k] > n_sigma
    ]
