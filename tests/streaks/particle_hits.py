"""Particle tracks through a thin plate, made without the simulator, and each a function of standard normal numbers.

What makes a hit look like a trail of light is its length, its evenness and the sideways spread of its charge. The length follows
from isotropic flux through a plate in closed form; the loss in each pixel of path is Moyal's (1955), whose upper tail is lighter
than Landau's, so that tracks are more even than nature's; charge spreads with the root of the depth at which it was set free.
Delta electrons, which only make tracks uglier, stay where they were knocked out.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakPixels
from sboc_e2e.icd.signals import Detection
from tests.streaks.trail_rendering import PSF_SIGMA_PX, VARIANCE_E2, Exposure, Trail, accumulate, render, strip

PITCH_UM: Final = 9.0
DEPTH_UM: Final = 10.0
THICKNESS_PX: Final = DEPTH_UM / PITCH_UM

LEAST_LOSS_E_UM: Final = 52.0
"""Most probable electrons per um of a minimum-ionising particle in 10 um of silicon (190 eV/um, Bichsel 1988; 3.65 eV each)."""

LOSS_WIDTH: Final = 0.25
"""Moyal's scale over the most probable loss in a pixel of path: full width at half maximum 0.9 (Bichsel 1988, 10 um)."""

PROTON_MEV: Final = 938.3
FOLDING_MEV: Final = 97.0
"""Energies of trapped protons before a shield fall off like this (AP8 MAX above 50 and 100 MeV)."""

SHIELD_MEV: Final = 47.0
BRAGG_POWER: Final = 1.77
"""Protons that 10 mm of aluminium just stop, and how range goes with energy (Bragg & Kleeman 1905)."""

SLOWEST_MEV: Final = 3.0
"""Slower ones stop within the longest tracks."""

SLICES: Final = 32
STEPS_PER_PX: Final = 12

MOST_HITS: Final = 6
SHAPE_NUMBERS: Final = 8
SEEN_NUMBERS: Final = 4
CELLS: Final = 600
NUMBERS: Final = MOST_HITS * SHAPE_NUMBERS + SEEN_NUMBERS + CELLS + 12_000
"""Standard normal numbers of an exposure: shapes of hits, errors of the detection, loss per pixel of path, noise of the pixels.

Numbers of the last two are used again where a track needs more.
"""


def share_longer(length_px: float) -> float:
    """Share of isotropic particles through a plate whose tracks are longer than this in the plane: cos^2 is uniform."""
    return 1.0 / (1.0 + (length_px / THICKNESS_PX) ** 2)


