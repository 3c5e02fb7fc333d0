"""Least squares of a frame's attitude and of the run's shared camera parameters against matched stars.

Robust first (soft-l1 weights, iterated), then stars beyond `CLIP_SIGMA` are dropped and the rest is fitted with Gaussian
weights, so that the covariance is calibrated.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.camera import ATTITUDE, SHARED, Camera
from ground.sky.rotation import rotation_by

Array = NDArray[np.float64]

CLIP_SIGMA: Final = 4.5
"""Of one coordinate; a distance beyond it has chance exp(-4.5^2 / 2) = 4e-5, below one of the 600 stars of a fit."""
N_ROBUST: Final = 6
"""Steps with soft-l1 weights, enough for Newton to settle before stars are dropped; chosen, not measured."""
N_GAUSSIAN: Final = 4
"""Steps with the remaining stars, in which the set that is kept settles; chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPrior:
    """Gaussian knowledge of the shared parameters: mean (5,) and information (inverse covariance) matrix (5, 5)."""

    mean: Array
    information: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraSolution:
    """Result of `fit_camera`.

    matrix : (3, 3) GCRS to camera frame. covariance_rad2 : (3, 3) of the rotation (camera frame) for known shared parameters,
    response : (3, 5) by how much it turns when those change. gradient : (5,), information : (5, 5) log-likelihood of the shared
    parameters about those of `camera`, attitude unknown; catalogue : (5, 5) share of the information's noise that frames
    of the same stars have in common. All scaled by the residuals where those are larger than expected. used : (n,) bool, stars
    kept.
    residual_px : (n, 2), residual_response : (n, 2, 5) its change with the shared parameters, attitude following; all stars.
    """

    matrix: Array
    camera: Camera
    covariance_rad2: Array
    response: Array
    gradient: Array
    information: Array
    catalogue: Array
    used: NDArray[np.bool_]
    residual_px: Array
    residual_response: Array
    chi2_nu: float

    def with_shared(self, values: Array, errors: Array) -> "CameraSolution":
        """The solution for other shared parameters (5,) with this covariance (5, 5): the attitude follows them."""
        change = values - self.camera.shared()
        focal_px = float(np.exp(values[0]))
        camera = replace(self.camera.with_shared(values), focal_err_px=focal_px * float(np.sqrt(errors[0, 0])))
        return replace(
            self,
            matrix=rotation_by(self.response @ change) @ self.matrix,
            camera=camera,
            covariance_rad2=self.covariance_rad2 + self.response @ errors @ self.response.T,
            gradient=self.gradient - self.information @ change,
            residual_px=self.residual_px + self.residual_response @ change,
        )


def fit_camera(
    measured_px: Array,
    apparent: Array,
    turn_rad: Array,
    sigma_px: Array,
    *,
    catalogue_px: Array,
    matrix: Array,
    camera: Camera,
    prior: CameraPrior,
) -> CameraSolution:
    """Attitude and camera from matched stars.

    measured_px : (n, 2) row and col. apparent : (n, 3) unit vectors, GCRS. turn_rad : (n, 3) rotation of the camera frame
    between the frame's epoch and each star's row epoch. sigma_px : (n,) error of each coordinate, catalogue_px : (n,) the
    part of it that comes from the catalogue. matrix, camera : start.
    """
    n_parameters = ATTITUDE + len(SHARED)
    values = camera.shared()
    used = np.ones(len(measured_px), dtype=bool)
    weight = np.ones(len(measured_px))
    residual, row_weight = np.zeros((len(measured_px), 2)), np.zeros(2 * len(measured_px))
    jacobian, data_normal = np.zeros((2 * len(measured_px), n_parameters)), np.zeros((n_parameters, n_parameters))
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
    return _solution(
        jacobian,
        row_weight,
        residual,
        _lasting_px(sigma_px, catalogue_px, chi2_nu, n_free),
        used=used,
        chi2_nu=chi2_nu,
        matrix=matrix,
        camera=camera.with_shared(values),
    )


def _lasting_px(sigma_px: Array, catalogue_px: Array, chi2_nu: float, n_free: int) -> Array:
    """(n,) part of the errors that frames of the same stars share: errors of the catalogue, and excess scatter of the residuals.

    Blends and a PSF of few pixels shift a star by the same in each such frame. Chance alone (two sigma of chi2) is no excess.
    """
    excess = max(chi2_nu - 1.0 - 2.0 * float(np.sqrt(2.0 / n_free)), 0.0)
    return np.asarray(np.sqrt(catalogue_px**2 + excess * sigma_px**2))


def _solution(
    jacobian: Array,
    row_weight: Array,
    residual: Array,
    lasting_px: Array,
    *,
    used: NDArray[np.bool_],
    chi2_nu: float,
    matrix: Array,
    camera: Camera,
) -> CameraSolution:
    """Solution of the linear model of the last step: attitude for known shared parameters, and these with the attitude
    unknown."""
    scale = max(chi2_nu, 1.0)
    by_rotation, by_shared = jacobian[:, :ATTITUDE], jacobian[:, ATTITUDE:]
    normal = (by_rotation * row_weight[:, None]).T @ by_rotation
    response = -_solve(normal, (by_rotation * row_weight[:, None]).T @ by_shared)
    # shared parameters with the attitude following them
    free = by_shared + by_rotation @ response
    weighted = free * row_weight[:, None]
    information, noise = weighted.T @ free / scale, np.repeat(lasting_px, 2)[:, None] * weighted / scale
    return CameraSolution(
        matrix=matrix,
        camera=camera,
        covariance_rad2=_solve(normal, np.eye(ATTITUDE)) * scale,
        response=response,
        gradient=weighted.T @ residual.reshape(-1) / scale,
        information=0.5 * (information + information.T),
        catalogue=noise.T @ noise,
        used=used,
        residual_px=residual,
        residual_response=-free.reshape(-1, 2, by_shared.shape[1]),
        chi2_nu=chi2_nu,
    )


def _solve(matrix: Array, right: Array) -> Array:
    """Solution of a symmetric positive definite system whose unknowns have very different sizes."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    balanced = matrix * scale[:, None] * scale[None, :]
    if right.ndim == 1:
        return np.asarray(scale * np.linalg.solve(balanced, scale * right))
    return np.asarray(scale[:, None] * np.linalg.solve(balanced, scale[:, None] * right))
