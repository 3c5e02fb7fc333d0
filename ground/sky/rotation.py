"""Quaternions (scalar last) and rotation matrices that turn GCRS directions into the camera frame."""

import numpy as np
from numpy.typing import NDArray

from ground.sky.sphere import cross

Array = NDArray[np.float64]


def matrix_of(quaternion: Array) -> Array:
    """Matrix (3, 3) with ``camera = matrix @ gcrs`` of a unit quaternion (x, y, z, w): ``camera = q gcrs q*``."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def quaternion_of(matrix: Array) -> Array:
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix (Shepperd 1978: the largest component first)."""
    m = matrix
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([1 + 2 * m[0, 0] - trace, 1 + 2 * m[1, 1] - trace, 1 + 2 * m[2, 2] - trace, 1 + trace])
    largest = int(np.argmax(squares))
    if largest == 3:
        q = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]])
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = np.empty(4)
        q[i], q[j], q[k], q[3] = squares[i], m[j, i] + m[i, j], m[k, i] + m[i, k], m[k, j] - m[j, k]
    q = q / np.linalg.norm(q)
    return -q if q[3] < 0.0 else q


def rotation_by(vector_rad: Array) -> Array:
    """Matrix (3, 3) of the rotation by a vector (Rodrigues' formula): ``v -> v + theta x v`` to first order."""
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def turn(vectors: Array, angles_rad: Array) -> Array:
    """Vectors (n, 3), each turned by its own small rotation vector (n, 3); exact to second order, 1e-12 rad for 1e-4 rad."""
    first = cross(angles_rad, vectors)
    return vectors + first + 0.5 * cross(angles_rad, first)