@dataclass(frozen=True, kw_only=True)
class Hits:
    """One or more hits near each other, of tracks between two lengths (px).

    spread_px : rms sideways spread of charge from the far face of the plate. trapped : protons of the South Atlantic Anomaly;
    else minimum-ionising ones, whose tracks are the faintest. unevenness : Moyal's scale over the most probable loss in a pixel
    of path. count : how many. within_px : all but the first lie in a circle of this radius about it; row_px : else between two
    hits at a distance from row_px[0] to row_px[1], in a strip of 2 px.
    """

    lengths_px: tuple[float, float] = (0.0, math.inf)
    spread_px: float = 1.5 / PITCH_UM
    trapped: bool = False
    unevenness: float = LOSS_WIDTH
    count: int = 1
    within_px: float = 0.0
    row_px: tuple[float, float] | None = None

    @property
    def shares(self) -> tuple[float, float]:
        """Shares of all hits that are longer than these."""
        low, high = self.lengths_px
        return 0.0 if math.isinf(high) else share_longer(high), share_longer(low)

    def length_px(self, uniform: float) -> float:
        """Quantile of the length."""
        low, high = self.shares
        return THICKNESS_PX * math.sqrt(max(1.0 / max(low + uniform * (high - low), 1e-6) - 1.0, 1e-6))

    def loss_e_um(self, uniform: float) -> float:
        """Most probable electrons per um: loss goes with beta^(-5/3)."""
        if not self.trapped:
            return LEAST_LOSS_E_UM
        before = SHIELD_MEV - FOLDING_MEV * math.log(max(1.0 - uniform, 1e-12))
        behind = max((before**BRAGG_POWER - SHIELD_MEV**BRAGG_POWER) ** (1.0 / BRAGG_POWER), SLOWEST_MEV)
        gamma = 1.0 + behind / PROTON_MEV
        return LEAST_LOSS_E_UM * (1.0 - 1.0 / gamma**2) ** (-5.0 / 6.0)

    def exposure(self, z: NDArray[np.float64]) -> Exposure:
        """The hits of NUMBERS standard normal numbers in sky and read noise, and a segment that a detector may make of them."""
        u = ndtr(z[: self.count * SHAPE_NUMBERS]).reshape(self.count, SHAPE_NUMBERS)
        rest = z[MOST_HITS * SHAPE_NUMBERS :]
        losses = rest[SEEN_NUMBERS : SEEN_NUMBERS + CELLS]
        tracks = [self.track(u[k], place, np.roll(losses, -7 * k)) for k, place in enumerate(self._places(u))]
        trail = _chord(tracks)
        row, col = strip(trail, margin_px=20.0, half_px=8.0)
        mean = np.sum([track.image(self.spread_px, row, col) for track in tracks], axis=0)
        return seen(trail, row, col, mean, rest[:SEEN_NUMBERS], rest[SEEN_NUMBERS + CELLS :])

    def _places(self, u: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Middles (row, col) of the tracks."""
        first = 2000.0 + u[0, 2:4] - 0.5
        if self.row_px is None:
            turn, reach = 2.0 * math.pi * u[1:, 5], self.within_px * np.sqrt(u[1:, 6])
            return [first, *(first + np.stack([reach * np.sin(turn), reach * np.cos(turn)], axis=1))]
        low, high = self.row_px
        turn0 = math.pi * float(u[1, 5])
        along = np.array([math.sin(turn0), math.cos(turn0)])
        # as many more ways to put the others between as the row is longer
        distance = (low**self.count + float(u[1, 6]) * (high**self.count - low**self.count)) ** (1.0 / self.count)
        between = [first + distance * x * along + (2.0 * y - 1.0) * along[::-1] * (1.0, -1.0) for x, y in u[2:, 5:7]]
        return [first, first + distance * along, *between]

    def track(self, u: NDArray[np.float64], place: NDArray[np.float64], losses: NDArray[np.float64]) -> "Track":
        """The track about a place, with what it loses in each pixel of its path."""
        length, angle = self.length_px(float(u[0])), 2.0 * math.pi * float(u[1])
        half = 0.5 * length * np.array([math.sin(angle), math.cos(angle)])
        path_px = math.hypot(length, THICKNESS_PX)
        moyal = -2.0 * np.log(np.abs(np.resize(losses, math.ceil(path_px))) + 1e-9)
        cell_um = PITCH_UM * path_px / moyal.size
        cells_e = self.loss_e_um(float(u[4])) * cell_um * np.maximum(1.0 + self.unevenness * moyal, 0.05)
        return Track(start=place - half, stop=place + half, cells_e=cells_e)


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """start, stop : (row, col) where it enters without spread and leaves; cells_e : electrons of equal parts of its path."""

    start: NDArray[np.float64]
    stop: NDArray[np.float64]
    cells_e: NDArray[np.float64]

    def image(self, spread_px: float, row: NDArray[np.int32], col: NDArray[np.int32]) -> NDArray[np.float64]:
        """Electrons (n,) of pixels."""
        length = float(np.linalg.norm(self.stop - self.start))
        n = SLICES * max(int(STEPS_PER_PX * length / SLICES), 4)
        x = (np.arange(n) + 0.5) / n
        light = self.cells_e[(x * self.cells_e.size).astype(np.int64)]
        light *= self.cells_e.sum() / light.sum()
        nodes = self.start + x[:, None] * (self.stop - self.start)
        row_min, col_min = int(row.min()), int(col.min())
        image = np.zeros((int(row.max()) - row_min + 1, int(col.max()) - col_min + 1))
        for k, part in enumerate(np.split(np.arange(n), SLICES)):
            sigma = max(spread_px * math.sqrt((k + 0.5) / SLICES), 0.02)
            accumulate(nodes[part, 0], nodes[part, 1], light[part], sigma, row_min, col_min, image)
        return image[row - row_min, col - col_min]


def _chord(tracks: list[Track]) -> Trail:
    """The line between the two ends that are farthest apart, with the PSF's width."""
    ends = np.array([end for track in tracks for end in (track.start, track.stop)])
    apart = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    a, b = np.unravel_index(int(np.argmax(apart)), apart.shape)
    (row0, col0), (row1, col1) = ends[a].tolist(), ends[b].tolist()
    return Trail(row0=row0, col0=col0, row1=row1, col1=col1, flux_e=1.0, sigma_px=PSF_SIGMA_PX)


def seen(
    trail: Trail,
    row: NDArray[np.int32],
    col: NDArray[np.int32],
    mean: NDArray[np.float64],
    errors: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> Exposure:
    """Pixels of expected electrons (n,) in noise, and a detection that knows the trail's ends to half a pixel.

    errors : SEEN_NUMBERS standard normal numbers; noise : any number of them, used again where there are more pixels.
    """
    pixels = StreakPixels(
        row=row,
        col=col,
        value_e=mean + np.sqrt(VARIANCE_E2 + mean) * np.resize(noise, row.shape),
        variance_e2=np.full(row.shape, VARIANCE_E2),
        psf_sigma_px=PSF_SIGMA_PX,
        frame_shape=(4096, 4096),
    )
    # what a PSF-wide template of the chord collects
    template = render(replace(trail, sigma_px=PSF_SIGMA_PX, flux_e=1.0), row, col)
    snr = float(np.sum(mean * template) / math.sqrt(float(np.sum(template**2)) * VARIANCE_E2))
    guess = trail.moved(*(0.4 * errors), 0.0)
    point = StreakFlag.POINT_LIKE if trail.length_px < 2.0 else StreakFlag(0)
    detection = Detection(row0=guess.row0, col0=guess.col0, row1=guess.row1, col1=guess.col1, snr=snr, flags=point)
    return Exposure(trail=trail, pixels=pixels, detection=detection, snr=snr)
