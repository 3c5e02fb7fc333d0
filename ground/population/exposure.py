"""Exposure behind a count: time, and the area through which objects passed."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import validate

YEAR_S: Final = 365.25 * 86_400.0
"""The Julian year."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposure:
    """Observing time and, by true size class, the multiple of nature's density that was simulated and the area watched.

    boost : (k,) objects drawn per object in nature; ones for a real run. area_km2 : (k,) mean cross-section watched.
    """

    duration_s: float
    boost: NDArray[np.float64]
    area_km2: NDArray[np.float64]

    def __post_init__(self) -> None:
        validate.within("exposure.duration_s", self.duration_s, 1e-6, 1e12)
        object.__setattr__(self, "boost", validate.finite_array("exposure.boost", self.boost, (None,)))
        shape = (len(self.boost),)
        object.__setattr__(self, "area_km2", validate.finite_array("exposure.area_km2", self.area_km2, shape))

    def days(self) -> NDArray[np.float64]:
        """Days (k,) in which nature would have shown as many objects."""
        return np.asarray(self.duration_s * self.boost / 86400.0)

    def km2_years(self) -> NDArray[np.float64]:
        """Area times time (k,), in km^2 years of nature's flux."""
        return np.asarray(self.duration_s * self.boost * self.area_km2 / YEAR_S)


def cone_cross_section_km2(full_angle_deg: float, range_km: NDArray[np.float64]) -> NDArray[np.float64]:
    """Area (k,) that a viewing cone of this length shows to objects from all directions: a quarter of its surface (Cauchy)."""
    half = math.radians(0.5 * full_angle_deg)
    radius = np.asarray(range_km, dtype=np.float64) * math.sin(half)
    return np.asarray(0.25 * (math.pi * radius * range_km + math.pi * radius**2))
