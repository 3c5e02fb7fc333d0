"""Relative illumination of the field: mechanical vignetting and the cosine-fourth law."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sboc_e2e.icd.errors import UserError

_LARGEST_STEP_PX: Final = 16  # a power of two: the 66,000 nodes of 4096 px are few enough. Chosen, not measured
_STEPS_OF_FALL_OFF: Final = 100
"""Steps of the grid over the width of the fall-off: bilinear values are wrong by (corner loss) / 2 / 100^2, 1e-5, at most."""


@dataclass(frozen=True, kw_only=True)
class VignettingOptions:
    """How illumination falls off from the axis."""

    corner_loss: float = field(
        default=0.20, metadata={"doc": "light lost to mechanical vignetting at the corner", "min": 0.0, "max": 1.0}
    )
    start: float = field(
        default=0.30, metadata={"doc": "radius, in corner radii, inside which nothing is lost", "min": 0.0, "max": 0.99}
    )
    cosine_fourth: bool = field(default=True, metadata={"doc": "apply the cosine-fourth law of the field angle"})


def relative_illumination(
    options: VignettingOptions,
    row: ArrayLike,
    col: ArrayLike,
    *,
    center_row: float,
    center_col: float,
    corner_radius_px: float,
    focal_px: float,
) -> NDArray[np.float64]:
    """Illumination relative to the axis (1 on axis) at pixel positions that broadcast against each other.

    Mechanical loss grows as the square of the radius beyond `start`; cos^4 of the field angle is
    ``(1 + (r/f)^2)^-2`` for a flat field (e.g. Kingslake, Optics in Photography, chapter 6).
    """
    if corner_radius_px <= 0.0 or focal_px <= 0.0:
        raise UserError(f"vignetting: corner radius {corner_radius_px} px and focal length {focal_px} px must be above 0")
    r2 = (np.asarray(row, dtype=np.float64) - center_row) ** 2 + (np.asarray(col, dtype=np.float64) - center_col) ** 2
    beyond = np.clip((np.sqrt(r2) / corner_radius_px - options.start) / (1.0 - options.start), 0.0, None)
    out = np.clip(1.0 - options.corner_loss * beyond**2, 0.0, 1.0)
    if options.cosine_fourth:
        out = out / (1.0 + r2 / focal_px**2) ** 2
    return np.asarray(out)


class IlluminationGrid(NamedTuple):
    """Illumination at every `step_px`-th row and column of an image, bilinear in between: the whole map would take 64 MB.

    nodes : (n, m) float32 from pixel (0, 0) on, one step beyond the last row and column.
    """

    nodes: NDArray[np.float32]
    step_px: int


def node_places(shape: tuple[int, int], step_px: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows (n, 1) and columns (1, m) of the nodes over an image."""
    row, col = (np.arange((n - 1) // step_px + 2, dtype=np.float64) * step_px for n in shape)
    return row[:, None], col[None, :]


def grid_step_px(options: VignettingOptions, corner_radius_px: float) -> int:
    """Largest power of two, up to 16, with `_STEPS_OF_FALL_OFF` steps over the fall-off, where its curvature is constant."""
    width_px = (1.0 - options.start) * corner_radius_px
    step_px = _LARGEST_STEP_PX
    while step_px > 1 and step_px * _STEPS_OF_FALL_OFF > width_px:
        step_px //= 2
    return step_px


def even_illumination(shape: tuple[int, int]) -> IlluminationGrid:
    """The same light everywhere."""
    row, col = node_places(shape, _LARGEST_STEP_PX)
    return IlluminationGrid(np.ones((row.size, col.size), dtype=np.float32), _LARGEST_STEP_PX)


@numba.njit(cache=True)
def illumination_of_row(
    nodes: NDArray[np.float32], step_px: int, row: int, ends: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """Illumination of one row, (cols,), of an `IlluminationGrid`; to be asked for rows in order, from 0.

    ends : (2, cols) of the caller, kept from row to row: the rows of nodes above and below.
    """
    above = row % step_px
    if above == 0:
        for k in range(2):
            line = nodes[row // step_px + k]
            for c in range(out.size):
                j = c // step_px
                ends[k, c] = line[j] + (line[j + 1] - line[j]) * np.float32((c - j * step_px) / step_px)
    share = np.float32(above / step_px)
    for c in range(out.size):
        out[c] = ends[0, c] + share * (ends[1, c] - ends[0, c])
