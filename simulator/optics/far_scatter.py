"""Light that optics and baffle scatter into the field from sources far outside it (Moon, lit Earth): a veil without structure.

A polished and slightly dusty surface scatters in proportion to a power of the angle (Harvey's law; Spyak & Wolfe 1992, Opt. Eng.
31, 1746, measured dusty mirrors). Strength, slope and baffle are ASSUMED. Behind the angle at which a baffle shades the whole
aperture only what its vanes leak is left.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_DEG: Final = 0.5
"""Nearer to a source the halo of the PSF is its light."""
SHADING_DEG: Final = 10.0
"""From the angle at which a baffle begins to shade the aperture to that at which it shades it all."""
ARCSEC2_PER_SR: Final = (180.0 / np.pi * 3600.0) ** 2


@dataclass(frozen=True, kw_only=True)
class FarScatterOptions:
    """Veiling glare of sources outside the field."""

    strength: float = field(
        default=0.0,
        metadata={
            "doc": "share of a source's light on the aperture that a steradian of field shows, 10 deg from the source",
            "min": 0.0,
            "max": 1.0,
        },
    )
    slope: float = field(default=2.0, metadata={"doc": "power with which it falls with the angle", "min": 0.0, "max": 4.0})
    baffle_deg: float = field(
        default=25.0, metadata={"doc": "angle from which a baffle shades the aperture", "min": 1.0, "max": 180.0}
    )
    baffle_leak: float = field(
        default=1e-5, metadata={"doc": "what its vanes leave where it shades all of the aperture", "min": 0.0, "max": 1.0}
    )


def veil_per_arcsec2(options: FarScatterOptions, angle_rad: Array) -> Array:
    """Share of a source's light that a square arcsecond shows at angles from it.

    The baffle's shade grows linearly in the logarithm over `SHADING_DEG`.
    """
    angle_deg = np.maximum(np.degrees(angle_rad), LEAST_DEG)
    open_veil = options.strength * (10.0 / angle_deg) ** options.slope
    shaded = np.clip((angle_deg - options.baffle_deg) / SHADING_DEG, 0.0, 1.0)
    return np.asarray(open_veil * max(options.baffle_leak, 1e-30) ** shaded / ARCSEC2_PER_SR)
