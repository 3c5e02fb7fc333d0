"""Process noise within a batch fit: accelerations that the forces leave out, as impulses of unknown size but known spread.

White accelerations of a power density over a piece of time change the velocity by as much as one impulse in its middle. The
impulses are unknowns of the fit, each with its spread as a prior: pseudo-stochastic pulses (Beutler et al. 2006, J. Geodesy 80,
353).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import tai

Array = NDArray[np.float64]

PUSH_KM2_S3: Final = 1e-18
"""Power density of accelerations that the forces leave out: 1e-8 m/s^2 (a tenth of the light's push on 0.02 m^2/kg) that change
from hour to hour have 1e-22 km^2/s^4 * 2 h, about 7e-19. A geostationary orbit is moved
along its way by 51 m after a day, by 1.4 km after ten (one sigma)."""
_PIECE_NS: Final = 6 * 3600 * tai.NS_PER_S
"""A piece's own motion is neglected but for its middle: of the variance of place that a piece makes, a quarter (1/3 to 1/4 of the
cube of time), hence of ten days' 1e-4. Forty unknown impulses in ten days are cheap."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Impulses:
    """Epochs (j,) TAI ns of impulses and one sigma (j,) km/s along each axis of GCRS."""

    t_tai_ns: NDArray[np.int64]
    sigma_km_s: Array

    @classmethod
    def within(cls, first_tai_ns: int, last_tai_ns: int, push_km2_s3: float) -> "Impulses":
        """In the middle of each of equal pieces of a span. push_km2_s3 : power density along each axis; 0: no impulse."""
        n = -(-(last_tai_ns - first_tai_ns) // _PIECE_NS) if push_km2_s3 > 0.0 else 0
        edges = np.linspace(0, last_tai_ns - first_tai_ns, n + 1).astype(np.int64)
        length_s = np.diff(edges) / tai.NS_PER_S
        return cls(t_tai_ns=first_tai_ns + edges[:-1] + np.diff(edges) // 2, sigma_km_s=np.sqrt(push_km2_s3 * length_s))

    def effects(self, t0_tai_ns: int, t_tai_ns: NDArray[np.int64], at: Array, here: Array) -> Array:
        """Partials (n, 6, 3 j) of states at epochs (n,) with respect to the impulses, the state at t0 being held.

        at : (n, 6, 6) transition matrices from t0 to the epochs. here : (j, 6, 6) to the impulses.
        """
        n, j = len(t_tai_ns), len(self.t_tai_ns)
        back = np.linalg.inv(here)[:, :, 3:]
        after = (self.t_tai_ns >= t0_tai_ns) & (t_tai_ns[:, None] > self.t_tai_ns)
        before = (self.t_tai_ns < t0_tai_ns) & (t_tai_ns[:, None] <= self.t_tai_ns)
        sign = after.astype(float) - before.astype(float)
        return np.asarray(np.einsum("nj,nik,jkl->nijl", sign, at, back, optimize=True).reshape(n, 6, 3 * j))
