"""Frames of noise, stars and streaks for the detection benchmark: rendered here, independently of the simulator.

A streak is drawn as closely spaced pixel-integrated Gaussians (error functions), a star as one; noise is Gaussian with the
sky's variance plus the object's own Poisson variance. Everything is in ADU of 1 e-, sigma 2.84 of the preset. What peers take
for trails is drawn on request: diffraction spikes, bleeding columns, halos with ghosts, by the laws of the simulator; pairs and
chains of stars.
"""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from onboard.stars.matched import MatchedStars
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, Detection, DetectorView, StarList
from simulator.optics.halo import AureoleOptions, GhostOptions, Halo, SpiderOptions, make_halo
from simulator.sensor.digitise import bleed_columns
from simulator.sensor.structure import defer_charge

SIGMA = 2.84
PSF_SIGMA_PX = 2.0 / 2.354820045

FULL_WELL = 39_000.0
"""Pixels at this charge are saturated (e-, the preset's); what is beyond it bleeds along the column."""

VANE_MM = 2.0
"""Width of the four vanes that make spikes, of the preset's pupil of 200 mm."""

AUREOLE = AureoleOptions(share=0.02, core_px=3.0, slope=3.0)
GHOST = GhostOptions(share=1e-3, diameter_px=90.0, magnification=1.0)

TRAP_LOSS, TRAP_PX = 8e-6, 60.0
"""Share of a bleeding column's charge that traps hold back in each transfer, and the rows over which they release it."""


@dataclass(frozen=True, kw_only=True)
class Streak(Detection):
    """Truth of one drawn streak as a detection without error; its S/N is over the part inside the frame."""

    brightness_change: float = 0.0


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
    """The scene with an exact noise mesh and an empty star list; saturated pixels are masked and hold 0, as after calibration."""
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
        saturation_adu=FULL_WELL,
    )
    full = scene.image >= FULL_WELL
    return DetectorView(
        header=header,
        residual_adu=np.where(full, np.float32(0.0), scene.image) if full.any() else scene.image,
        background=background,
        mask=full.astype(np.uint8) * np.uint8(MaskBit.SATURATED),
        stars=StarList.empty(),
        psf_sigma_px=PSF_SIGMA_PX,
    )


def view_of(scene: Scene, *, frame: int = 0, history: tuple[DetectorView, ...] = ()) -> DetectorView:
    """The scene as a detector sees it: an exact noise mesh, and the star list of the default extractor."""
    bare = bare_view(scene, frame=frame)
    return replace(bare, stars=MatchedStars().extract(bare), history=history)


@dataclass(frozen=True, kw_only=True)
class Artefact:
    """Something that is not a moving object: its kind, its centre (px), and how far it reaches from there."""

    kind: str
    row: float
    col: float
    reach_px: float
    flux_e: float = 0.0
    turn: float = 0.0


def star_flux(snr: float) -> float:
    """Light of a star of matched-filter S/N `snr`, e-."""
    return snr * SIGMA * 2.0 * math.sqrt(math.pi) * PSF_SIGMA_PX


def random_artefacts(size: int, rng: np.random.Generator) -> tuple[list[Artefact], StarTruth]:
    """Bright stars with spikes, bleeding columns or halos, and the stars of pairs and chains; fixed to the sky.

    Per 2048 x 2048 px four of each kind of bright star (1e5 to 3e6 e- with spikes, the same with halos, 1e6 to 1e7 with
    columns), 40 pairs and 20 chains. Magnitudes of one pair or chain scatter by 0.3: they look even.
    """
    share = (size / 2048.0) ** 2
    found: list[Artefact] = []

    def place() -> tuple[float, float]:
        return float(rng.uniform(0.0, size - 1.0)), float(rng.uniform(0.0, size - 1.0))

    turn = float(rng.uniform(0.0, 0.5 * math.pi))  # the vanes are the camera's: one angle for all stars
    for kind, low, high, reach in (("spikes", 1e5, 3e6, 300.0), ("halo", 1e5, 3e6, 80.0), ("column", 1e6, 1e7, 150.0)):
        for _ in range(round(4 * share)):
            row, col = place()
            flux = float(np.exp(rng.uniform(math.log(low), math.log(high))))
            found.append(Artefact(kind=kind, row=row, col=col, reach_px=reach, flux_e=flux, turn=turn))
    rows, cols, snrs = [], [], []
    for kind, number in (("pair", 40), ("chain", 20)):
        for _ in range(round(number * share)):
            row, col = place()
            n = 2 if kind == "pair" else int(rng.integers(3, 8))
            apart = float(rng.uniform(2.0, 25.0) if kind == "pair" else rng.uniform(3.0, 15.0))
            angle, level = float(rng.uniform(0.0, math.pi)), float(rng.uniform(3.0, 12.0))
            along = (np.arange(n) - 0.5 * (n - 1)) * apart
            rows.append(row + along * math.sin(angle) + rng.normal(0.0, 0.3, n))
            cols.append(col + along * math.cos(angle) + rng.normal(0.0, 0.3, n))
            snrs.append(level * 10.0 ** rng.normal(0.0, 0.12, n))
            found.append(Artefact(kind=kind, row=row, col=col, reach_px=0.5 * n * apart + 10.0))
    stars = StarTruth(row=np.concatenate(rows), col=np.concatenate(cols), snr=np.concatenate(snrs))
    return found, stars


