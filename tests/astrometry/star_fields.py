"""Star lists made without any code of the ground segment: astropy's GCRS, scipy's rotations, a camera written out here."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord
from astropy.time import Time
from numpy.typing import NDArray
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import AttitudeEstimate, Calibration, FrameHeader, NominalCamera, ObserverState
from sboc_e2e.icd.signals import StarList
from sboc_e2e.icd.tai import from_jd_parts
from tests.downlink import bare_frame

ARCSEC = np.pi / 648000.0
EXPOSURE_NS, LINE_TIME_NS = 200_000_000, 10_000
POSITION_M, VELOCITY_M_S = np.array([7.078e6, 0.0, 0.0]), np.array([0.0, 1500.0, 7350.0])


@dataclass(frozen=True, kw_only=True)
class FieldOptions:
    """How good the telemetry and the star list are, and what the camera is."""

    size: int = 4096
    focal_px: float = 44444.0
    n_stars: int = 300
    false: float = 0.05
    missing: float = 0.3
    pointing_error_arcsec: float = 100.0
    roll_error_deg: float = 0.2
    displaced: bool = True
    attitude: bool = True
    ra_deg: float = 131.5
    dec_deg: float = 17.9
    centroid_scale: float = 1.0
    zero_point_mag: float = 21.68
    catalogue_seed: int = 99
    roll_deg: float | None = None
    """None: drawn."""
    rate_rad_s: tuple[float, float, float] | None = None
    """None: drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Field:
    """A received frame, the calibration, and what is true."""

    frame: DownlinkFrame
    calibration: Calibration
    matrix: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]
    focal_px: float
    center: tuple[float, float]
    distortion: tuple[float, float, float, float]

    def true_directions(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apparent unit vectors of pixels at mid-exposure of their rows, by a general root finder."""
        header = self.frame.header
        out = []
        for r, c in zip(row, col, strict=True):
            wanted = np.array([(c - self.center[1]) / self.focal_px, (r - self.center[0]) / self.focal_px])

            def miss(uv, wanted=wanted):
                return 1e6 * (np.array(_distort(uv[0], uv[1], self.distortion)) - wanted)

            uv = fsolve(miss, wanted, xtol=1e-12)
            vector = np.array([uv[0], uv[1], 1.0]) / np.sqrt(1.0 + uv @ uv)
            seconds = (header.line_time_ns * (r - 0.5 * (header.rows - 1))) * 1e-9
            # the camera has turned by rate * dt: back to where it was at the frame's epoch
            out.append(self.matrix.T @ Rotation.from_rotvec(self.rate_rad_s * seconds).apply(vector))
        return np.array(out)


def make_field(catalogue: StarCatalogue, seed: int, options: FieldOptions = FieldOptions()) -> Field:
    """A frame's star list over real stars, displaced by the catalogue's quoted errors, and wrong telemetry."""
    rng = np.random.default_rng(seed)
    size, middle = options.size, 0.5 * (options.size - 1)
    start = Time("2027-01-29T00:00:00", scale="utc") + 0.25 * seed * u.s
    t_start_ns = from_jd_parts(start.tai.jd1, start.tai.jd2)
    mid_ns = t_start_ns + round(LINE_TIME_NS * middle) + EXPOSURE_NS // 2
    stars = catalogue.cone(options.ra_deg, options.dec_deg, 4.2, epoch_jyear=float(start.jyear))
    # the sky is the same in every frame: the catalogue displaced once by its errors
    displace = (
        np.random.default_rng(options.catalogue_seed).normal(size=(2, len(stars))) * stars.sigma_mas / 3.6e6 * options.displaced
    )
    sky = SkyCoord(
        ra=(stars.ra_deg + displace[0] / np.cos(np.radians(stars.dec_deg))) * u.deg, dec=(stars.dec_deg + displace[1]) * u.deg
    )
    seen_from = GCRS(
        obstime=start + (mid_ns - t_start_ns) * 1e-9 * u.s,
        obsgeoloc=CartesianRepresentation(POSITION_M * u.m),
        obsgeovel=CartesianRepresentation(VELOCITY_M_S * u.m / u.s),
    )
    apparent = sky.transform_to(seen_from).cartesian.xyz.value.T
    apparent = apparent / np.linalg.norm(apparent, axis=1, keepdims=True)

    drawn = float(rng.uniform(-np.pi, np.pi))
    roll = drawn if options.roll_deg is None else np.radians(options.roll_deg)
    matrix = _pointing(options.ra_deg, options.dec_deg, roll)
    rate = rng.normal(0.0, 2e-4, 3)
    if options.rate_rad_s is not None:
        rate = np.array(options.rate_rad_s)
    focal, center = options.focal_px * (1.0 + 150e-6), (middle + 1.8 * size / 4096, middle - 1.3 * size / 4096)
    distortion = (-1.02, 0.0, 3e-5, -1e-5)
    row, col = _project(apparent, matrix, rate, focal, center, distortion, middle)
    inside = np.flatnonzero((row > 0.0) & (row < size - 1.0) & (col > 0.0) & (col < size - 1.0))
    inside = inside[np.argsort(stars.v_mag[inside])]
    inside = inside[rng.random(len(inside)) > options.missing][: options.n_stars]
    flux = 10.0 ** (0.4 * (options.zero_point_mag - stars.v_mag[inside])) * EXPOSURE_NS * 1e-9
    snr = np.minimum(flux / np.sqrt(flux + 90.0), 200.0)
    n_false = int(options.false * len(inside))
    noise = rng.normal(size=(2, len(inside))) * 0.85 / snr * options.centroid_scale
    list_row = np.concatenate((row[inside] + noise[0], rng.uniform(0.0, size, n_false)))
    list_col = np.concatenate((col[inside] + noise[1], rng.uniform(0.0, size, n_false)))
    flux = np.concatenate((flux * (1.0 + rng.normal(size=len(inside)) / snr), rng.choice(flux, n_false)))
    snr = np.concatenate((snr, rng.choice(snr, n_false)))
    order = np.argsort(-flux)
    wrong = Rotation.from_rotvec(
        [*(rng.normal(size=2) * options.pointing_error_arcsec * ARCSEC), rng.normal() * np.radians(options.roll_error_deg)]
    )
    header = FrameHeader(
        frame=seed,
        t_start_tai_ns=t_start_ns,
        exposure_ns=EXPOSURE_NS,
        line_time_ns=LINE_TIME_NS,
        rows=size,
        cols=size,
        gain_e_adu=1.0,
        read_noise_e=2.3,
        attitude=AttitudeEstimate(
            quaternion=Rotation.from_matrix(wrong.as_matrix() @ matrix).as_quat(),
            rate_rad_s=rate,
            covariance_rad2=np.eye(3) * (options.pointing_error_arcsec * ARCSEC) ** 2,
        )
        if options.attitude
        else None,
        observer=ObserverState(
            tai_ns=mid_ns, position_m=POSITION_M, velocity_m_s=VELOCITY_M_S, sigma_position_m=10.0, sigma_velocity_m_s=0.1
        ),
    )
    frame = bare_frame(
        header,
        stars=StarList(row=list_row[order], col=list_col[order], flux_e=flux[order], snr=snr[order], flags=np.zeros(len(order))),
    )
    return Field(
        frame=frame,
        calibration=_calibration(options),
        matrix=matrix,
        rate_rad_s=rate,
        focal_px=focal,
        center=center,
        distortion=distortion,
    )


def grid(size: int, n: int = 9) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows and cols of an n x n grid over the frame."""
    line = np.linspace(0.0, size - 1.0, n)
    row, col = np.meshgrid(line, line, indexing="ij")
    return row.ravel(), col.ravel()


def _pointing(ra_deg: float, dec_deg: float, roll_rad: float) -> NDArray[np.float64]:
    """GCRS to camera frame of a camera that looks there."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    boresight = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    x = np.cross([0.0, 0.0, 1.0], boresight)
    x /= np.linalg.norm(x)
    return Rotation.from_rotvec([0.0, 0.0, roll_rad]).as_matrix() @ np.array([x, np.cross(boresight, x), boresight])


def _distort(u_tangent, v_tangent, distortion):
    k1, k2, p1, p2 = distortion
    r2 = u_tangent**2 + v_tangent**2
    radial = 1.0 + k1 * r2 + k2 * r2**2
    return (
        u_tangent * radial + 2.0 * p1 * u_tangent * v_tangent + p2 * (r2 + 2.0 * u_tangent**2),
        v_tangent * radial + p1 * (r2 + 2.0 * v_tangent**2) + 2.0 * p2 * u_tangent * v_tangent,
    )


def _project(apparent, matrix, rate, focal, center, distortion, middle):
    """Rows and cols, each star seen at mid-exposure of the row it falls on."""
    at_epoch = apparent @ matrix.T
    moved = at_epoch
    for _ in range(3):
        u_seen, v_seen = _distort(moved[:, 0] / moved[:, 2], moved[:, 1] / moved[:, 2], distortion)
        row, col = center[0] + focal * v_seen, center[1] + focal * u_seen
        seconds = LINE_TIME_NS * 1e-9 * (row - middle)
        moved = Rotation.from_rotvec(-rate * seconds[:, None]).apply(at_epoch)
    behind = at_epoch[:, 2] < 0.5
    return np.where(behind, -1.0, row), np.where(behind, -1.0, col)


def _calibration(options: FieldOptions) -> Calibration:
    shape = (options.size, options.size)
    camera = NominalCamera(
        name="test",
        rows=options.size,
        cols=options.size,
        focal_px=options.focal_px,
        center_row=0.5 * (options.size - 1),
        center_col=0.5 * (options.size - 1),
        k1=-1.0,
        psf_sigma_px=0.85,
        gain_e_adu=1.0,
        read_noise_e=2.3,
        saturation_adu=65000.0,
        full_well_e=39e3,
        zero_point_e_s=10.0 ** (0.4 * (options.zero_point_mag - 0.03)),
        aperture_m=0.2,
    )
    return Calibration(
        camera=camera,
        dark_adu=np.broadcast_to(np.float32(0.0), shape),
        flat=np.broadcast_to(np.float32(1.0), shape),
        defects=np.broadcast_to(np.uint8(0), shape),
    )
