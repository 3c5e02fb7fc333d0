"""The one coordinate module: directions of the camera frame to pixels and back.

Pixels are (row, col), 0-based, the centre of pixel (0, 0) is (0.0, 0.0). The camera frame has +Z along the boresight,
+X to growing col, +Y to growing row. Gnomonic projection ``u = x/z, v = y/z``, then Brown-Conrady distortion
(Brown 1966, Photogrammetric Engineering 32, 444)

    u' = u (1 + k1 r2 + k2 r2^2) + 2 p1 u v + p2 (r2 + 2 u^2)
    v' = v (1 + k1 r2 + k2 r2^2) + p1 (r2 + 2 v^2) + 2 p2 u v

and ``col = center_col + focal_px u'``, ``row = center_row + focal_px v'``. A SIP polynomial, where given, stands between these
and the pixels (`simulator.optics.sip`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulator.optics.sip import Sip

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Distortion:
    """Radial and tangential coefficients of Brown and Conrady, for the tangent of the angle."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Projection:
    """A camera's geometry in detector pixels (or delivered ones after `binned`)."""

    focal_px: float
    center_row: float
    center_col: float
    distortion: Distortion = Distortion()
    sip: Sip | None = None

    def to_pixels(self, vectors: Array) -> tuple[Array, Array]:
        """Rows and cols (n,) of camera-frame vectors (n, 3) of any length.

        NaN for those behind the camera, and for those so far out that the distortion polynomial folds back into the field.
        """
        z = np.where(vectors[..., 2] > 0.0, vectors[..., 2], np.nan)
        u, v = vectors[..., 0] / z, vectors[..., 1] / z
        u = np.where(u * u + v * v < self.fold_r2, u, np.nan)
        return self.tangent_to_pixels(u, v)

    @cached_property
    def fold_r2(self) -> float:
        """Squared tangent at which radial distortion stops growing outwards: first root of ``1 + 3 k1 x + 5 k2 x^2``."""
        roots = np.roots([5.0 * self.distortion.k2, 3.0 * self.distortion.k1, 1.0])
        ahead = [float(x.real) for x in roots if abs(x.imag) < 1e-12 and x.real > 0.0]
        return min(ahead, default=np.inf)

    def tangent_to_pixels(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Rows and cols of undistorted tangent-plane coordinates (radians of tangent)."""
        d = self.distortion
        r2 = u * u + v * v
        radial = 1.0 + r2 * (d.k1 + r2 * d.k2)
        u_distorted = u * radial + 2.0 * d.p1 * u * v + d.p2 * (r2 + 2.0 * u * u)
        v_distorted = v * radial + d.p1 * (r2 + 2.0 * v * v) + 2.0 * d.p2 * u * v
        along_col, along_row = self.focal_px * u_distorted, self.focal_px * v_distorted
        if self.sip is not None:
            along_col, along_row = self.sip.pixel_offsets(along_col, along_row)
        return self.center_row + along_row, self.center_col + along_col

    def pixels_to_tangent(self, row: Array, col: Array) -> tuple[Array, Array]:
        """Undistorted (u, v) of pixels, by Newton's method on the distortion (converges to 1e-15 in 5 steps)."""
        along_col = np.asarray(col, dtype=np.float64) - self.center_col
        along_row = np.asarray(row, dtype=np.float64) - self.center_row
        if self.sip is not None:
            along_col, along_row = self.sip.corrected_offsets(along_col, along_row)
        target_u, target_v = along_col / self.focal_px, along_row / self.focal_px
        u, v, d = target_u.copy(), target_v.copy(), self.distortion
        for _ in range(6):
            r2 = u * u + v * v
            radial = 1.0 + r2 * (d.k1 + r2 * d.k2)
            slope = 2.0 * (d.k1 + 2.0 * d.k2 * r2)
            fu = u * radial + 2.0 * d.p1 * u * v + d.p2 * (r2 + 2.0 * u * u) - target_u
            fv = v * radial + d.p1 * (r2 + 2.0 * v * v) + 2.0 * d.p2 * u * v - target_v
            uu = radial + slope * u * u + 2.0 * d.p1 * v + 6.0 * d.p2 * u
            vv = radial + slope * v * v + 6.0 * d.p1 * v + 2.0 * d.p2 * u
            uv = slope * u * v + 2.0 * d.p1 * u + 2.0 * d.p2 * v
            det = uu * vv - uv * uv
            u, v = u - (vv * fu - uv * fv) / det, v - (uu * fv - uv * fu) / det
        return u, v

    def to_vectors(self, row: Array, col: Array) -> Array:
        """Unit camera-frame vectors (n, 3) of pixels."""
        u, v = self.pixels_to_tangent(row, col)
        vectors = np.stack([u, v, np.ones_like(u)], axis=-1)
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)

    def delivered(self, *, bin_rows: int, bin_cols: int, window_row0: int, window_col0: int) -> "Projection":
        """The same camera in delivered pixels, square binning only (focal_px is one number).

        A delivered pixel's centre is the mean of its detector pixels' centres.
        """
        return Projection(
            focal_px=self.focal_px / bin_cols,
            center_row=(self.center_row - window_row0 - 0.5 * (bin_rows - 1)) / bin_rows,
            center_col=(self.center_col - window_col0 - 0.5 * (bin_cols - 1)) / bin_cols,
            distortion=self.distortion,
            sip=None if self.sip is None else self.sip.in_pixels_of(bin_cols),
        )


def without_sip(projection: Projection, rows: int, cols: int) -> Projection:
    """The Brown-Conrady camera nearest to one with SIP: least squares of pixel positions on 33 x 33 places of the detector.

    All its parameters, the axis and the focal length included, are free; the position is linear in ``f, f k1, f k2, f p1, f p2``.
    What no such camera has (SIP terms without radial or tangential symmetry) stays as error of those who use it.
    """
    row, col = (v.ravel() for v in np.meshgrid(np.linspace(0, rows - 1, 33), np.linspace(0, cols - 1, 33), indexing="ij"))
    u, v = projection.pixels_to_tangent(row, col)
    r2, one, none = u * u + v * v, np.ones_like(u), np.zeros_like(u)
    of_col = [none, one, u, u * r2, u * r2**2, 2.0 * u * v, r2 + 2.0 * u * u]
    of_row = [one, none, v, v * r2, v * r2**2, r2 + 2.0 * v * v, 2.0 * u * v]
    design = np.concatenate([np.stack(of_row, axis=1), np.stack(of_col, axis=1)])
    scale = np.abs(design).max(axis=0)
    center_row, center_col, focal, *terms = np.linalg.lstsq(design / scale, np.concatenate([row, col]), rcond=None)[0] / scale
    k1, k2, p1, p2 = (float(t / focal) for t in terms)
    return Projection(
        focal_px=float(focal),
        center_row=float(center_row),
        center_col=float(center_col),
        distortion=Distortion(k1=k1, k2=k2, p1=p1, p2=p2),
    )
