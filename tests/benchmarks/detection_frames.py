"""Frames of noise, stars and streaks for the detection benchmark: rendered here, independently of the simulator.

A streak is drawn as closely spaced pixel-integrated Gaussians (error functions), a star as one; noise is Gaussian with the
sky's variance plus the object's own Poisson variance. Everything is in ADU of 1 e-, sigma 2.84 of the preset.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from onboard.stars import MatchedStars
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList

SIGMA = 2.84
PSF_SIGMA_PX = 2.0 / 2.354820045


@dataclass(frozen=True, kw_only=True)
class Streak:
    """Truth of one drawn streak: PSF-centre ends (px), matched-filter S/N over the part inside the frame."""

    row0: float
    col0: float
    row1: float
    col1: float
    snr: float
    sagitta_px: float = 0.0
    brightness_change: float = 0.0

    @property
    def length_px(self) -> float:
        return math.hypot(self.row1 - self.row0, self.col1 - self.col0)


@dataclass(kw_only=True)
class Scene:
    """A frame with its truth."""

    image: NDArray[np.float32]
    streaks: list[Streak] = field(default_factory=list)


def _pixel_integral(position: NDArray[np.float64], pixel: NDArray[np.int64]) -> NDArray[np.float64]:
    root = math.sqrt(2.0) * PSF_SIGMA_PX
    return 0.5 * (erf((pixel - position + 0.5) / root) - erf((pixel - position - 0.5) / root))


def streak_template(streak: Streak, shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Rows, cols and light (total 1 over an unbounded frame) of a streak; samples every ~0.2 px."""
    n = max(1, math.ceil(streak.length_px / 0.2))
    u = (np.arange(n) + 0.5) / n
    height = streak.sagitta_px * 4.0 * u * (1.0 - u)
    length = max(streak.length_px, 1e-9)
    normal_row, normal_col = (streak.col1 - streak.col0) / length, -(streak.row1 - streak.row0) / length
    row = streak.row0 + (streak.row1 - streak.row0) * u + height * normal_row
    col = streak.col0 + (streak.col1 - streak.col0) * u + height * normal_col
    weight = 1.0 + streak.brightness_change * (u - 0.5)
    weight = weight / weight.sum()
    reach = np.arange(-5, 6)
    rows = np.rint(row).astype(np.int64)[:, None] + reach
    cols = np.rint(col).astype(np.int64)[:, None] + reach
    light_row = _pixel_integral(row[:, None], rows) * weight[:, None]
    light_col = _pixel_integral(col[:, None], cols)
    value = (light_row[:, :, None] * light_col[:, None, :]).ravel()
    all_rows = np.broadcast_to(rows[:, :, None], (n, 11, 11)).ravel()
    all_cols = np.broadcast_to(cols[:, None, :], (n, 11, 11)).ravel()
    inside = (all_rows >= 0) & (all_rows < shape[0]) & (all_cols >= 0) & (all_cols < shape[1])
    flat = all_rows[inside] * shape[1] + all_cols[inside]
    pixels, inverse = np.unique(flat, return_inverse=True)
    light = np.bincount(inverse, weights=value[inside])
    return pixels // shape[1], pixels % shape[1], light


def add_streak(scene: Scene, streak: Streak, rng: np.random.Generator) -> None:
    """Draw a streak so that its matched-filter S/N in the frame is `streak.snr`."""
    row, col, light = streak_template(streak, scene.image.shape)
    flux = streak.snr * SIGMA / math.sqrt(float(np.sum(light**2)))
    electrons = flux * light
    scene.image[row, col] += (electrons + np.sqrt(electrons) * rng.standard_normal(len(row))).astype(np.float32)
    scene.streaks.append(streak)


@dataclass(frozen=True, kw_only=True, eq=False)
class StarTruth:
    """Positions (px) and S/N of the stars of a field."""

    row: NDArray[np.float64]
    col: NDArray[np.float64]
    snr: NDArray[np.float64]


