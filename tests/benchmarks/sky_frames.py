"""Frames of other skies for the exam of `other_skies`: drawn here with numpy and scipy, by nothing of the simulator.

Counts are electrons on a pedestal, rounded to uint16. A scene is a pair of frames, the earlier one with the stars a fraction of a
pixel away: the later one holds the streaks. Width of a pixel-integrated PSF: its variance and that of a pixel, 1/12 px^2.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from tests.benchmarks.detection_frames import Streak, random_streak

PEDESTAL: Final = 100.0
SKY_E: Final = 25.0
READ_NOISE_E: Final = 3.0
SIGMA_E: Final = math.sqrt(SKY_E + READ_NOISE_E**2)
SATURATION: Final = 30_000.0
FWHM_PX: Final = 2.0
FWHM_PER_SIGMA: Final = 2.354820045
STARS: Final = 1_500
"""Stars above S/N 8 on 2048 x 2048 px; their number goes with S^-0.9."""

Light = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One sky: what is added to stars and noise, as light in e- on both frames, and the width of the stars.

    tracks, hot_pixels : as many on 2048 x 2048 px, elsewhere by area.
    """

    name: str
    fwhm_px: float = FWHM_PX
    companions: bool = False
    aureoles: bool = False
    stray_e: float = 0.0
    tracks: int = 0
    hot_pixels: int = 0
    moon_share: float = 0.0
    ripple_sigma: float = 0.0


