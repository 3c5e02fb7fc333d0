"""Astrometry of another laboratory: TAN-SIP through astropy's WCS, fitted to each frame alone.

It starts from the telemetered attitude, finds the common offset of list and catalogue, and fits cubic polynomials to the pairs.
"""

from dataclasses import dataclass, field
from typing import Any

import astropy.units as u
import numpy as np
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord
from astropy.time import Time
from astropy.wcs import WCS, Sip
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from sboc_e2e.icd.camera import CameraParameter
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader, NominalCamera
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.tai import to_jd_parts

Array = NDArray[np.float64]

ORDER = 3
POWERS = tuple((p, n - p) for n in range(2, ORDER + 1) for p in range(n, -1, -1))
"""Powers of col and row offset in the SIP polynomials."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TanSip:
    """A camera as FITS headers have it: reference pixel, matrix (deg/px) and SIP coefficients of `POWERS`.

    The tangent point is the boresight; standard coordinates grow with col and row.
    """

    row: float
    col: float
    matrix: Array
    a: Array
    b: Array

    def unproject(self, row: Array, col: Array) -> Array:
        """Unit vectors (n, 3) in the camera frame."""
        lon, lat = np.radians(self._wcs().all_pix2world(col, row, 0))
        return np.stack((np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)), axis=-1)

    def project(self, vectors: Array) -> tuple[Array, Array]:
        """Rows and cols (n,); NaN for directions more than 60 deg off the boresight."""
        x, y, z = (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).T
        seen = z > 0.5
        row, col = np.full(len(z), np.nan), np.full(len(z), np.nan)
        lon, lat = np.degrees(np.arctan2(x[seen], z[seen])), np.degrees(np.arcsin(y[seen]))
        if seen.any():
            col[seen], row[seen] = self._wcs().all_world2pix(lon, lat, 0, tolerance=1e-6, maxiter=50, quiet=True)
        return row, col

    def parameters(self) -> tuple[CameraParameter, ...]:
        """Reference pixel, matrix and coefficients, named as in FITS."""
        cd = [
            CameraParameter(name=f"cd{i + 1}_{j + 1}", value=float(self.matrix[i, j]), unit="deg") for i in (0, 1) for j in (0, 1)
        ]
        sip = [
            CameraParameter(name=f"{name}_{p}_{q}", value=float(value))
            for name, values in (("a", self.a), ("b", self.b))
            for (p, q), value in zip(POWERS, values, strict=True)
        ]
        place = (("crpix_row", self.row), ("crpix_col", self.col))
        return (*(CameraParameter(name=name, value=value, unit="pix") for name, value in place), *cd, *sip)

    def _wcs(self) -> WCS:
        wcs = WCS(naxis=2)
        wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN-SIP", "DEC--TAN-SIP"], [0.0, 0.0]
        wcs.wcs.crpix, wcs.wcs.cd = [self.col + 1.0, self.row + 1.0], self.matrix
        sip = np.zeros((2, ORDER + 1, ORDER + 1))
        for (p, q), a, b in zip(POWERS, self.a, self.b, strict=True):
            sip[:, p, q] = a, b
        wcs.sip = Sip(sip[0], sip[1], None, None, wcs.wcs.crpix)
        wcs.wcs.set()
        return wcs


@dataclass(frozen=True, kw_only=True)
class SipAstrometry:
    """Solves each frame for itself."""

    reach_px: float = field(default=12.0, metadata={"doc": "error of the telemetered pointing", "min": 1.0, "max": 200.0})

    def initial_state(self, calibration: Calibration, catalogue: Any) -> tuple[NominalCamera, Any]:
        """What stays: nominal camera and catalogue."""
        return calibration.camera, catalogue

    def solve(self, state: tuple[NominalCamera, Any], frame: DownlinkFrame) -> tuple[Any, FrameSolution]:
        """A solution from thirty or more stars."""
        nominal, catalogue = state
        header, stars = frame.header, frame.stars
        if header.attitude is None or header.observer is None or len(stars) < 30:
            return state, _solution(frame, nominal_camera(nominal), None)
        attitude = Rotation.from_quat(header.attitude.quaternion)
        boresight = attitude.inv().apply([0.0, 0.0, 1.0])
        radius = np.degrees(np.hypot(header.rows, header.cols) / 2.0 / nominal.focal_px) + 0.2
        place = np.degrees(np.arctan2(boresight[1], boresight[0])), np.degrees(np.arcsin(boresight[2]))
        known = catalogue.cone(*place, radius, epoch_jyear=_middle(header).jyear)
        seen = attitude.apply(_apparent(known, header))
        camera = nominal_camera(nominal)
        row = camera.project(seen)[0]
        delay = (header.line_time_ns * (row - 0.5 * (header.rows - 1))) * 1e-9
        seen = seen - np.cross(np.asarray(header.attitude.rate_rad_s) * delay[:, None], seen)
        listed = np.column_stack((stars.row, stars.col))
        predicted = np.column_stack(camera.project(seen))
        predicted += _offset(listed, predicted, self.reach_px)
        fitted = None
        for radius_px in (4.0, 1.5, 1.0):
            distance, nearest = cKDTree(predicted).query(listed, distance_upper_bound=radius_px)
            _, back = cKDTree(listed).query(predicted)
            pair = np.flatnonzero(np.isfinite(distance))
            pair = pair[back[nearest[pair]] == pair]
            if len(pair) < 30:
                return state, _solution(frame, camera, None)
            fitted = _fitted(listed[pair], seen[nearest[pair]], header)
            predicted = np.column_stack(fitted.project(seen))
        chosen = nearest[pair]
        return state, _solution(frame, fitted, (pair, known.v_mag[chosen], known.b_v[chosen], listed[pair] - predicted[chosen]))


def nominal_camera(camera: NominalCamera) -> TanSip:
    """The nominal camera with its radial distortion: pixels to directions to third order."""
    scale, none = np.degrees(1.0 / camera.focal_px), np.zeros(len(POWERS))
    radial = -camera.k1 / camera.focal_px**2
    a, b = none.copy(), none.copy()
    for (p, q), k in zip(POWERS, range(len(POWERS)), strict=True):
        a[k] = radial * ((p, q) in ((3, 0), (1, 2)))
        b[k] = radial * ((p, q) in ((0, 3), (2, 1)))
    return TanSip(row=camera.center_row, col=camera.center_col, matrix=scale * np.eye(2), a=a, b=b)


def _middle(header: FrameHeader) -> Time:
    middle = header.t_start_tai_ns + header.line_time_ns * (header.rows - 1) // 2 + header.exposure_ns // 2
    return Time(*to_jd_parts(middle), format="jd", scale="tai")


def _apparent(stars: Any, header: FrameHeader) -> Array:
    """Apparent directions by astropy."""
    observer = header.observer
    assert observer is not None
    seen_from = GCRS(
        obstime=_middle(header),
        obsgeoloc=CartesianRepresentation(np.asarray(observer.position_m) * u.m),
        obsgeovel=CartesianRepresentation(np.asarray(observer.velocity_m_s) * u.m / u.s),
    )
    sky = SkyCoord(ra=stars.ra_deg * u.deg, dec=stars.dec_deg * u.deg)
    vectors = sky.transform_to(seen_from).cartesian.xyz.value.T
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _offset(listed: Array, predicted: Array, reach_px: float) -> Array:
    """The offset (row, col) that most pairs agree on."""
    pairs = cKDTree(predicted).query_ball_point(listed, reach_px)
    offsets = np.concatenate([listed[k] - predicted[found] for k, found in enumerate(pairs) if found])
    crowd = [len(found) for found in cKDTree(offsets).query_ball_point(offsets, 1.0)]
    best = offsets[int(np.argmax(crowd))]
    return np.asarray(np.median(offsets[np.hypot(*(offsets - best).T) < 1.0], axis=0))


def _fitted(pixels: Array, vectors: Array, header: FrameHeader) -> TanSip:
    """Least squares of standard coordinates on polynomials of pixels, about the place of the boresight."""
    standard = np.degrees(vectors[:, :2] / vectors[:, 2:])
    place, half = np.array([0.5 * (header.rows - 1), 0.5 * (header.cols - 1)]), 0.5 * max(header.rows, header.cols)
    powers = ((1, 0), (0, 1), *POWERS)
    scale = np.array([half ** -(p + q) for p, q in powers])
    for _ in range(4):
        v, w = ((pixels - place) / half).T
        design = np.stack([np.ones(len(v)), *[w**p * v**q for p, q in powers]], axis=1)
        terms = np.linalg.lstsq(design, standard, rcond=None)[0]
        linear = terms[1:] * scale[:, None]
        # the reference pixel goes where the constants vanish
        place = place + np.linalg.solve(linear[:2].T, -terms[0])[::-1]
    matrix = linear[:2].T
    sip = np.linalg.solve(matrix, linear[2:].T)
    return TanSip(row=float(place[0]), col=float(place[1]), matrix=matrix, a=sip[0], b=sip[1])


def _solution(frame: DownlinkFrame, camera: TanSip, matched: tuple[Array, Array, Array, Array] | None) -> FrameSolution:
    """The contract's record; without matches NO_SOLUTION."""
    index, v_mag, b_v, residual = matched if matched is not None else (np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, 2)))
    attitude, n = frame.header.attitude, len(index)
    rms = float(np.sqrt(np.mean(residual**2))) if n else float("nan")
    sigma = rms * np.radians(abs(np.linalg.det(camera.matrix)) ** 0.5) / np.sqrt(max(n, 1))
    return FrameSolution(
        frame=frame.header.frame,
        flags=FrameFlag(0) if n else FrameFlag.NO_SOLUTION,
        quaternion=np.array([0.0, 0.0, 0.0, 1.0]) if attitude is None else np.asarray(attitude.quaternion),
        rate_rad_s=np.zeros(3) if attitude is None else np.asarray(attitude.rate_rad_s),
        covariance_rad2=np.eye(3) * sigma**2,
        camera=camera,
        n_stars=n,
        rms_px=rms,
        star_index=index.astype(np.int32),
        star_v_mag=v_mag.astype(np.float32),
        star_b_v=b_v.astype(np.float32),
        star_residual_px=residual.astype(np.float32),
    )
