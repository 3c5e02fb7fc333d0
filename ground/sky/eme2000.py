"""GCRS axes to EME2000 (mean equator and equinox of J2000.0): the IAU 2006 frame bias, 23 mas."""

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.sky.sphere import spherical_deg, unit_vectors


def frame_bias() -> NDArray[np.float64]:
    """Matrix (3, 3) with ``eme2000 = matrix @ gcrs`` (ERFA `bp06`)."""
    bias, _, _ = erfa.bp06(erfa.DJ00, 0.0)
    return np.asarray(bias)


def eme2000_angles_deg(
    ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension in [0, 360) and declination, EME2000, of GCRS directions (n,)."""
    return spherical_deg(unit_vectors(np.radians(ra_deg), np.radians(dec_deg)) @ frame_bias().T)
