"""Whether a track stands without light that is not its own: other trails that its frames show by themselves, and stars left in.

The tracker searches images with those trails in them, since a faint object may be bright enough in one frame. Their light would
bear out any track that runs along them, or across them at a small angle. Stars that are left in: see `removed_stars`.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.image import registration
from onboard.track.corridor import path_sum
from onboard.track.same import SAME_PX
from onboard.track.trail_sums import path_variance, placed, trail_variance
from sboc_e2e.icd.signals import Detection

OWN_BEYOND: Final = 0.25
"""A frame's own detection may reach so far beyond the ends that a track foretells, in lengths of its trail. At S/N 7 an end errs
by a tenth. Chosen, not measured."""

STAR_SIGMAS: Final = 2.4
"""Of a star, pixels within so many PSF widths are left out: nine tenths of its light in the smoothed image."""

OWN_TILT: Final = 0.02  # of the length across, as tracks of one object may differ (`same.ACROSS_SHARE`)


class LitMember(NamedTuple):
    """A track's trail in a frame. snr : in the tracker's image, also below 0. image : as `packed.packed`. trails (m, 4) : row0,
    col0, row1, col1 of what the frame shows by itself. stars (n, 2) : row, col of stars that were left in it."""

    detection: Detection
    snr: float
    image: NDArray[np.uint64]
    trails: NDArray[np.float64]
    stars: NDArray[np.float64]


class OwnLight(NamedTuple):
    """Joint S/N of a track in light that nothing else explains, and the least that is left of it without one of its frames."""

    snr: float
    least: float


def own_light(members: Sequence[LitMember], old_snr: NDArray[np.float64], psf_sigma_px: float) -> OwnLight | None:
    """A track's own light, None where no other trail and no star lies on any of its members.

    old_snr (n,) : S/N in its frames whose pixels are no longer at hand; such a frame counts as much as a member.
    """
    foreign = [_foreign_pieces(member, STAR_SIGMAS * psf_sigma_px) for member in members]
    if not any(foreign):
        return None
    sums, weights = np.empty(len(members)), np.empty(len(members))
    for k, (member, pieces) in enumerate(zip(members, foreign, strict=True)):
        place, steep, unit = _path(member.detection, psf_sigma_px)
        total, weights[k] = path_sum(member.image, steep, place, 0.0, member.detection.length_px)
        sums[k] = member.snr * math.sqrt(weights[k])
        if pieces:
            beside = [path_sum(member.image, steep, place, low, high) for low, high in pieces]
            sums[k] = (total - sum(light for light, _ in beside)) / unit
            weights[k] -= sum(pixels for _, pixels in beside)
    weights = np.maximum(weights, 0.0)
    old = np.full(len(old_snr), float(weights.max(initial=1.0)))
    sums, weights = np.concatenate([old_snr * np.sqrt(old), sums]), np.concatenate([old, weights])
    rest = (sums.sum() - sums) / np.sqrt(np.maximum(weights.sum() - weights, 1.0))
    return OwnLight(float(sums.sum() / math.sqrt(max(weights.sum(), 1.0))), float(rest.min()))


def _path(detection: Detection, psf_sigma_px: float) -> tuple[NDArray[np.float64], bool, float]:
    """A trail's place for `path_sum`, from the end with the lower major coordinate; whether rows are major; the noise of a sum,
    for the root of a pixel."""
    line, place = _ends(detection), np.empty(4)
    steep = placed(line, registration.IDENTITY, place)
    per_lane = max(abs(place[2]), abs(place[3]))
    noise = trail_variance(*path_variance(psf_sigma_px, per_lane), per_lane * detection.length_px)
    return place, steep, math.sqrt(noise)


def _ends(detection: Detection) -> NDArray[np.float64]:
    """Ends (4,), first the one with the lower coordinate along the major axis."""
    d_row, d_col = detection.row1 - detection.row0, detection.col1 - detection.col0
    line = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    backward = d_row < 0.0 if abs(d_row) >= abs(d_col) else d_col < 0.0
    return line[[2, 3, 0, 1]] if backward else line


def _foreign_pieces(member: LitMember, star_px: float) -> list[tuple[float, float]]:
    """Pieces (px along the trail from `_ends`'s first) of a trail that lie in the light of others, or so near to stars."""
    detection, trails = member.detection, member.trails
    line = _ends(detection)
    low = np.minimum(trails[:, :2], trails[:, 2:]) - SAME_PX
    high = np.maximum(trails[:, :2], trails[:, 2:]) + SAME_PX
    near = ((high >= np.minimum(line[:2], line[2:])) & (low <= np.maximum(line[:2], line[2:]))).all(axis=1)
    others = trails[near & ~_is_own(line, trails)]
    if not len(others) and not len(member.stars):
        return []
    length = max(detection.length_px, 1.0)
    n = math.ceil(length) + 1
    points = line[:2] + np.linspace(0.0, 1.0, n)[:, None] * (line[2:] - line[:2])
    covered = np.zeros(n, dtype=np.bool_)
    for trail in others:
        way = trail[2:] - trail[:2]
        at = np.clip((points - trail[:2]) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
        covered |= np.hypot(*(points - trail[:2] - at[:, None] * way).T) < SAME_PX
    for star in member.stars:
        covered |= np.hypot(*(points - star).T) < star_px
    edges = np.flatnonzero(np.diff(np.concatenate([[False], covered, [False]]).astype(np.int8)))
    step = length / (n - 1)
    return [((first - 0.5) * step, (stop - 0.5) * step) for first, stop in edges.reshape(-1, 2)]


def _is_own(line: NDArray[np.float64], trails: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which trails (m, 4) are that of a member (4,), as its frame shows it or a part of it: on its line, and within its ends."""
    length = max(math.hypot(*(line[2:] - line[:2])), 1.0)
    u = (line[2:] - line[:2]) / length
    away = trails.reshape(-1, 2, 2) - line[:2]
    along, across = away @ u, np.abs(away[..., 0] * u[1] - away[..., 1] * u[0])
    slack = OWN_BEYOND * length + SAME_PX
    inside = (along > -slack).all(axis=1) & (along < length + slack).all(axis=1)
    return np.asarray(inside & (across < SAME_PX + OWN_TILT * length).all(axis=1))
