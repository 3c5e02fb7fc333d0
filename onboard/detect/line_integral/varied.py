"""Trails of objects that tumble: a line found where it is bright is followed to where it is dim, and bright again.

The template of the search is even along its length, so it stops where light falls. Beyond the ends of a clear trail its own line
is known: light along it needs no search over places and angles, and far less S/N.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.line_integral import trains
from onboard.detect.line_integral.local_noise import NEAREST_PX
from onboard.detect.line_integral.segments import with_edges
from onboard.detect.line_integral.star_removal import TILE_PX, WorkingImages
from onboard.detect.whiten import FOUND_BIT, UNIT
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView

LEAST_SNR: Final = 12.0
"""S/N of a trail, or a flash of one, whose line is known well enough to be followed."""

LEAST_LENGTH_PX: Final = 8.0
"""Shorter ones show no direction of their own."""

ROW: Final = 5
"""So many trails on one line are objects in a row, with S/N enough each to be found; a tumbler flashes less often."""

ON_LINE_PX: Final = 3.0  # across the line, for middles of other trails. Chosen, not measured

FOLLOW_SIGMA: Final = 4.0
"""S/N of light beyond an end that belongs to the trail. Places along a line give some ten trials: 3e-4 an end."""

VARIED_SIGMA: Final = 3.0
"""The same once light was found beyond an end: the object's light varies, and its ends are looked for."""

REACH_LENGTHS: Final = 1.5  # `MOST_STEPS` looks follow each other; a longer one meets more of other objects. Chosen, not measured
REACH_PX: Final = 30.0
"""A line is followed at once as far as this many of its lengths, and this much more."""

BEYOND_SIGMAS: Final = 2.0
"""In PSF sigmas beyond an end there is light of what lies within."""

MOST_STEPS: Final = 8
"""Each step begins at the ends and on the line that the one before gave."""

BESIDE: Final = 16
"""Lines beside a trail, half of them to each side, on which light is looked for as beyond its ends. Chosen, not measured."""
BESIDE_APART_PX: Final = 6.0
"""From one of them to the next; the first two are `local_noise.NEAREST_PX` away. Chosen, not measured."""
MOST_BRIGHTER: Final = 1
"""Lines beside that may show more than the trail's own: a star or another trail may lie on one of them. Chosen, not measured."""
LEAST_SHARE: Final = 0.2
"""Least brightness of light beyond an end, over that of the trail, where lines beside it show light too. Of 137 lines followed on
trails of pictures 50 had both ends within 6 px or 6 % of the length without this, and 63 with it; 38 if none is followed. It was
chosen in view of these: shares of 0.1 to 0.3 give 56 to 66."""


def followed(
    detections: Sequence[Detection], view: DetectorView, images: WorkingImages, psf_sigma_px: float, *, held_beside: bool = False
) -> list[Detection]:
    """The detections, clear trails with their ends where their light ends; pieces of one trail then lie on each other.

    held_beside : light beyond an end must exceed what the same look finds on lines beside the trail, and be as bright as
        `LEAST_SHARE` of it where those show light.
    """
    middles = np.array([(0.5 * (d.row0 + d.row1), 0.5 * (d.col0 + d.col1)) for d in detections]).reshape(-1, 2)
    out = []
    for detection in detections:
        longer = trail_followed(detection, images, psf_sigma_px, held_beside)
        # a piece of a row has less light than the row
        row = replace(longer, snr=max(longer.snr, trains.LEAST_SNR))
        in_row = longer is not detection and (
            _on(longer, middles) >= ROW or len(trains.taken_apart(row, view, images.blocked, psf_sigma_px)) > 1
        )
        out.append(detection if in_row else longer)
    return out


def _on(detection: Detection, middles: NDArray[np.float64]) -> int:
    """How many of some points (n, 2) lie on a detection."""
    length = detection.length_px
    u_row, u_col = (detection.row1 - detection.row0) / length, (detection.col1 - detection.col0) / length
    d_row, d_col = middles.T - np.array([[detection.row0], [detection.col0]])
    along, across = d_row * u_row + d_col * u_col, d_row * u_col - d_col * u_row
    bow = 4.0 * detection.sagitta_px * along / length * (1.0 - along / length)
    return int(np.count_nonzero((along > 0.0) & (along < length) & (np.abs(across - bow) < ON_LINE_PX)))


def trail_followed(detection: Detection, images: WorkingImages, psf_sigma_px: float, held_beside: bool) -> Detection:
    """One trail followed; as it was when nothing more is found."""
    if detection.snr < LEAST_SNR or detection.length_px < LEAST_LENGTH_PX or detection.flags & StreakFlag.COSMIC_LIKE:
        return detection
    least = FOLLOW_SIGMA
    for _ in range(MOST_STEPS):
        longer = _step(detection, images, psf_sigma_px, least, held_beside)
        if longer is None:
            break
        detection, least = longer, VARIED_SIGMA
    return detection