def _window(
    artefact: Artefact, reach: int, shape: tuple[int, int]
) -> tuple[tuple[slice, slice], NDArray[np.float32], NDArray[np.float32]]:
    """Part of a frame around an artefact, and the distances of its rows (n, 1) and cols (m,) from it."""
    first = (max(0, round(artefact.row) - reach), max(0, round(artefact.col) - reach))
    stop = (min(shape[0], round(artefact.row) + reach + 1), min(shape[1], round(artefact.col) + reach + 1))
    row, col = (np.arange(first[k], stop[k], dtype=np.float32) for k in (0, 1))
    d_row, d_col = row - np.float32(artefact.row), col - np.float32(artefact.col)
    return (slice(first[0], stop[0]), slice(first[1], stop[1])), d_row[:, None], d_col


def _star_light(d_row: NDArray[np.float32], d_col: NDArray[np.float32]) -> NDArray[np.float32]:
    root = math.sqrt(2.0) * PSF_SIGMA_PX
    across = [0.5 * (erf((d + 0.5) / root) - erf((d - 0.5) / root)) for d in (d_row, d_col)]
    return np.asarray(across[0] * across[1], dtype=np.float32)


@lru_cache(maxsize=8)
def _halo(kind: str, turn: float) -> Halo:
    """What the simulator has around a star of this kind in the preset's camera."""
    return make_halo(
        AUREOLE if kind == "halo" else AureoleOptions(),
        SpiderOptions(vanes=4 if kind == "spikes" else 0, width_mm=VANE_MM, angle_deg=math.degrees(turn) % 360.0),
        GHOST if kind == "halo" else GhostOptions(),
        wavelength_nm=635.0,
        aperture_m=0.2,
        obstruction=0.0,
        focal_px=0.4 / 9e-6,
        sigma_px=PSF_SIGMA_PX,
        diffracts=False,
    )


def bleed(charge: NDArray[np.float32]) -> None:
    """Charge beyond the full well flows along its column as in the simulator's CCD; in place."""
    full = charge.astype(np.float64)
    bleed_columns(full, FULL_WELL)
    charge[:] = full


def add_artefacts(
    scene: Scene, artefacts: list[Artefact], rng: np.random.Generator, *, shift_px: tuple[float, float] = (0.0, 0.0)
) -> None:
    """Draw the bright stars among the artefacts with their own noise, moved by `shift_px`; pairs and chains are stars already."""
    for artefact in (replace(a, row=a.row + shift_px[0], col=a.col + shift_px[1]) for a in artefacts if a.flux_e > 0.0):
        part, d_row, d_col = _window(artefact, 400 if artefact.kind == "spikes" else 120, scene.image.shape)
        if not d_row.size:
            continue
        halo = _halo(artefact.kind, artefact.turn)
        r = np.hypot(d_row, d_col).astype(np.float64)
        light = halo.core_share * _star_light(d_row, d_col) + halo.aureole(r) + halo.spikes(d_row, d_col)
        light += halo.ghost.share / (0.25 * math.pi * halo.ghost.diameter_px**2) * (r < 0.5 * halo.ghost.diameter_px)
        electrons = artefact.flux_e * light
        scene.image[part] += (electrons + np.sqrt(electrons) * rng.standard_normal(light.shape, dtype=np.float32)).astype(
            np.float32
        )
        if artefact.kind == "column":
            bleed(scene.image[part])
            moved = scene.image[part].astype(np.float64)
            defer_charge(moved, TRAP_LOSS, TRAP_PX)
            # a full pixel stays one for the converter; the tail behind the last of them is what shows
            scene.image[part] = np.where(scene.image[part] >= FULL_WELL, np.float32(FULL_WELL), moved)
