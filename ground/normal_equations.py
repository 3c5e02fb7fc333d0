"""Least squares of unknowns whose units differ by orders of magnitude."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def scaled_inverse(matrix: Array) -> Array:
    """Inverse of a positive matrix (k, k) whose unknowns have units of very different size."""
    scale = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale))
