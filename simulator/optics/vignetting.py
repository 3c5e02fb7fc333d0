"""Relative illumination of the field: mechanical vignetting and the cosine-fourth law."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sboc_e2e.icd.errors import UserError


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
