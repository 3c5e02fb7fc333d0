"""Crosses on bright stars: spikes of struts that are as bright as the star that is left of a full core.

`spikes` asks that a star outshines its spike twenty times. A full star in an 8-bit picture, or one whose core a camera clipped,
keeps less light than its spikes have. Their pattern tells them: struts draw four equal arms at right angles, or six at 60 deg,
the same on every bright star of a frame.

Nebulae and borders hide arms. Lines that were measured tell them all the same: no two trails cross at right angles at the core of
a star.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ground.vetting.spikes import CENTRE_ERROR_PX, SPIKE_PER_REAL, SPIKE_PLACES, BrightStars, aim_of
from sboc_e2e.icd.products import StreakFit

MOST_STARS: Final = 70
"""The brightest listed stars that are looked at: a bound of the work, some 0.2 s. Chosen, not measured."""
MOST_BLOCKS: Final = 30
"""Bright places of the image that are looked at beside them. The brightest star of a nebula, 36 px in radius, was listed as its
rim, behind a hundred others. Chosen, not measured."""
SAMPLE_PX: Final = 4
"""Every so many rows and columns of the image are looked at for such places: a budget of work."""
BLOCK_PX: Final = 16
"""Side of a block of pixels whose mean tells them: as wide as a star of a size that its list entry does not show."""
BESIDE_BLOCKS: Final = 17
"""Side of the neighbourhood, in blocks, whose mean a bright place exceeds: 272 px, far wider than a full star."""
HALF_PX: Final = 80
"""How far from a star its arms are looked for, px: a sixth of the rows of a small picture. Chosen, not measured."""
BEGIN_RADII: Final = 1.5
"""Where arms begin to be measured, in radii of the core, and 3 px. Chosen, not measured."""
REACH_RADII: Final = 5.0
"""How far they are looked for where the core is large, in the same. Chosen, not measured."""
STEP_DEG: Final = 1.5
"""Between directions that are tried: 2 px apart at the end of an arm."""
CORE_SHARE: Final = 0.5
"""Light of the pixels of a star's core, over its brightest. At 0.7 the top of a full star that is not flat has its middle 4 px
beside that of its spikes."""
ROUND: Final = 2.0
"""Greatest ratio of the axes of a core: a piece of a trail has a longer one. Chosen, not measured."""
LEAST_ARM_PX: Final = 6.0
"""Length at least on which an arm is measured, beyond the core: shorter ones are no lines. Chosen, not measured."""
CLEAR_ARM: Final = 6.0
"""Each arm of a star that tells a cross alone is so many times as bright as directions scatter. Of 90 deg and of 60 deg there are
60 and 40 sets of directions, of which no noise gives one with four such arms."""
LIKELY_ARM: Final = 4.0
"""The same of a star whose cross is like that of others of the frame."""
SAME_DEG: Final = 3.0
"""Two stars whose arms differ by less share their cross: arms are told to a step or two."""
SHARED_BY: Final = 2
"""Stars that share a cross, at least, and at least half of those that have one. Chosen, not measured."""
FOLDS: Final = (4, 6)
"""Arms of a cross: of two crossing struts, and of three struts or a hexagonal mirror."""
LEAST_CORE_PX: Final = 2.0
"""Radius of a core at which lines may cross, at least: smaller stars have no spikes of their own. Chosen, not measured."""
LEAST_RADII: Final = 3.0
"""Length of such a line in radii of the core, at least: shorter ones are the core itself. Chosen, not measured."""
CROSSING_DEG: Final = 2.0
"""The angle between two of them is that of the arms of a cross to so much. In 381 frames with 419 published lines on trails or
doubtful ones, as an eye marked them, none of these crosses another line so, and eight of 58 others do, all within 1.1 deg."""
LEAST_PARTNER: Final = 0.02
"""Probability of the other line, at least: the unlikeliest of these had 0.07. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True)
class Cross:
    """A star with arms: its centre and the radius of its core, px, the direction of one arm, rad, from rows towards columns.

    weakest : its weakest arm, in units of how far directions scatter.
    """

    row: float
    col: float
    angle_rad: float
    arms: int
    weakest: float
    radius_px: float

    def off(self, angle_rad: float) -> float:
        """Angle between a direction and the nearest arm, rad."""
        period = 2.0 * math.pi / self.arms
        return abs((angle_rad - self.angle_rad + 0.5 * period) % period - 0.5 * period)


def _no_cores() -> NDArray[np.float64]:
    return np.zeros((0, 3))


