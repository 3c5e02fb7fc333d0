"""Light around bright stars as it is, not as a law has it: measured ring by ring, masked where it is bright, subtracted beyond.

An aureole is a property of the optics and their dust, a bled column one of the sensor. A mask by a law of the brightness is too
small for one telescope, so that tangents to its rim look like trails, and for another hides trails that could be seen.
"""

import math
from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.line_integral.kept_frame import BEYOND
from onboard.detect.line_integral.static_sky import lit_pixels
from onboard.detect.whiten import UNIT, blank_discs
from sboc_e2e.icd.signals import StarList
from sboc_e2e.icd.work import Work, WorkMeter

HALO_SNR: Final = 1000.0
"""Fainter stars have the halo of the law: theirs is not brighter than the noise of a ring."""

RING_PX: Final = 3.0
"""Width of a ring: at 7 px from the star the median of its pixels is good to 0.11 sigma."""

RINGS: Final = 64
"""Most rings of a star."""

RING_WORK: Final = 500  # its histogram of 256 values is cleared and walked through ...
PIXEL_WORK: Final = 2.0 * math.pi * RING_PX * 3.0
"""Operations of a ring: its histogram, and three for each of its pixels."""

MOST_HALOS: Final = 24
"""So many of the brightest ones near a segment are added up."""

MASKED_SIGMA: Final = 1.0
"""Rings brighter than this are masked; the noise of fainter light, at most a third of the sky's variance, is divided out."""

