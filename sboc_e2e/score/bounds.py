"""Cramér–Rao bounds of a truth streak, from the inverse Fisher matrix of its noise-free trail.

The derivatives are numerical, on the trail as simulated (curved, variable, blurred); the background is known; the
noise variance is that without the object plus the object's own Poisson noise (docs/scoring.md).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.trail import TruePath, draw, draw_moved

CHANGE_POINT: Final = math.sqrt(16.0 * 1.2020569031595943)
"""sqrt(16 zeta(3)) = 4.39: rms of the posterior mean of a change point, in units of L / S^2."""

_MOVE_PX: Final = 0.02
"""Step of the central differences. Bounds differ from those of a tenth of it by 6e-5 at most, of ten times it by 0.6 % (trails of
5 to 300 px)."""


@dataclass(frozen=True, kw_only=True)
class TrailBounds:
    """One-sigma bounds: px, relative flux; ends are None where the trail leaves the frame."""

    cross_px: float
    end0_px: float | None
    end1_px: float | None
    angle_rad: float
    flux_relative: float
    attainable_end_px: float
    """Floor of an end from the change-point law, 4.39 L / S^2; the attainable bound is the larger of both."""

    def attainable(self, crlb_px: float) -> float:
        """Attainable bound of an end: max(CRLB, 4.39 L / S^2)."""
        return max(crlb_px, self.attainable_end_px)


def trail_bounds(path: TruePath, snr: float, shape: tuple[int, int]) -> TrailBounds:
    """Bounds of a trail with matched-filter S/N `snr` (variance without the object) in a frame of `shape`.

    The noise variance without the object is the constant that gives this S/N, so that stars and vignetting under the
    trail, which the simulator knows, are in the bound too.
    """
    band = draw(path)
    inside = _inside(band.electrons.shape, band.along_rows, band.major0, band.minor0, shape)
    trail = band.electrons[inside]
    variance = float(np.sum(trail * trail)) / (snr * snr)
    chord = np.array([path.row[-1] - path.row[0], path.col[-1] - path.col[0]])
    norm = float(np.hypot(*chord))
    along = chord / norm if norm > 1e-9 else np.array([0.0, 1.0])
    across = np.array([-along[1], along[0]])

    names, rows = ["flux"], [trail]
    for name, end, direction, known in (
        ("along0", 0, along, path.edge0),
        ("cross0", 0, across, False),
        ("along1", 1, along, path.edge1),
        ("cross1", 1, across, False),
    ):
        if known:
            continue
        step = (float(direction[0]) * _MOVE_PX, float(direction[1]) * _MOVE_PX)
        back = (-step[0], -step[1])
        if end == 0:
            plus, minus = draw_moved(path, band, end0_px=step), draw_moved(path, band, end0_px=back)
        else:
            plus, minus = draw_moved(path, band, end1_px=step), draw_moved(path, band, end1_px=back)
        names.append(name)
        rows.append(((plus.electrons - minus.electrons) / (2 * _MOVE_PX))[inside])

    jacobian = np.array(rows)
    fisher = (jacobian / (variance + np.maximum(trail, 0.0))) @ jacobian.T
    covariance = _inverse(fisher)
    at = {name: i for i, name in enumerate(names)}
    i, j = at["cross0"], at["cross1"]
    cross = math.sqrt((covariance[i, i] + covariance[j, j] + 2 * covariance[i, j]) / 4)
    angle = math.sqrt(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j]) / max(norm, path.sigma_px)

    def end_bound(name: str) -> float | None:
        return math.sqrt(covariance[at[name], at[name]]) if name in at else None

    return TrailBounds(
        cross_px=cross,
        end0_px=end_bound("along0"),
        end1_px=end_bound("along1"),
        angle_rad=angle,
        flux_relative=math.sqrt(covariance[0, 0]),
        attainable_end_px=CHANGE_POINT * path.length_px / (snr * snr),
    )


def _inverse(fisher: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse after scaling to a unit diagonal; a pseudo-inverse for point-like trails, whose ends are not separable."""
    scale = 1.0 / np.sqrt(np.diag(fisher))
    return np.asarray(np.linalg.pinv(fisher * np.outer(scale, scale), rcond=1e-9, hermitian=True) * np.outer(scale, scale))


def _inside(
    size: tuple[int, int], along_rows: bool, major0: int, minor0: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    n, width = size
    major_limit, minor_limit = shape if along_rows else shape[::-1]
    major = (major0 + np.arange(n))[:, None]
    minor = minor0[:, None] + np.arange(width)
    return np.asarray((major >= 0) & (major < major_limit) & (minor >= 0) & (minor < minor_limit))