@dataclass(frozen=True, kw_only=True)
class Crosses:
    """Stars of a frame that have crosses, and the area in which they lie (px2).

    cores : (k, 3) row, column and radius, px, of all the bright stars that were looked at.
    """

    stars: Sequence[Cross]
    area_px2: float
    cores: NDArray[np.float64] = field(default_factory=_no_cores)

    @classmethod
    def of(cls, counts: NDArray[Any], unusable: NDArray[np.uint8], bright: BrightStars) -> "Crosses":
        """Crosses on the brightest stars of an image (rows, cols), listed or not; nonzero pixels of `unusable` are left out."""
        found: list[Cross] = []
        cores: list[tuple[float, float, float]] = []
        listed = np.column_stack((bright.row, bright.col))[::-1][:MOST_STARS]
        for row, col in (*listed.tolist(), *_bright_places(counts, unusable)):
            core = _core_of(counts, unusable, row, col)
            if core is not None and core[2] >= LEAST_CORE_PX:
                cores.append(core)
            if core is None or any(math.hypot(core[0] - each.row, core[1] - each.col) < CENTRE_ERROR_PX for each in found):
                continue  # a full star is listed more than once
            cross = _cross_at(counts, unusable, *core)
            if cross is not None:
                found.append(cross)
        told = [cross for cross in found if _is_told(cross, found)]
        return cls(stars=told, area_px2=bright.area_px2, cores=np.array(cores, dtype=np.float64).reshape(-1, 3))

    def against(self, fit: StreakFit) -> float:
        """Odds of a spike against a trail: of lines that lie along an arm and aim at the centre of its star; 0 of others."""
        length = fit.length_px
        if not length > 0.0 or not self.stars:
            return 0.0
        angle = math.atan2((fit.col1 - fit.col0) / length, (fit.row1 - fit.row0) / length)
        places, aways, reaches = aim_of(fit, *np.array([(star.row, star.col) for star in self.stars]).T)
        low, high = SPIKE_PLACES
        odds = 0.0
        for star, place, away, error in zip(self.stars, places.tolist(), aways.tolist(), reaches.tolist(), strict=True):
            reach = error + 0.5 * star.radius_px
            apart = math.radians(SAME_DEG) + math.atan2(reach, length)
            if away < reach and star.off(angle) < apart and low < place < high:
                share = min(star.arms * apart / math.pi, 1.0)
                chance = min(len(self.stars) * 2.0 * reach * (high - low) * length / self.area_px2, 1.0) * share
                odds = max(odds, SPIKE_PER_REAL * (1.0 / chance - 1.0))
        return odds

    def crossed(self, fits: Sequence[StreakFit], probability: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which fits (n,) cross another one at a bright star as its spikes do, given the probabilities (n,) of all."""
        out = np.zeros(len(fits), dtype=np.bool_)
        likely = [k for k in np.flatnonzero(probability >= LEAST_PARTNER).tolist() if fits[k].length_px > 0.0]
        if len(likely) < 2 or not len(self.cores):
            return out
        row, col, radius = self.cores.T
        low, high = SPIKE_PLACES
        at, angle = [], []
        for k in likely:
            places, aways, reaches = aim_of(fits[k], row, col)
            meets = (aways < reaches + 0.5 * radius) & (places > low) & (places < high)
            at.append(meets & (fits[k].length_px > LEAST_RADII * radius))
            angle.append(math.atan2(fits[k].col1 - fits[k].col0, fits[k].row1 - fits[k].row0))
        for (one, j), (other, k) in combinations(enumerate(likely), 2):
            apart = math.degrees(angle[one] - angle[other]) % 180.0
            as_arms = any(abs(min(apart, 180.0 - apart) - 360.0 / arms) < CROSSING_DEG for arms in FOLDS)
            if as_arms and (at[one] & at[other]).any():
                out[[j, k]] = True
        return out


def _bright_places(counts: NDArray[Any], unusable: NDArray[np.uint8]) -> list[tuple[float, float]]:
    """Row and column of the brightest pixels of blocks that stand out of their neighbourhood the most."""
    every, side = slice(None, None, SAMPLE_PX), BLOCK_PX // SAMPLE_PX
    sample = np.where(unusable[every, every] != 0, np.float32(np.nan), counts[every, every].astype(np.float32))
    rows, cols = (size // side for size in sample.shape)
    if not rows * cols or not np.isfinite(sample).any():
        return []
    sample = np.nan_to_num(sample, nan=float(np.nanmedian(sample)))
    block = sample[: rows * side, : cols * side].reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows, cols, side * side)
    mean = block.mean(axis=2)
    high = mean - ndimage.uniform_filter(mean, BESIDE_BLOCKS)
    peaks = np.flatnonzero((high == ndimage.maximum_filter(high, 3)).ravel() & (high.ravel() > 0.0))
    places = []
    for k in peaks[np.argsort(-high.ravel()[peaks], kind="stable")][:MOST_BLOCKS].tolist():
        row, col = divmod(int(np.argmax(block.reshape(-1, side * side)[k])), side)
        places.append((float(SAMPLE_PX * (k // cols * side + row)), float(SAMPLE_PX * (k % cols * side + col))))
    return places


def _core_of(counts: NDArray[Any], unusable: NDArray[np.uint8], row: float, col: float) -> tuple[float, float, float] | None:
    """Middle (row, col) and radius, px, of the flat top or the core of a star; None where it is not round, or has no light."""
    r, c = round(row), round(col)
    if not (0 <= r < counts.shape[0] and 0 <= c < counts.shape[1]):
        return None
    box = slice(max(r - HALF_PX, 0), r + HALF_PX + 1), slice(max(c - HALF_PX, 0), c + HALF_PX + 1)
    crop = np.where(unusable[box] != 0, np.nan, counts[box].astype(np.float32))
    r0, c0 = r - box[0].start, c - box[1].start
    near = crop[max(r0 - 2, 0) : r0 + 3, max(c0 - 2, 0) : c0 + 3]
    if not np.isfinite(near).any():
        return None
    sky, peak = float(np.nanmedian(crop)), float(np.nanmax(near))
    if not peak > sky:
        return None
    at = np.unravel_index(int(np.nanargmax(near)), near.shape)
    label, _ = ndimage.label(np.nan_to_num(crop, nan=-np.inf) > sky + CORE_SHARE * (peak - sky))
    here = label == label[max(r0 - 2, 0) + int(at[0]), max(c0 - 2, 0) + int(at[1])]
    rows, cols = np.nonzero(here)
    if len(rows) < 4:
        return box[0].start + float(rows.mean()), box[1].start + float(cols.mean()), 1.0
    spread = np.linalg.eigvalsh(np.cov(np.stack((rows, cols))) + np.eye(2) / 12.0)
    if spread[1] > ROUND**2 * spread[0]:
        return None
    return box[0].start + float(rows.mean()), box[1].start + float(cols.mean()), math.sqrt(len(rows) / math.pi)


def _cross_at(counts: NDArray[Any], unusable: NDArray[np.uint8], row: float, col: float, radius: float) -> Cross | None:
    """The best cross about a place, None where one of its arms is not bright."""
    angle = np.radians(np.arange(0.0, 360.0, STEP_DEG))
    distance = np.arange(BEGIN_RADII * radius + 3.0, max(HALF_PX, REACH_RADII * radius))
    if len(distance) < LEAST_ARM_PX:
        return None
    r = np.rint(row + distance[:, None] * np.cos(angle)).astype(np.int64)
    c = np.rint(col + distance[:, None] * np.sin(angle)).astype(np.int64)
    inside = (r >= 0) & (c >= 0) & (r < counts.shape[0]) & (c < counts.shape[1])
    r, c = np.where(inside, r, 0), np.where(inside, c, 0)
    light = np.where(inside & (unusable[r, c] == 0), counts[r, c].astype(np.float64), np.nan)
    best: Cross | None = None
    light = light[np.isfinite(light).mean(axis=1) > 0.5]
    if len(light) < LEAST_ARM_PX:
        return None
    # each ring in units of its own scatter about its median: stars and slopes of the halo are cut
    middle = _medians(light)
    scatter = 1.4826 * _medians(np.abs(light - middle))
    scaled = np.clip((light - middle) / np.maximum(scatter, 1e-6), -5.0, 5.0)
    for reach in (len(scaled), len(scaled) // 2, len(scaled) // 4):
        if reach < LEAST_ARM_PX:
            break
        lit = np.isfinite(scaled[:reach])
        arm = np.where(lit, scaled[:reach], 0.0).sum(axis=0) / np.sqrt(np.maximum(lit.sum(axis=0), 1))
        arm -= np.median(arm)
        noise = 1.4826 * float(np.median(np.abs(arm)))
        if not noise > 0.0:
            continue
        arm = arm / noise
        for arms in FOLDS:
            sets = arm.reshape(arms, -1)
            weakest = sets.min(axis=0)
            k = int(np.argmax(weakest))
            if weakest[k] >= LIKELY_ARM and (best is None or weakest[k] > best.weakest):
                best = Cross(row=row, col=col, angle_rad=float(angle[k]), arms=arms, weakest=float(weakest[k]), radius_px=radius)
    return best


def _medians(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each row (n, k), shape (n, 1), NaN left out: a fifth of the time of `numpy.nanmedian`. A row has a number at least."""
    ordered, known = np.sort(values, axis=1), np.isfinite(values).sum(axis=1)
    low, high = (np.take_along_axis(ordered, place[:, None], axis=1) for place in ((known - 1) // 2, known // 2))
    return np.asarray(0.5 * (low + high))


def _is_told(cross: Cross, crosses: Sequence[Cross]) -> bool:
    """Whether a star's arms are clear, or those of other stars too."""
    if cross.weakest >= CLEAR_ARM:
        return True
    like = [each for each in crosses if each.arms == cross.arms and each.off(cross.angle_rad) < math.radians(SAME_DEG)]
    return len(like) >= max(SHARED_BY, 0.5 * len(crosses))