def random_stars(size: int, n_stars: int, rng: np.random.Generator, *, faintest_snr: float = 2.5) -> StarTruth:
    """n_stars above S/N 8 per 4096 x 4096 px, counts ~ S^-0.9 from `faintest_snr` to 20,000."""
    n = rng.poisson(n_stars * (size / 4096.0) ** 2 * (8.0 / faintest_snr) ** 0.9)
    snr = np.minimum(faintest_snr * (1.0 - rng.random(n)) ** (-1.0 / 0.9), 20_000.0)
    return StarTruth(row=rng.uniform(-0.5, size - 0.5, n), col=rng.uniform(-0.5, size - 0.5, n), snr=snr)


def exposure(size: int, truth: StarTruth, rng: np.random.Generator, *, shift_px: tuple[float, float] = (0.0, 0.0)) -> Scene:
    """Noise and the stars moved by `shift_px`."""
    image = rng.standard_normal((size, size), dtype=np.float32) * np.float32(SIGMA)
    row, col = truth.row + shift_px[0], truth.col + shift_px[1]
    flux = truth.snr * SIGMA * 2.0 * math.sqrt(math.pi) * PSF_SIGMA_PX
    reach = np.arange(-5, 6)
    rows = np.rint(row).astype(np.int64)[:, None] + reach
    cols = np.rint(col).astype(np.int64)[:, None] + reach
    light = (
        flux[:, None, None] * _pixel_integral(row[:, None], rows)[:, :, None] * _pixel_integral(col[:, None], cols)[:, None, :]
    )
    light = light + np.sqrt(light) * rng.standard_normal(light.shape)
    inside = ((rows >= 0) & (rows < size))[:, :, None] & ((cols >= 0) & (cols < size))[:, None, :]
    flat = rows[:, :, None] * size + cols[:, None, :]
    np.add.at(image.reshape(-1), flat[inside], light[inside].astype(np.float32))
    return Scene(image=image)


def star_field(size: int, n_stars: int, rng: np.random.Generator) -> Scene:
    """One frame of noise and stars."""
    return exposure(size, random_stars(size, n_stars, rng), rng)


def random_streak(size: int, length_px: float, snr: float, rng: np.random.Generator) -> Streak:
    """A straight streak wholly inside the frame, any angle; longer than the frame's side: from edge to edge."""
    while True:
        angle = rng.uniform(0.0, math.pi)
        d_row, d_col = length_px * math.sin(angle), length_px * math.cos(angle)
        if abs(d_row) < size - 4 and abs(d_col) < size - 4:
            row = rng.uniform(2 + abs(d_row) / 2, size - 2 - abs(d_row) / 2)
            col = rng.uniform(2 + abs(d_col) / 2, size - 2 - abs(d_col) / 2)
            return Streak(row0=row - d_row / 2, col0=col - d_col / 2, row1=row + d_row / 2, col1=col + d_col / 2, snr=snr)


def bare_view(scene: Scene, *, frame: int = 0) -> DetectorView:
    """The scene with an exact noise mesh and an empty star list."""
    rows, cols = scene.image.shape
    mesh = ((rows + 63) // 64, (cols + 63) // 64)
    background = BackgroundModel(tile_px=64, level_adu=np.zeros(mesh, np.float32), sigma_adu=np.full(mesh, SIGMA, np.float32))
    header = FrameHeader(
        frame=frame,
        t_start_tai_ns=10**18 + frame * 250_000_000,
        exposure_ns=200_000_000,
        line_time_ns=10_000,
        rows=rows,
        cols=cols,
    )
    return DetectorView(
        header=header,
        residual_adu=scene.image,
        background=background,
        mask=np.zeros((rows, cols), np.uint8),
        stars=StarList.empty(),
        psf_sigma_px=PSF_SIGMA_PX,
    )


def view_of(scene: Scene, *, frame: int = 0, history: tuple[DetectorView, ...] = ()) -> DetectorView:
    """The scene as a detector sees it: an exact noise mesh, and the star list of the default extractor."""
    bare = bare_view(scene, frame=frame)
    return replace(bare, stars=MatchedStars().extract(bare), history=history)