def _step(detection: Detection, images: WorkingImages, psf_sigma_px: float, least: float, held_beside: bool) -> Detection | None:
    """The detection after one look beyond both ends; None when there is nothing."""
    length = detection.length_px
    reach = math.ceil(REACH_LENGTHS * length + REACH_PX)
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    signal, power, moment = light_along(
        images.image, images.blocked, images.level, TILE_PX, ends, detection.sagitta_px, reach, psf_sigma_px
    )
    along = np.arange(len(signal), dtype=np.float64) - reach  # px from end 0
    after, before = _beyond(len(signal), reach, length, psf_sigma_px)
    more = _light_ends(signal[after], power[after], least)
    less = _light_ends(signal[before][::-1], power[before][::-1], least)
    if held_beside and not (more is None and less is None):
        most = _most_beside(detection, images, reach, psf_sigma_px)
        own = slice(reach, reach + math.ceil(length))
        least_bright = LEAST_SHARE * float(signal[own].sum()) / max(float(power[own].sum()), 1e-9)
        more = _held(signal[after], power[after], more, most[0], least_bright)
        less = _held(signal[before][::-1], power[before][::-1], less, most[1], least_bright)
    if more is None and less is None:
        return None
    stop = length if more is None else float(along[after][more])
    start = 0.0 if less is None else float(along[before][::-1][less])
    inside = (along >= start) & (along <= stop)
    shift, turn = _on_line(along[inside], signal[inside], moment[inside]) if detection.sagitta_px == 0.0 else (0.0, 0.0)
    u_row, u_col = (ends[2:] - ends[:2]) / length
    rows, cols = images.image.shape
    places = []
    for at in (start, stop):
        u = at / length
        across = shift + turn * at + 4.0 * detection.sagitta_px * u * (1.0 - u)
        row, col = ends[0] + at * u_row + across * u_col, ends[1] + at * u_col - across * u_row
        places += [float(np.clip(row, 0.0, rows - 1.0)), float(np.clip(col, 0.0, cols - 1.0))]
    grown = detection.sagitta_px * ((stop - start) / length) ** 2
    longer = replace(detection, row0=places[0], col0=places[1], row1=places[2], col1=places[3], sagitta_px=grown)
    return with_edges(longer, (rows, cols))


def _held(
    signal: NDArray[np.float64], power: NDArray[np.float64], end: int | None, most_beside: float, least_bright: float
) -> int | None:
    """The bin where light ends, if there is more of it than on lines beside the trail.

    It must be bright enough up to there, where those show light as well.
    """
    if end is None or _best_snr(signal, power) <= most_beside:
        return None
    up_to = slice(0, end + 1)
    bright = float(signal[up_to].sum()) >= least_bright * float(power[up_to].sum())
    return end if bright or most_beside < FOLLOW_SIGMA else None


def _most_beside(detection: Detection, images: WorkingImages, reach: int, psf_sigma_px: float) -> tuple[float, float]:
    """S/N of light beyond end 1 and end 0 that all lines beside a detection but `MOST_BRIGHTER` stay below."""
    length = detection.length_px
    across = np.array([detection.col1 - detection.col0, detection.row0 - detection.row1]) / length
    found = np.zeros((2, BESIDE))
    for k in range(BESIDE):
        shift = (NEAREST_PX + BESIDE_APART_PX * (k // 2)) * (1.0 if k % 2 else -1.0) * across
        ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1]) + np.tile(shift, 2)
        signal, power, _ = light_along(
            images.image, images.blocked, images.level, TILE_PX, ends, detection.sagitta_px, reach, psf_sigma_px
        )
        after, before = _beyond(len(signal), reach, length, psf_sigma_px)
        found[0, k] = _best_snr(signal[after], power[after])
        found[1, k] = _best_snr(signal[before][::-1], power[before][::-1])
    found.sort(axis=1)
    return float(found[0, -1 - MOST_BRIGHTER]), float(found[1, -1 - MOST_BRIGHTER])


def _beyond(n: int, reach: int, length_px: float, psf_sigma_px: float) -> tuple[slice, slice]:
    """Which of the n bins of `light_along` lie beyond end 1, and which before end 0: views of the sums, not copies."""
    first = math.floor(length_px + BEYOND_SIGMAS * psf_sigma_px) + 1 + reach
    return slice(first, n), slice(0, max(math.ceil(-BEYOND_SIGMAS * psf_sigma_px) + reach, 0))


