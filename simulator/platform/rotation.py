"""Rotations: matrices, scalar-last quaternions and rotation vectors, all as "GCRS direction to camera frame"."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def matrix_of_boresight(boresight: Array, roll_rad: float) -> Array:
    """(3, 3) camera frame whose +Z is a GCRS direction; at roll 0 rows grow towards celestial south (north is up).

    Positive roll turns the camera about +Z. At the pole, "north" is the direction of right ascension 180 deg.
    """
    z = boresight / np.linalg.norm(boresight)
    south = np.array([z[2] * z[0], z[2] * z[1], -(z[0] ** 2 + z[1] ** 2)])
    if np.linalg.norm(south) < 1e-9:
        south = np.array([np.sign(z[2]), 0.0, 0.0])
    y = south / np.linalg.norm(south)
    # y x z, written out: `np.cross` on single vectors takes ten times as long
    x = np.array([y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0]])
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([c * x + s * y, -s * x + c * y, z])


def matrix_of_axes(boresight: Array, col_axis: Array) -> Array:
    """(3, 3) camera frame with +Z along one direction and +X as near as possible to another."""
    z = boresight / np.linalg.norm(boresight)
    x = col_axis - (col_axis @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def small_rotation(rotation_vector: Array) -> Array:
    """Matrices (..., 3, 3) of frames that have turned by rotation vectors (..., 3): they take old components to new ones.

    Rodrigues' formula with the sign of a turned frame.
    """
    v = np.asarray(rotation_vector, dtype=np.float64)
    angle2 = np.sum(v * v, axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    cross = np.zeros((*v.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return np.eye(3) - np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (cross @ cross)


def rotation_vector_of(matrix: Array) -> Array:
    """Rotation vectors (..., 3) of small frame rotations (..., 3, 3), the inverse of `small_rotation`; below 180 deg."""
    m = np.asarray(matrix)
    axis = 0.5 * np.stack([m[..., 1, 2] - m[..., 2, 1], m[..., 2, 0] - m[..., 0, 2], m[..., 0, 1] - m[..., 1, 0]], axis=-1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(m, axis1=-2, axis2=-1) - 1.0)[..., None]
    angle = np.arctan2(sine, cosine)
    return axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 1.0)


def quaternion_of(matrix: Array) -> Array:
    """Scalar-last unit quaternion (4,) with the scalar >= 0 that rotates vectors as the matrix does (Shepperd 1978)."""
    m = np.asarray(matrix)
    diagonal, turn = np.diagonal(m), np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    total = diagonal[0] + diagonal[1] + diagonal[2]
    squares = np.append(1 + 2 * diagonal - total, 1 + total)
    i = int(np.argmax(squares))  # the largest component: the others are sums over it
    q = np.append(turn, 0.0) if i == 3 else np.append(m[i] + m[:, i], turn[i])
    q[i] = squares[i]
    q = q / np.linalg.norm(q)
    return q if q[3] >= 0.0 else -q


def turned(vectors: Array, rotation_vectors: Array) -> Array:
    """Components of vectors (n, 3) in frames that have turned by rotation vectors (n, 3), one each (Rodrigues)."""
    angle = np.linalg.norm(rotation_vectors, axis=-1)
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    a, b, c = rotation_vectors[..., 0], rotation_vectors[..., 1], rotation_vectors[..., 2]
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    # v x r and v x (v x r), written out: three times faster than np.cross on many small vectors
    ox, oy, oz = b * z - c * y, c * x - a * z, a * y - b * x
    tx, ty, tz = b * oz - c * oy, c * ox - a * oz, a * oy - b * ox
    return np.stack([x - first * ox + second * tx, y - first * oy + second * ty, z - first * oz + second * tz], axis=-1)
