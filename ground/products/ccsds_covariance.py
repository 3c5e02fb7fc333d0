"""Covariances of a state as CCSDS orbit messages (502.0-B) write them: lower triangle, km and km/s."""

import numpy as np
from numpy.typing import NDArray

_AXES = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")


def turned(covariance: NDArray[np.float64], rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (6, 6) of position and velocity along axes turned by a matrix (3, 3)."""
    both = np.kron(np.eye(2), rotation)
    return np.asarray(both @ covariance @ both.T)


def triangle_lines(covariance: NDArray[np.float64]) -> list[str]:
    """Six lines of one to six numbers, as an OEM has them."""
    return [" ".join(f"{value:.14e}" for value in row[: k + 1]) for k, row in enumerate(covariance)]


def keyword_lines(covariance: NDArray[np.float64]) -> list[str]:
    """Twenty-one lines with a keyword each, as an OPM has them."""
    return [f"C{_AXES[i]}_{_AXES[j]} = {covariance[i, j]:.14e}" for i in range(6) for j in range(i + 1)]
