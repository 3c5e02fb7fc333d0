"""A small simulation of streaks for linking tests, written apart from the simulator: straight relative motion in space, a
gnomonic camera with a rolling shutter, noise on the ends, missed frames, false streaks, edges."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement

T0_NS = 2_178_000_000 * 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera that stares at one inertial direction; +Y (rows) towards south, +X (cols) towards west of `ra0, dec0`."""

    rows: int = 4096
    cols: int = 4096
    focal_px: float = 44444.0
    exposure_s: float = 0.2
    line_time_s: float = 10e-6
    cadence_s: float = 0.25
    ra0_deg: float = 128.0
    dec0_deg: float = 18.0

    def axes(self) -> NDArray[np.float64]:
        """Rows: +X, +Y, +Z of the camera in the inertial frame."""
        ra, dec = np.radians(self.ra0_deg), np.radians(self.dec0_deg)
        z = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        east = np.array([-np.sin(ra), np.cos(ra), 0.0])
        return np.array([-east, -np.cross(z, east), z])

    def header(self, frame: int) -> FrameHeader:
        """Header without telemetry."""
        return FrameHeader(
            frame=frame,
            t_start_tai_ns=T0_NS + round(frame * self.cadence_s * 1e9),
            exposure_ns=round(self.exposure_s * 1e9),
            line_time_ns=round(self.line_time_s * 1e9),
            rows=self.rows,
            cols=self.cols,
        )

    def radec(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sky of pixels."""
        x = (np.asarray(col) - 0.5 * (self.cols - 1)) / self.focal_px
        y = (np.asarray(row) - 0.5 * (self.rows - 1)) / self.focal_px
        v = np.stack([x, y, np.ones_like(x)], axis=-1) @ self.axes()
        dec_deg = np.degrees(np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1])))
        return np.degrees(np.arctan2(v[..., 1], v[..., 0])) % 360.0, dec_deg


@dataclass(frozen=True, kw_only=True, eq=False)
class Mover:
    """Relative position (km) at t = 0 and velocity (km/s) in the camera frame."""

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]

    def pixel(self, camera: Camera, t_s: float) -> tuple[float, float, float]:
        """Row, col and depth."""
        p = self.position + self.velocity * t_s
        return (
            0.5 * (camera.rows - 1) + camera.focal_px * p[1] / p[2],
            0.5 * (camera.cols - 1) + camera.focal_px * p[0] / p[2],
            float(p[2]),
        )


@dataclass(kw_only=True)
class Truth:
    """What the simulation knows of each streak: object (-1: false), and whether end 0 came first."""

    owner: list[int] = field(default_factory=list)
    end0_first: list[bool] = field(default_factory=list)
    epochs_s: list[tuple[float, float]] = field(default_factory=list)


def pixel_mover(
    camera: Camera,
    row: float,
    col: float,
    v_row: float,
    v_col: float,
    *,
    t_s: float,
    range_km: float = 500.0,
    range_rate_km_s: float = 0.0,
) -> Mover:
    """The mover that is at a pixel at t_s with a pixel velocity (px/s)."""
    x = (col - 0.5 * (camera.cols - 1)) / camera.focal_px
    y = (row - 0.5 * (camera.rows - 1)) / camera.focal_px
    p = range_km * np.array([x, y, 1.0])
    v = range_km * np.array([v_col, v_row, 0.0]) / camera.focal_px + range_rate_km_s * np.array([x, y, 1.0])
    return Mover(position=p - v * t_s, velocity=v)


def mover_somewhere(
    camera: Camera, rng: np.random.Generator, span_s: float, velocity_px_s: tuple[float, float], range_km: float, closing: float
) -> Mover:
    """The mover of a pixel velocity (along rows and cols) that is at a random pixel at a random time of the span."""
    row, col, t_s = rng.random() * camera.rows, rng.random() * camera.cols, rng.random() * span_s
    return pixel_mover(camera, row, col, *velocity_px_s, t_s=t_s, range_km=range_km, range_rate_km_s=closing)


def _shutter_times(camera: Camera, mover: Mover, t_start: float) -> tuple[float, float]:
    """Epochs between which the row under the object is open, by root finding on g(t) = t - t_start - tau row(t)."""

    def g(t: float) -> float:
        return t - t_start - camera.line_time_s * mover.pixel(camera, t)[0]

    span = abs(camera.line_time_s) * camera.rows + camera.exposure_s
    low, high = t_start - span, t_start + 2 * span
    try:
        t_open = brentq(g, low, high, xtol=1e-12)
        t_close = brentq(lambda t: g(t) - camera.exposure_s, low, high, xtol=1e-12)
    except ValueError:
        return np.nan, np.nan
    return min(t_open, t_close), max(t_open, t_close)


def streak(
    camera: Camera,
    frame: int,
    streak_id: int,
    ends: NDArray[np.float64],
    sigma_along: float,
    sigma_cross: float,
    flags: StreakFlag,
    *,
    sky: bool = True,
    probability: float = 0.5,
) -> StreakMeasurement:
    """A measurement from (2, 2) ends (row, col), ordered by growing col."""
    chord = ends[1] - ends[0]
    length = float(np.hypot(*chord))
    u = chord / length if length > 0 else np.array([1.0, 0.0])
    n = np.array([-u[1], u[0]])
    block = sigma_along**2 * np.outer(u, u) + sigma_cross**2 * np.outer(n, n)
    cov = np.zeros((4, 4))
    cov[:2, :2] = cov[2:, 2:] = block
    fit = StreakFit(
        row0=float(ends[0, 0]),
        col0=float(ends[0, 1]),
        row1=float(ends[1, 0]),
        col1=float(ends[1, 1]),
        covariance_px2=cov,
        end_interval_px=np.array([[-sigma_along, sigma_along]] * 2),
        sigma_cross_px=sigma_cross,
        flux_e=1000.0,
        flux_err_e=50.0,
        snr=20.0,
        sagitta_px=0.0,
        sagitta_err_px=0.1,
        gradient=0.1,
        width_px=0.85,
        width_err_px=0.02,
        chi2_nu=1.0,
        n_pixels=100,
        flags=flags,
        light_curve_e_px=np.arange(3, dtype=np.float32),
    )
    rows = np.array([ends[0, 0], ends[:, 0].mean(), ends[1, 0]])
    cols = np.array([ends[0, 1], ends[:, 1].mean(), ends[1, 1]])
    ra, dec = camera.radec(rows, cols) if sky else (np.full(3, np.nan), np.full(3, np.nan))
    return StreakMeasurement(
        frame=frame,
        streak_id=streak_id,
        roi_id=streak_id,
        fit=fit,
        row_mid=float(rows[1]),
        col_mid=float(cols[1]),
        ra_deg=ra,
        dec_deg=dec,
        t_tai_ns=np.zeros(3, dtype=np.int64),
        sigma_along_arcsec=sigma_along * 4.64,
        sigma_cross_arcsec=sigma_cross * 4.64,
        mag=10.0,
        mag_err=0.1,
        probability=probability,
        tracklet_id=-1,
        flags=flags | (StreakFlag(0) if sky else StreakFlag.NO_SKY),
    )


def observe(
    camera: Camera,
    movers: Sequence[Mover],
    n_frames: int,
    rng: np.random.Generator,
    *,
    false_per_frame: float = 0.0,
    p_seen: float = 1.0,
    sigma_along: float = 0.5,
    sigma_cross: float = 0.15,
    sky: bool = True,
    jitter_px: float = 0.0,
    p_wrong_end: float = 0.0,
) -> tuple[tuple[FrameHeader, ...], tuple[StreakMeasurement, ...], Truth]:
    """All streaks of a run in random order inside each frame, with truth.

    p_wrong_end : probability that a streak lost 10 to 40 % of its length at one end, as to a masked star, unknown to its errors.
    """
    headers, streaks, truth = [], [], Truth()
    limits = np.array([camera.rows - 1.0, camera.cols - 1.0])
    for frame in range(n_frames):
        headers.append(camera.header(frame))
        t_start = frame * camera.cadence_s
        found: list[tuple[NDArray[np.float64], StreakFlag, int, tuple[float, float]]] = []
        shift = rng.normal(0.0, jitter_px, 2)
        for k, mover in enumerate(movers):
            if rng.random() > p_seen or mover.position[2] + mover.velocity[2] * t_start <= 0.1:
                continue
            t_a, t_b = _shutter_times(camera, mover, t_start)
            if not np.isfinite(t_a):
                continue
            grid = np.linspace(t_a, t_b, 400)
            p = mover.position[:, None] + mover.velocity[:, None] * grid
            if (p[2] < 0.1).any():
                continue
            path = np.stack(
                [
                    0.5 * (camera.rows - 1) + camera.focal_px * p[1] / p[2],
                    0.5 * (camera.cols - 1) + camera.focal_px * p[0] / p[2],
                ],
                axis=1,
            )
            inside = np.all((path > 0) & (path < limits), axis=1)
            if inside.sum() < 5:
                continue
            first, last = int(np.argmax(inside)), len(inside) - 1 - int(np.argmax(inside[::-1]))
            flags = StreakFlag(0)
            flags |= StreakFlag.EDGE0 if first > 0 else StreakFlag(0)
            flags |= StreakFlag.EDGE1 if last < len(inside) - 1 else StreakFlag(0)
            ends = path[[first, last]] + shift
            found.append((ends, flags, k, (float(grid[first]), float(grid[last]))))
        for _ in range(rng.poisson(false_per_frame)):
            middle, angle = rng.random(2) * limits, rng.random() * 2 * np.pi
            length = 10 ** rng.uniform(0.8, 2.8)
            half = 0.5 * length * np.array([np.sin(angle), np.cos(angle)])
            ends = np.stack([middle - half, middle + half])
            outside = np.any((ends < 0.0) | (ends > limits), axis=1)
            flags = (StreakFlag.EDGE0 if outside[0] else StreakFlag(0)) | (StreakFlag.EDGE1 if outside[1] else StreakFlag(0))
            found.append((np.clip(ends, 0.0, limits), flags, -1, (0.0, 0.0)))
        rng.shuffle(found)  # type: ignore[arg-type]
        for ends, flags, owner, epochs in found:
            u = ends[1] - ends[0]
            length = float(np.hypot(*u))
            u = u / length if length > 0 else np.array([1.0, 0.0])
            error = min(sigma_along, 0.2 * length)
            noisy = ends + rng.normal(0, error, (2, 1)) * u + rng.normal(0, sigma_cross, (2, 1)) * np.array([-u[1], u[0]])
            if p_wrong_end > 0.0 and rng.random() < p_wrong_end:
                which = int(rng.integers(2))
                noisy[which] += rng.uniform(0.1, 0.4) * (noisy[1 - which] - noisy[which])
            if length < 4.0:
                flags |= StreakFlag.POINT_LIKE
            end0_first = True
            if (noisy[0, 1], noisy[0, 0]) > (noisy[1, 1], noisy[1, 0]):
                noisy, end0_first = noisy[::-1], False
                edges = flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1)
                if edges in (StreakFlag.EDGE0, StreakFlag.EDGE1):
                    flags ^= StreakFlag.EDGE0 | StreakFlag.EDGE1
            streaks.append(streak(camera, frame, len(streaks), noisy, error, sigma_cross, flags, sky=sky))
            truth.owner.append(owner)
            truth.end0_first.append(end0_first)
            truth.epochs_s.append(epochs)
    return tuple(headers), tuple(streaks), truth