def _snr_to(signal: NDArray[np.float64], power: NDArray[np.float64]) -> NDArray[np.float64]:
    """S/N of light that begins at the first bin, up to each one."""
    return np.asarray(np.cumsum(signal) / np.sqrt(np.maximum(np.cumsum(power), 1e-9)))


def _best_snr(signal: NDArray[np.float64], power: NDArray[np.float64]) -> float:
    """Largest S/N of light that begins at the first bin; 0 of no bins."""
    return float(np.max(_snr_to(signal, power), initial=0.0))


def _light_ends(signal: NDArray[np.float64], power: NDArray[np.float64], least: float) -> int | None:
    """The bin up to which light that begins here has the largest S/N; None when that is below `least`."""
    if not len(signal):
        return None
    snr = _snr_to(signal, power)
    best = int(np.argmax(snr))
    return best if snr[best] >= least else None


def _on_line(along: NDArray[np.float64], signal: NDArray[np.float64], moment: NDArray[np.float64]) -> tuple[float, float]:
    """Shift (px) at end 0 and turn (px for each px along) that bring a line onto its light.

    A Gaussian that is off by d, seen through one of the same width, has its mean at d / 2.
    """
    light = np.maximum(signal, 0.0)
    total = light.sum()
    if total <= 0.0:
        return 0.0, 0.0
    middle = float((light * along).sum() / total)
    spread = float((light * (along - middle) ** 2).sum())
    lit = signal > 0.0
    turn = 2.0 * float((moment * (along - middle))[lit].sum()) / max(spread, 1e-9)
    shift = 2.0 * float(moment[lit].sum() / total)
    return shift - turn * middle, turn


@nb.njit(cache=True)
def light_along(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    ends: NDArray[np.float64],
    sagitta_px: float,
    reach: int,
    psf_sigma_px: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Matched sums in bins of 1 px along a line (row0, col0, row1, col1), from `reach` px before end 0 to so many beyond end 1.

    Returns sum(g value), sum(g^2) and sum(g value across), values in sigma, across positive to (+col, -row) of the direction.
    """
    rows, cols = image.shape
    length = math.hypot(ends[2] - ends[0], ends[3] - ends[1])
    u_row, u_col = (ends[2] - ends[0]) / length, (ends[3] - ends[1]) / length
    n = 2 * reach + math.ceil(length) + 1
    signal, power, moment = np.zeros(n), np.zeros(n), np.zeros(n)
    half = 3.0 * psf_sigma_px
    factor = -0.5 / psf_sigma_px**2
    steep = abs(u_row) >= abs(u_col)
    onward = u_row < 0.0 if steep else u_col > 0.0
    along_major = abs(u_row) if steep else abs(u_col)
    change = math.exp(2.0 * factor * along_major**2)
    origin_major, origin_minor = (ends[0], ends[1]) if steep else (ends[1], ends[0])
    slope = (u_col / u_row) if steep else (u_row / u_col)
    way = u_row if steep else u_col
    n_major, n_minor = (rows, cols) if steep else (cols, rows)
    first, last = origin_major - reach * way, origin_major + (length + reach) * way
    low, high = max(0, math.ceil(min(first, last))), min(n_major - 1, math.floor(max(first, last)))
    for major in range(low, high + 1):
        at = (major - origin_major) / way
        u = at / length
        # the parabola of a bent trail, on the side of (+row, -col) turned from the chord
        bow = 4.0 * sagitta_px * u * (1.0 - u) / along_major
        centre = origin_minor + slope * (major - origin_major) + (bow if onward else -bow)
        k = math.floor(at + reach + 0.5)
        if not 0 <= k < n:
            continue
        lowest, highest = math.ceil(centre - half / along_major), math.floor(centre + half / along_major)
        lowest, highest = max(0, lowest), min(n_minor - 1, highest)
        # exp(-x^2) in equal steps of x: each value is the one before times a ratio, which itself changes by a constant factor
        off = (lowest - centre) * along_major
        g, ratio = math.exp(factor * off * off), math.exp(factor * along_major * (2.0 * off + along_major))
        tile, ground, left = major // tile_px, 0.0, 0
        for minor in range(lowest, highest + 1):
            i, j = (major, minor) if steep else (minor, major)
            if left == 0:  # the level is read once a tile
                ground = level[tile, minor // tile_px] if steep else level[minor // tile_px, tile]
                left = tile_px - minor % tile_px
            left -= 1
            if not blocked[i, j] & ~FOUND_BIT:
                off = (minor - centre) * along_major
                value = (image[i, j] - ground) / UNIT
                side = off if onward else -off
                signal[k] += g * value
                power[k] += g * g
                moment[k] += g * value * side
            g, ratio = g * ratio, ratio * change
    return signal, power, moment
