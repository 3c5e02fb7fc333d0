"""Apparent direction to published direction: only the aberration of the observer's geocentric velocity is removed.

An Earth-orbiting target moves with the Earth around the Sun, so annual aberration must stay out of the correction: a fully
de-aberrated direction is 20.7 arcsec off at the anti-Sun point. Light time is left to the orbit.
"""

import erfa
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LIGHT_M_S = float(erfa.CMPS)
"""299,792,458 m/s, exact (SI)."""


def without_observer_aberration(apparent: Array, velocity_m_s: Array) -> Array:
    """Unit vectors (n, 3) seen by an observer at rest at the geocentre's velocity, from those seen by the moving camera.

    Inverse of the relativistic aberration formula (Klioner 2003, AJ 125, 1580, eq. 7): a boost by the opposite velocity.
    velocity_m_s : (3,) or (n, 3) of the camera relative to the geocentre, GCRS axes.
    """
    beta = -np.asarray(velocity_m_s) / LIGHT_M_S
    inverse_gamma = np.sqrt(1.0 - np.sum(beta * beta, axis=-1, keepdims=True))
    along = np.sum(apparent * beta, axis=-1, keepdims=True)
    moved = inverse_gamma * apparent + (1.0 + along / (1.0 + inverse_gamma)) * beta
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))
