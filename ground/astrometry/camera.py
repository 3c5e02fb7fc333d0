"""Camera model of `camera_fit`: directions of the camera frame to pixels and back (`CameraModel`), with derivatives.

Gnomonic projection u = x/z (-x/z in a mirrored image), v = y/z, then Brown-Conrady distortion (Brown 1966, Photogrammetric
Engineering 32, 444) as `sboc_e2e.icd.frame.NominalCamera` defines it in words. Parameters that are fitted are held in one vector.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.camera import CameraParameter
from sboc_e2e.icd.frame import NominalCamera

Array = NDArray[np.float64]

SHARED: Final = ("ln focal", "k1", "k2", "p1", "p2")
"""Parameters shared by all frames of a run, in the order of `Camera.shared`."""

ATTITUDE: Final = 3
"""Parameters of each frame: the small rotation in the camera frame."""

CONVERGED: Final = 1e-9
"""Step of Newton's iteration, tangent, after which no other is needed."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Focal length and optical axis in pixels, distortion for tangents in radians.

    mirrored : columns grow against +X of the camera frame, as after an odd number of reflections.
    focal_err_px : one sigma of the focal length; NaN for a camera that was not fitted.
    """

    focal_px: float
    center_row: float
    center_col: float
    k1: float
    k2: float
    p1: float
    p2: float
    mirrored: bool = False
    focal_err_px: float = float("nan")

    @classmethod
    def nominal(cls, camera: NominalCamera) -> "Camera":
        """The camera as calibration has it."""
        return cls(
            focal_px=camera.focal_px,
            center_row=camera.center_row,
            center_col=camera.center_col,
            k1=camera.k1,
            k2=camera.k2,
            p1=camera.p1,
            p2=camera.p2,
        )

    def parameters(self) -> tuple[CameraParameter, ...]:
        """Columns of the published table of frames."""
        distortion = "Brown-Conrady distortion"
        return (
            CameraParameter(name="focal_px", value=self.focal_px, unit="pix", description="focal length"),
            CameraParameter(name="focal_err_px", value=self.focal_err_px, unit="pix", description="its error"),
            CameraParameter(name="center_row", value=self.center_row, unit="pix", description="optical axis"),
            CameraParameter(name="center_col", value=self.center_col, unit="pix", description="optical axis"),
            CameraParameter(name="k1", value=self.k1, description=distortion),
            CameraParameter(name="k2", value=self.k2, description=distortion),
            CameraParameter(name="p1", value=self.p1, description=distortion),
            CameraParameter(name="p2", value=self.p2, description=distortion),
            CameraParameter(name="mirrored", value=self.mirrored, description="columns grow against the camera's +X"),
        )

    def shared(self) -> Array:
        """(5,) parameters in the order of `SHARED`."""
        return np.array([np.log(self.focal_px), self.k1, self.k2, self.p1, self.p2])

    def with_shared(self, values: Array) -> "Camera":
        """The camera with other shared parameters."""
        log_focal, k1, k2, p1, p2 = (float(v) for v in values)
        return replace(self, focal_px=float(np.exp(log_focal)), k1=k1, k2=k2, p1=p1, p2=p2)

    def project(self, vectors: Array) -> tuple[Array, Array]:
        """Rows and cols (n,) of camera-frame vectors (n, 3); NaN for those behind the camera."""
        z = np.where(vectors[:, 2] > 1e-3, vectors[:, 2], np.nan)
        u, v = self._hand * vectors[:, 0] / z, vectors[:, 1] / z
        du, dv = self._distorted(u, v)
        return self.center_row + self.focal_px * dv, self.center_col + self.focal_px * du

    def unproject(self, row: Array, col: Array) -> Array:
        """Unit camera-frame vectors (n, 3) of pixels; Newton's iteration, 1e-13 rad for distortions below 10 %.

        The last step of the iteration squares the error of the one before, so steps below its root need no other.
        """
        u_seen = (np.asarray(col, dtype=np.float64) - self.center_col) / self.focal_px
        v_seen = (np.asarray(row, dtype=np.float64) - self.center_row) / self.focal_px
        u, v = u_seen.copy(), v_seen.copy()
        for _ in range(5):
            du, dv = self._distorted(u, v)
            a, b, c = self._distortion_slopes(u, v)
            determinant = a * c - b * b
            ru, rv = u_seen - du, v_seen - dv
            step_u, step_v = (c * ru - b * rv) / determinant, (a * rv - b * ru) / determinant
            u, v = u + step_u, v + step_v
            if max(float(np.abs(step_u).max(initial=0.0)), float(np.abs(step_v).max(initial=0.0))) < CONVERGED:
                break
        vectors = np.stack((self._hand * u, v, np.ones_like(u)), axis=-1)
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))

    def derivatives(self, vectors: Array) -> tuple[Array, Array, Array]:
        """Predicted (n, 2) row and col, with derivatives (n, 2, 3) by rotation and (n, 2, 5) by shared parameters."""
        hand = self._hand
        u, v = hand * vectors[:, 0] / vectors[:, 2], vectors[:, 1] / vectors[:, 2]
        r2 = u * u + v * v
        du, dv = self._distorted(u, v)
        a, b, c = self._distortion_slopes(u, v)
        f = self.focal_px
        # a rotation theta moves the vector by theta x vector; divided by z this moves (u, v) by
        by_u = np.stack((-u * v, hand * (1.0 + u * u), -hand * v), axis=1)
        by_v = np.stack((-(1.0 + v * v), hand * u * v, hand * u), axis=1)
        rotation = f * np.stack((b[:, None] * by_u + c[:, None] * by_v, a[:, None] * by_u + b[:, None] * by_v), axis=1)
        shared = f * np.stack(
            (
                np.stack((dv, v * r2, v * r2 * r2, r2 + 2.0 * v * v, 2.0 * u * v), axis=1),
                np.stack((du, u * r2, u * r2 * r2, 2.0 * u * v, r2 + 2.0 * u * u), axis=1),
            ),
            axis=1,
        )
        return np.stack((self.center_row + f * dv, self.center_col + f * du), axis=1), rotation, shared

    @property
    def _hand(self) -> float:
        """Sign of columns along +X."""
        return -1.0 if self.mirrored else 1.0

    def _distorted(self, u: Array, v: Array) -> tuple[Array, Array]:
        r2 = u * u + v * v
        radial = 1.0 + r2 * (self.k1 + r2 * self.k2)
        uv2 = 2.0 * u * v
        return (
            u * radial + self.p1 * uv2 + self.p2 * (r2 + 2.0 * u * u),
            v * radial + self.p1 * (r2 + 2.0 * v * v) + self.p2 * uv2,
        )

    def _distortion_slopes(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """d u'/du, d u'/dv = d v'/du, d v'/dv."""
        r2 = u * u + v * v
        radial = 1.0 + r2 * (self.k1 + r2 * self.k2)
        bend = 2.0 * (self.k1 + 2.0 * self.k2 * r2)
        return (
            radial + bend * u * u + 2.0 * self.p1 * v + 6.0 * self.p2 * u,
            bend * u * v + 2.0 * self.p1 * u + 2.0 * self.p2 * v,
            radial + bend * v * v + 6.0 * self.p1 * v + 2.0 * self.p2 * u,
        )
