"""Shake of the camera within exposures, estimated from the ends of trails across their motion.

An error of the rate at which the camera turned in an exposure moves the two ends of a trail in opposite directions across its
motion. This differs from frame to frame, while the motion is one line. The attitudes of whole frames give an expected shake. One
factor for the run scales it, so that well-measured trails lie on the lines of their tracklets within their errors.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.link.measured import turning_arcsec
from ground.link.resolve import pieces_among
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

Array = NDArray[np.float64]

LEAST_FRAMES: Final = 4
"""Least number of frames. With two or three, the line absorbs most of the difference of their ends."""
MIDDLE_ASTRAY: Final = 0.2
"""Error of a trail's middle across the motion that its pixels do not show (stars, the field), in units of the expected shake."""
LEAST_FREE: Final = 0.1
"""Least share of a trail's variance that remains after the fit of the line; with less, the trail is not used."""
CLEAREST: Final = 2.0
"""Largest error of an end, in units of the expected shake; ends with larger errors are not used."""
ASTRAY: Final = 0.02
"""Share of ends that err for other causes, a star on the trail or a wrong member."""
ASTRAY_WIDTH: Final = 10.0
"""Width of their errors, in units of the errors expected from attitudes and pixels."""
PRIOR_LOG: Final = 0.7
"""Prior sigma of the factor's logarithm: the error of a random walk as a model of the spectrum."""
FACTORS: Final = np.geomspace(0.1, 10.0, 93)
UNUSABLE: Final = (
    StreakFlag.NO_SKY | StreakFlag.POINT_LIKE | StreakFlag.FIT_FAILED | StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.FAST_ROWS
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenTrail:
    """A member of a tracklet: streak, arcsec per pixel, prior error of its frame's rate."""

    streak: StreakMeasurement
    scale_arcsec: float
    sigma_rate_arcsec_s: float


class Sway(NamedTuple):
    """For n trails: half the difference of both ends across the motion, its error, and the expected shake in it, arcsec."""

    off: Array
    sigma: Array
    shake: Array


def sway_of(tracklet: Tracklet, trails: Sequence[SeenTrail]) -> Sway:
    """Evidence of the members of one tracklet; empty if they are too few or too faint."""
    nothing = Sway(np.zeros(0), np.zeros(0), np.zeros(0))
    whole = [not piece for piece in pieces_among([t.streak for t in trails], tracklet)]
    used = [
        t
        for t, one in zip(trails, whole, strict=True)
        if one and t.streak.flags & StreakFlag.DIRECTION_RESOLVED and not t.streak.flags & UNUSABLE
    ]
    if len(used) < LEAST_FRAMES:
        return nothing
    sigma = np.array([_sigma_arcsec(t) for t in used])
    shake = np.array([turning_arcsec(t.streak, t.sigma_rate_arcsec_s, 2) for t in used])
    clear = sigma < CLEAREST * shake
    if np.count_nonzero(clear) < LEAST_FRAMES:
        return nothing
    used, sigma, shake = [t for t, c in zip(used, clear, strict=True) if c], sigma[clear], shake[clear]
    unit = np.array([unit_vectors(np.radians(t.streak.ra_deg[[0, 2]]), np.radians(t.streak.dec_deg[[0, 2]])) for t in used])
    pole = np.linalg.svd(unit.reshape(-1, 3))[2][2]
    across = unit @ pole / ARCSEC_RAD
    t_s = np.array([(t.streak.t_tai_ns[[0, 2]] - used[0].streak.t_tai_ns[0]) * 1e-9 for t in used])
    t_s -= t_s.mean()
    # gravity bends the line; what is left of its slope at each frame is the camera's
    design = np.stack([np.ones_like(t_s), t_s, t_s**2], axis=-1)
    by_middle, by_tilt = 1.0 / np.hypot(sigma, MIDDLE_ASTRAY * shake), 1.0 / np.hypot(sigma, shake)
    middle, tilt = design.mean(axis=1), 0.5 * (design[:, 1] - design[:, 0])
    off = 0.5 * (across[:, 1] - across[:, 0])
    q, r = np.linalg.qr(np.concatenate([middle * by_middle[:, None], tilt * by_tilt[:, None]]))
    motion = np.linalg.solve(r, q.T @ np.concatenate([across.mean(axis=1) * by_middle, off * by_tilt]))
    # The line follows the trails that it is fitted to, so residuals are smaller than errors.
    followed = np.sum(q[len(used) :] ** 2, axis=1)
    return Sway((off - tilt @ motion) / np.sqrt(np.maximum(1.0 - followed, LEAST_FREE)), sigma, shake)


def shake_factor(sways: Iterable[Sway]) -> float:
    """Factor on the expected shake of a run: posterior mean of its logarithm; 1 without a usable trail."""
    each = list(sways)
    off, sigma, shake = (np.concatenate([np.zeros(0), *(s[k] for s in each)]) for k in range(3))
    variance = sigma**2 + np.outer(FACTORS**2, shake**2)
    # normal errors, and a few far wider ones that do not depend on the factor
    wide = ASTRAY_WIDTH**2 * (sigma**2 + shake**2)
    near = (1.0 - ASTRAY) * np.exp(-0.5 * off**2 / variance) / np.sqrt(variance)
    log = np.sum(np.log(near + ASTRAY * np.exp(-0.5 * off**2 / wide) / np.sqrt(wide) + 1e-300), axis=1)
    log -= 0.5 * (np.log(FACTORS) / PRIOR_LOG) ** 2
    share = np.exp(log - log.max())
    return math.exp(float(np.average(np.log(FACTORS), weights=share)))


def _sigma_arcsec(trail: SeenTrail) -> float:
    """Error of half the difference of both ends across the trail."""
    fit = trail.streak.fit
    length = max(fit.length_px, 1e-6)
    side = np.array([-(fit.col1 - fit.col0), fit.row1 - fit.row0]) / length
    half = 0.5 * np.concatenate([-side, side])
    variance = float(half @ np.asarray(fit.covariance_px2) @ half)
    return math.sqrt(variance) * trail.scale_arcsec if variance >= 0.0 else math.inf
