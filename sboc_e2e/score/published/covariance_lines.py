"""Covariances of states in messages: keywords CX_X ... CZ_DOT_Z_DOT (OPM) or a lower triangle of numbers (OEM)."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.published.axes import gcrs_from, orbital_axes

Array = NDArray[np.float64]

_AXES: Final = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
COVARIANCE_KEYS: Final = tuple(f"C{_AXES[i]}_{_AXES[j]}" for i in range(6) for j in range(i + 1))
"""The 21 keywords of 502.0-B-2 in the order of a lower triangle, row by row."""


def symmetric(triangle: list[float]) -> Array:
    """Matrix (6, 6) of a lower triangle (21)."""
    out = np.zeros((6, 6))
    out[np.tril_indices(6)] = triangle
    return out + np.tril(out, -1).T


def in_gcrs(covariance: Array, frame: str, position: Array, velocity: Array) -> Array:
    """Covariance (6, 6) on GCRS axes; `frame` are its own axes, position and velocity (3,) the state's, GCRS.

    RTN and RSW are radial, transverse, normal. Raises UserError for other axes than these and `axes.AXES`.
    """
    axes = orbital_axes(position, velocity) if frame in ("RTN", "RSW") else gcrs_from(frame)
    turn = np.kron(np.eye(2), axes)
    return np.asarray(turn @ covariance @ turn.T)