FADED_SIGMA: Final = 0.1
"""A halo ends at the first ring that is fainter."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Halos:
    """Light that was subtracted beside masks: centre (n, 2) row, col; inner_px (n,) radius of the mask.

    light : (n, RINGS + 2) at inner_px + k RING_PX, sigma/16; 0 from the last ring on.
    """

    centre: NDArray[np.float64]
    inner_px: NDArray[np.float64]
    light: NDArray[np.float32]


@nb.njit(cache=True)
def _ring_median(
    image: NDArray[np.int8], blocked: NDArray[np.uint8], row: float, col: float, inner: float, outer: float
) -> float:
    """Median of the usable pixels of a ring, in units of the image; infinite where there are hardly any."""
    counts = np.zeros(256, np.int32)
    n = 0
    for i in range(max(0, math.ceil(row - outer)), min(image.shape[0] - 1, math.floor(row + outer)) + 1):
        d2 = (i - row) ** 2
        far, near = math.sqrt(max(outer * outer - d2, 0.0)), math.sqrt(max(inner * inner - d2, 0.0))
        for side in range(1 if near == 0.0 else 2):
            first, last = (
                (col - far, col + far) if near == 0.0 else (col - far, col - near) if side == 0 else (col + near, col + far)
            )
            for j in range(max(0, math.ceil(first)), min(image.shape[1] - 1, math.floor(last)) + 1):
                # saturated pixels are at the clip, and columns that bled are no halo
                if blocked[i, j] == 0 and image[i, j] < BEYOND:
                    counts[np.int32(image[i, j]) + 128] += 1
                    n += 1
    if n < 20:
        return math.inf
    below, k = 0, 0
    while below + counts[k] < 0.5 * n:
        below += counts[k]
        k += 1
    return k - 128.5 + (0.5 * n - below) / counts[k]


@nb.njit(cache=True)
def _subtract(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    row: float,
    col: float,
    inner: float,
    outer: float,
    light: NDArray[np.float32],
    per_sigma: float,
) -> None:
    for i in range(max(0, math.ceil(row - outer)), min(image.shape[0] - 1, math.floor(row + outer)) + 1):
        d2 = (i - row) ** 2
        far = math.sqrt(max(outer * outer - d2, 0.0))
        for j in range(max(0, math.ceil(col - far)), min(image.shape[1] - 1, math.floor(col + far)) + 1):
            if blocked[i, j] == 0:
                here = light_at(math.sqrt(d2 + (j - col) ** 2), inner, light)
                value = (image[i, j] - here) / math.sqrt(1.0 + max(here, 0.0) * per_sigma)
                image[i, j] = np.int8(math.floor(min(max(value, -127.0), 127.0) + 0.5))


@nb.njit(cache=True)
def light_at(radius: float, inner: float, light: NDArray[np.float32]) -> float:
    """Light of one halo at a distance from its star: linear between the radii of the table."""
    x = (radius - inner) / RING_PX
    if x < 0.0 or x >= light.shape[0] - 1:
        return 0.0
    k = int(x)
    return float(light[k] + (x - k) * (light[k + 1] - light[k]))


@nb.njit(cache=True, nogil=True)
def measure_and_take_out(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    core_px: NDArray[np.float64],
    inner: NDArray[np.float64],
    light: NDArray[np.float32],
    sigma_e: float,
    most_work: int,
) -> tuple[int, int]:
    """Rings around stars (n,) from core_px on, brightest star first: mask them or subtract their light, in place.

    Fills inner (n,) and light (n, RINGS + 2) as in `Halos`. Returns the operations done, and how many stars were left with the
    mask of their core when `most_work` of them were.
    """
    medians = np.empty(RINGS)
    work = 0
    for s in range(row.shape[0]):
        if work > most_work:
            blank_discs(image, blocked, row[s:], col[s:], core_px[s:])
            return work, row.shape[0] - s
        n, masked = 0, 0
        while n < RINGS:
            r = core_px[s] + n * RING_PX
            work += RING_WORK + int(PIXEL_WORK * r)
            medians[n] = _ring_median(image, blocked, row[s], col[s], r, r + RING_PX)
            if not medians[n] > FADED_SIGMA * UNIT:
                break
            if medians[n] > MASKED_SIGMA * UNIT:
                masked = n + 1
            n += 1
        inner[s] = core_px[s] + masked * RING_PX
        blank_discs(image, blocked, row[s : s + 1], col[s : s + 1], inner[s : s + 1])
        if n == masked:
            continue
        # medians are those of the middle of rings, the table holds their edges
        for k in range(n - masked + 1):
            before = medians[masked + k - 1] if masked + k > 0 else medians[masked]
            after = medians[masked + k] if masked + k < n else 0.0
            light[s, k] = np.float32(0.5 * (min(before, 127.0) + min(after, 127.0)))
        _subtract(
            image, blocked, row[s], col[s], inner[s], inner[s] + (n - masked + 1) * RING_PX, light[s], 1.0 / (UNIT * sigma_e)
        )
        work += int(PIXEL_WORK * (inner[s] + n * RING_PX) * (n - masked))
    return work, 0


def take_out(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    stars: StarList,
    chosen: NDArray[np.intp],
    core_px: NDArray[np.float64],
    sigma_e: float,
    work: WorkMeter,
) -> Halos:
    """Mask the halos of some stars as far as they are bright and subtract the rest, in place.

    chosen, core_px : indices (n,) of the stars, and radii that are masked already. sigma_e : noise of a pixel, e-.
    """
    brightest_first = np.argsort(-stars.snr[chosen], kind="stable")
    chosen, core_px = chosen[brightest_first], core_px[brightest_first]
    row, col = stars.row[chosen], stars.col[chosen]
    inner, light = np.zeros(len(chosen)), np.zeros((len(chosen), RINGS + 2), np.float32)
    done, not_measured = measure_and_take_out(image, blocked, row, col, core_px, inner, light, sigma_e, work.left(Work.HALOS))
    work.spend(Work.HALOS, done)
    work.leave(Work.HALOS, not_measured)
    left = light.any(axis=1)
    return Halos(centre=np.column_stack([row, col])[left], inner_px=inner[left], light=light[left])


def none() -> Halos:
    """No halos."""
    return Halos(centre=np.zeros((0, 2)), inner_px=np.zeros(0), light=np.zeros((0, RINGS + 2), np.float32))


@nb.njit(cache=True)
def _light_on(
    at_row: NDArray[np.int32],
    at_col: NDArray[np.int32],
    profile: NDArray[np.float64],
    row: float,
    col: float,
    inner: float,
    light: NDArray[np.float32],
) -> float:
    total = 0.0
    for k in range(profile.size):
        total += profile[k] * light_at(math.hypot(at_row[k] - row, at_col[k] - col), inner, light)
    return total


def subtracted_snr(
    halos: Halos,
    transform: NDArray[np.float64],
    blocked: NDArray[np.uint8],
    ignored: int,
    ends: NDArray[np.float64],
    psf_sigma_px: float,
) -> float:
    """S/N that the light of halos, centred at the mapped places, adds to a segment (row0, col0, row1, col1)."""
    reach = RING_PX * (RINGS + 1) + halos.inner_px
    row = transform[0, 0] * halos.centre[:, 0] + transform[0, 1] * halos.centre[:, 1] + transform[0, 2]
    col = transform[1, 0] * halos.centre[:, 0] + transform[1, 1] * halos.centre[:, 1] + transform[1, 2]
    near = (row > min(ends[0], ends[2]) - reach) & (row < max(ends[0], ends[2]) + reach)
    near &= (col > min(ends[1], ends[3]) - reach) & (col < max(ends[1], ends[3]) + reach)
    if not near.any():
        return 0.0
    at_row, at_col, profile = lit_pixels(blocked, ignored, ends, psf_sigma_px)
    light = sum(
        _light_on(at_row, at_col, profile, row[k], col[k], halos.inner_px[k], halos.light[k])
        for k in np.flatnonzero(near)[:MOST_HALOS]
    )
    return float(light / (UNIT * max(math.sqrt(float(np.sum(profile**2))), 1e-9)))