ROWS: Final = (
    Row(name="clean"),
    Row(name="companions", companions=True),
    Row(name="aureoles", aureoles=True),
    Row(name="stray_light", stray_e=40.0),
    Row(name="fwhm_1.4", fwhm_px=1.4),
    Row(name="fwhm_3.2", fwhm_px=3.2),
    Row(name="particles", tracks=60, hot_pixels=1_500),
    Row(name="moon", moon_share=0.14),
    Row(name="ripple", ripple_sigma=0.3),
    Row(
        name="all",
        companions=True,
        aureoles=True,
        stray_e=40.0,
        tracks=60,
        hot_pixels=1_500,
        moon_share=0.14,
        ripple_sigma=0.3,
    ),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Two frames (rows, cols) uint16 and the streaks of the later one."""

    earlier: NDArray[np.uint16]
    later: NDArray[np.uint16]
    streaks: list[Streak]


def width_px(fwhm_px: float) -> float:
    """Sigma of a PSF with its pixel."""
    return math.sqrt((fwhm_px / FWHM_PER_SIGMA) ** 2 + 1.0 / 12.0)


def add_points(light: Light, row: Light, col: Light, flux: Light, fwhm_px: float) -> None:
    """Pixel-integrated Gaussians at (n,) places, in place."""
    root = math.sqrt(2.0) * fwhm_px / FWHM_PER_SIGMA
    reach = np.arange(-math.ceil(2.5 * fwhm_px), math.ceil(2.5 * fwhm_px) + 1)
    rows, cols = np.rint(row).astype(np.int64)[:, None] + reach, np.rint(col).astype(np.int64)[:, None] + reach
    across_row = 0.5 * (erf((rows - row[:, None] + 0.5) / root) - erf((rows - row[:, None] - 0.5) / root))
    across_col = 0.5 * (erf((cols - col[:, None] + 0.5) / root) - erf((cols - col[:, None] - 0.5) / root))
    stamp = flux[:, None, None] * across_row[:, :, None] * across_col[:, None, :]
    inside = ((rows >= 0) & (rows < light.shape[0]))[:, :, None] & ((cols >= 0) & (cols < light.shape[1]))[:, None, :]
    flat = rows[:, :, None] * light.shape[1] + cols[:, None, :]
    light += np.bincount(flat[inside], stamp[inside], light.size).reshape(light.shape)


def streak_light(streak: Streak, shape: tuple[int, int], sigma_px: float) -> tuple[tuple[slice, slice], Light]:
    """Window and light (unit per px of length) of a straight streak: Gaussian across, blurred ends."""
    margin = math.ceil(5.0 * sigma_px)
    first = [max(0, math.floor(min(a, b)) - margin) for a, b in ((streak.row0, streak.row1), (streak.col0, streak.col1))]
    stop = [
        min(n, math.ceil(max(a, b)) + margin + 1)
        for n, a, b in zip(shape, (streak.row0, streak.col0), (streak.row1, streak.col1), strict=True)
    ]
    row, col = np.arange(first[0], stop[0])[:, None] - streak.row0, np.arange(first[1], stop[1])[None, :] - streak.col0
    length = streak.length_px
    u_row, u_col = (streak.row1 - streak.row0) / length, (streak.col1 - streak.col0) / length
    along, across = row * u_row + col * u_col, row * u_col - col * u_row
    root = math.sqrt(2.0) * sigma_px
    profile = np.exp(-((across / root) ** 2)) / (math.sqrt(2.0 * math.pi) * sigma_px)
    ends = 0.5 * (erf(along / root) - erf((along - length) / root))
    return (slice(first[0], stop[0]), slice(first[1], stop[1])), profile * ends


def _bright(light: Light, row: Light, col: Light, flux: Light, turn: float) -> None:
    """Aureoles (2 % of the light, falling as r^-3) and four spikes (2 %) of bright stars, in place."""
    for r, c, f in zip(row, col, flux, strict=True):
        low, high = (max(0, int(r) - 300), max(0, int(c) - 300)), (int(r) + 301, int(c) + 301)
        part = light[low[0] : high[0], low[1] : high[1]]
        d_row, d_col = np.arange(part.shape[0])[:, None] + low[0] - r, np.arange(part.shape[1])[None, :] + low[1] - c
        part += 0.02 * f * 3.0 / (2.0 * math.pi) / (9.0 + d_row**2 + d_col**2) ** 1.5
        for angle in (turn, turn + 0.5 * math.pi):
            along, across = d_row * math.sin(angle) + d_col * math.cos(angle), d_row * math.cos(angle) - d_col * math.sin(angle)
            arm = 10.0 / math.pi / (100.0 + along**2)
            part += 0.01 * f * arm * np.exp(-0.5 * (across / 0.9) ** 2) / (math.sqrt(2.0 * math.pi) * 0.9)


def moon_centre(side: int) -> tuple[float, float]:
    """Where the Moon stands."""
    return 0.3 * side, 0.65 * side


def moon_light(side: int, share: float) -> Light:
    """A disc far beyond saturation, its diameter a share of the side, and its glow: 2,000 e- at the limb, falling as r^-3."""
    row, col = np.arange(side)[:, None], np.arange(side)[None, :]
    at = moon_centre(side)
    distance = np.hypot(row - at[0], col - at[1]) / (0.5 * share * side)
    return np.where(distance < 1.0, 1e6, 2_000.0 / np.maximum(distance, 1.0) ** 3)


def ripple_light(side: int, amplitude_e: float, rng: np.random.Generator) -> Light:
    """A wave of 200 px period at any angle and phase."""
    angle, phase = rng.uniform(0.0, math.pi), rng.uniform(0.0, 2.0 * math.pi)
    row, col = np.arange(side)[:, None], np.arange(side)[None, :]
    wave = np.sin(2.0 * math.pi / 200.0 * (row * math.sin(angle) + col * math.cos(angle)) + phase)
    return np.asarray(amplitude_e * wave)


def add_tracks(counts: Light, number: int, rng: np.random.Generator) -> None:
    """Particle tracks of no width: 10 to 100 px long, 20 to 200 sigma in each pixel they touch; in place."""
    side = counts.shape[0]
    for _ in range(number):
        length, angle = float(rng.uniform(10.0, 100.0)), float(rng.uniform(0.0, 2.0 * math.pi))
        row, col = rng.uniform(0.0, side, 2)
        along = np.arange(0.0, length, 0.25)
        r, c = np.floor(row + along * math.sin(angle)).astype(np.int64), np.floor(col + along * math.cos(angle)).astype(np.int64)
        inside = (r >= 0) & (c >= 0) & (r < side) & (c < counts.shape[1])
        np.add.at(counts, (r[inside], c[inside]), 0.25 * rng.uniform(20.0, 200.0) * SIGMA_E)


def exposed(light: Light, rng: np.random.Generator) -> Light:
    """Photon noise (Gaussian) of the light and read noise on the pedestal."""
    noise = rng.standard_normal(light.shape, dtype=np.float32) * np.sqrt(np.maximum(light, 0.0) + READ_NOISE_E**2)
    return np.asarray(PEDESTAL + light + noise)


def digitised(counts: Light) -> NDArray[np.uint16]:
    """Rounded, and cut at saturation."""
    return np.rint(np.clip(counts, 0.0, SATURATION)).astype(np.uint16)


def scene(row: Row, side: int, streaks: list[tuple[float, float]], seed: int) -> Scene:
    """A pair of frames of one sky. streaks : length (px) of each, and S/N in the noise of the sky without stars."""
    rng = np.random.default_rng(seed)
    share = (side / 2048.0) ** 2
    n = rng.poisson(STARS * share * (8.0 / 2.5) ** 0.9)
    snr = np.minimum(2.5 * (1.0 - rng.random(n)) ** (-1.0 / 0.9), 20_000.0)
    at = rng.uniform(-0.5, side - 0.5, (n, 2))
    if row.companions:
        beside = rng.choice(n, min(n, round(400 * share)), replace=False)
        angle, apart = rng.uniform(0.0, 2.0 * math.pi, len(beside)), rng.uniform(3.0, 15.0, len(beside))
        at = np.vstack((at, at[beside] + (apart * np.array((np.sin(angle), np.cos(angle)))).T))
        snr = np.concatenate((snr, rng.uniform(3.0, 10.0, len(beside))))
        for _ in range(round(60 * share)):
            turn, step = rng.uniform(0.0, math.pi), rng.uniform(4.0, 15.0)
            along = np.arange(4)[:, None] * step * np.array([[math.sin(turn), math.cos(turn)]])
            at = np.vstack((at, rng.uniform(0.0, side, 2) + along + rng.normal(0.0, 0.3, (4, 2))))
            snr = np.concatenate((snr, rng.uniform(3.0, 10.0) * 10.0 ** rng.normal(0.0, 0.1, 4)))
    sigma_px = width_px(row.fwhm_px)
    flux = snr * SIGMA_E * 2.0 * math.sqrt(math.pi) * sigma_px
    bright = rng.uniform(0.0, side, (max(1, round(12 * share)), 2)) if row.aureoles else np.zeros((0, 2))
    bright_flux = np.exp(rng.uniform(math.log(1e5), math.log(3e6), len(bright)))
    turn = float(rng.uniform(0.0, 0.5 * math.pi))
    axis = np.linspace(-1.0, 1.0, side)
    sky = SKY_E + row.stray_e * (0.5 + 0.3 * axis[:, None] + 0.2 * axis[None, :] ** 2)
    n_tracks, n_hot = round(row.tracks * share), round(row.hot_pixels * share)
    hot_row, hot_col = rng.integers(0, side, (2, n_hot))
    hot = rng.uniform(10.0, 300.0, n_hot) * SIGMA_E
    moon = moon_light(side, row.moon_share) if row.moon_share > 0.0 else 0.0
    drawn: list[Streak] = []
    frames = []
    for later in (False, True):
        shift = np.zeros(2) if later else rng.normal(0.0, 0.4, 2)
        light = np.zeros((side, side)) + sky + moon
        add_points(light, *(at + shift).T, flux, row.fwhm_px)
        if len(bright):
            add_points(light, *(bright + shift).T, bright_flux, row.fwhm_px)
            _bright(light, *(bright + shift).T, bright_flux, turn)
        if row.ripple_sigma > 0.0:
            light += ripple_light(side, row.ripple_sigma * SIGMA_E, rng)
        if later:
            for length, wanted in streaks:
                drawn.append(placed(row, side, length, wanted, drawn, rng))
                window, shape = streak_light(drawn[-1], (side, side), sigma_px)
                variance = (sky + moon)[window] + READ_NOISE_E**2
                light[window] += wanted / math.sqrt(float(np.sum(shape**2 / variance))) * shape
        counts = exposed(light, rng)
        add_tracks(counts, n_tracks, rng)
        np.add.at(counts, (hot_row, hot_col), hot)
        frames.append(digitised(counts))
    return Scene(earlier=frames[0], later=frames[1], streaks=drawn)


def placed(row: Row, side: int, length: float, snr: float, others: list[Streak], rng: np.random.Generator) -> Streak:
    """A streak inside the frame that keeps 300 px from the Moon's limb and crosses no other one's neighbourhood, if possible."""
    at, radius = moon_centre(side), 0.5 * row.moon_share * side
    u = np.linspace(0.0, 1.0, 33)
    for _ in range(200):
        streak = random_streak(side, length, snr, rng)
        r, c = streak.row0 + u * (streak.row1 - streak.row0), streak.col0 + u * (streak.col1 - streak.col0)
        near = row.moon_share > 0.0 and float(np.min(np.hypot(r - at[0], c - at[1]))) < radius + 300.0
        if not near and not any(_near(streak, other, u) for other in others):
            return streak
    return streak


def _near(a: Streak, b: Streak, u: Light) -> bool:
    places = [np.column_stack((s.row0 + u * (s.row1 - s.row0), s.col0 + u * (s.col1 - s.col0))) for s in (a, b)]
    return float(np.min(np.linalg.norm(places[0][:, None] - places[1][None], axis=2))) < 40.0


def arcs(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Stars drawn as arcs of a camera that rolls by 6 deg about its middle during the exposure."""
    light = np.full((side, side), SKY_E)
    n = round(STARS * (side / 2048.0) ** 2)
    at = rng.uniform(0.0, side, (n, 2)) - 0.5 * side
    flux = 40.0 * SIGMA_E * (1.0 - rng.random(n)) ** (-1.0 / 0.9)
    radius, phase = np.hypot(*at.T), np.arctan2(*at.T)
    for r, p, f in zip(radius, phase, np.minimum(flux, 1e6), strict=True):
        angle = p + math.radians(6.0) * (np.arange(max(2, round(r * 0.2))) + 0.5) / max(2, round(r * 0.2))
        row, col = r * np.sin(angle) + 0.5 * side, r * np.cos(angle) + 0.5 * side
        add = np.full(len(angle), f / len(angle))
        inside = (row > -3) & (col > -3) & (row < side + 3) & (col < side + 3)
        _add_to_window(light, row[inside], col[inside], add[inside])
    return digitised(exposed(light, rng))


def _add_to_window(light: Light, row: Light, col: Light, flux: Light) -> None:
    if not len(row):
        return
    low = np.maximum(0, np.floor((row.min() - 6, col.min() - 6)).astype(int))
    high = np.ceil((row.max() + 7, col.max() + 7)).astype(int)
    window = light[low[0] : high[0], low[1] : high[1]]
    add_points(window, row - low[0], col - low[1], flux, FWHM_PX)


def _plain(side: int, rng: np.random.Generator) -> Light:
    return exposed(np.full((side, side), SKY_E), rng)


def saturated_band(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """400 rows at saturation."""
    counts = _plain(side, rng)
    counts[side // 4 : side // 4 + 400] = SATURATION
    return digitised(counts)


def storm(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """20,000 tracks on 2048 x 2048 px, as dense on others."""
    counts = _plain(side, rng)
    add_tracks(counts, round(20_000 * (side / 2048.0) ** 2), rng)
    return digitised(counts)


def uniform(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Any value between black and full."""
    return digitised(rng.uniform(0.0, SATURATION, (side, side)))


def checker(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Squares of 32 px, dark and bright."""
    row, col = np.arange(side)[:, None] // 32, np.arange(side)[None, :] // 32
    return digitised(_plain(side, rng) + 500.0 * ((row + col) % 2))


def ramps(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Sawteeth of 100 px."""
    return digitised(_plain(side, rng) + 3.0 * (np.arange(side)[None, :] % 100))


def rectangles(side: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Random rectangles, some of them saturated."""
    counts = _plain(side, rng)
    for _ in range(60):
        (r, c), (h, w) = rng.integers(0, side, 2), rng.integers(2, side // 3, 2)
        counts[r : r + h, c : c + w] += 10.0 ** rng.uniform(0.0, 5.0)
    return digitised(counts)


HOSTILE: Final[dict[str, Callable[[int, np.random.Generator], NDArray[np.uint16]]]] = {
    "arcs": arcs,
    "saturated_band": saturated_band,
    "storm": storm,
    "uniform": uniform,
    "checker": checker,
    "ramps": ramps,
    "rectangles": rectangles,
}
