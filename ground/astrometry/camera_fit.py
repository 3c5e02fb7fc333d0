"""Least squares of a frame's attitude and of the run's shared camera parameters against matched stars.

Robust first (soft-l1 weights, iterated), then stars beyond `CLIP_SIGMA` are dropped and the rest is fitted with Gaussian
weights, so that the covariance means what it says.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.camera import ATTITUDE, SHARED, Camera
from ground.sky.rotation import rotation_by

Array = NDArray[np.float64]

CLIP_SIGMA: Final = 4.5
N_ROBUST: Final = 6
N_GAUSSIAN: Final = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPrior:
    """Gaussian knowledge of the shared parameters: mean (5,) and information (inverse covariance) matrix (5, 5)."""

    mean: Array
    information: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraSolution:
    """Result of `fit_camera`.

    matrix : (3, 3) GCRS to camera frame. covariance : (8, 8) of rotation (rad, camera frame) and shared parameters, scaled by
    the residuals where those are larger than expected. information_gain : (5, 5) what this frame adds on the shared
    parameters with its attitude unknown. used : (n,) bool, stars kept. residual_px : (n, 2), all stars.
    """

    matrix: Array
    camera: Camera
    covariance: Array
    information_gain: Array
    used: NDArray[np.bool_]
    residual_px: Array
    chi2_nu: float


def fit_camera(
    measured_px: Array, apparent: Array, turn_rad: Array, sigma_px: Array, *, matrix: Array, camera: Camera, prior: CameraPrior
) -> CameraSolution:
    """Attitude and camera from matched stars.

    measured_px : (n, 2) row and col. apparent : (n, 3) unit vectors, GCRS. turn_rad : (n, 3) rotation of the camera frame
    between the frame's epoch and each star's row epoch. sigma_px : (n,) error of each coordinate. matrix, camera : start.
    """
    n_parameters = ATTITUDE + len(SHARED)
    values = camera.shared()
    used = np.ones(len(measured_px), dtype=bool)
    weight = np.ones(len(measured_px))
    normal, residual = np.eye(n_parameters), np.zeros((len(measured_px), 2))
    data_normal = np.zeros((n_parameters, n_parameters))
    for iteration in range(N_ROBUST + N_GAUSSIAN):
        vectors = apparent @ matrix.T
        vectors = vectors - np.cross(turn_rad, vectors)
        camera = camera.with_shared(values)
        predicted, by_rotation, by_shared = camera.derivatives(vectors)
        residual = measured_px - predicted
        normalised2 = np.sum(residual * residual, axis=1) / sigma_px**2
        if iteration < N_ROBUST:
            weight = 1.0 / np.sqrt(1.0 + 0.5 * normalised2)  # derivative of the soft-l1 loss, two coordinates together
        else:
            scale2 = max(float(np.median(normalised2)) / (2.0 * np.log(2.0)), 1.0)
            used = normalised2 < 2.0 * CLIP_SIGMA**2 / 2.0 * scale2
            weight = used.astype(np.float64)
        jacobian = np.concatenate((by_rotation, by_shared), axis=2).reshape(-1, n_parameters)
        row_weight = np.repeat(weight / sigma_px**2, 2)
        data_normal = (jacobian * row_weight[:, None]).T @ jacobian
        normal = data_normal.copy()
        normal[ATTITUDE:, ATTITUDE:] += prior.information
        gradient = jacobian.T @ (row_weight * residual.reshape(-1))
        gradient[ATTITUDE:] += prior.information @ (prior.mean - values)
        step = _solve(normal, gradient)
        matrix = rotation_by(step[:ATTITUDE]) @ matrix
        values = values + step[ATTITUDE:]
    n_free = max(2 * int(used.sum()) - ATTITUDE, 1)
    chi2_nu = float(np.sum((residual[used] / sigma_px[used, None]) ** 2) / n_free)
    cross = data_normal[:ATTITUDE, ATTITUDE:]
    gain = data_normal[ATTITUDE:, ATTITUDE:] - cross.T @ _solve(data_normal[:ATTITUDE, :ATTITUDE], cross)
    return CameraSolution(
        matrix=matrix,
        camera=camera.with_shared(values),
        covariance=_solve(normal, np.eye(n_parameters)) * max(chi2_nu, 1.0),
        information_gain=0.5 * (gain + gain.T) / max(chi2_nu, 1.0),
        used=used,
        residual_px=residual,
        chi2_nu=chi2_nu,
    )


def _solve(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric positive definite system whose unknowns have very different sizes."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    balanced = matrix * scale[:, None] * scale[None, :]
    if right.ndim == 1:
        return np.asarray(scale * np.linalg.solve(balanced, scale * right))
    return np.asarray(scale[:, None] * np.linalg.solve(balanced, scale[:, None] * right))
