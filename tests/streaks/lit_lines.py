"""Lines that are drawn into a sky of noise, the fits of them, and a vetter that judges these by the frame itself."""

from dataclasses import replace
from typing import Any

import numpy as np

from ground.streaks import TrailedPsfFitter
from ground.vetting.contrast import Tiles
from ground.vetting.look_alikes import LookAlikeVetter, OwnEvidence
from ground.vetting.surroundings import Picture, Surroundings
from sboc_e2e.icd.products import StreakFit
from tests.streaks.impostors import draw

SHAPE = (300, 700)
EVEN = np.ones(400)
METEOR = np.sin(np.linspace(0.02, 0.99 * np.pi, 400))


def fit_of_a_trail() -> StreakFit:
    """A fit of a trail of no place yet."""
    shot = draw("real", np.random.default_rng(5))
    return replace(TrailedPsfFitter().fit(shot.pixels, shot.detection), sagitta_px=0.0, chi2_nu=1.0)


def placed(fit: StreakFit, ends: tuple[float, float, float, float], width_px: float, snr: float) -> StreakFit:
    """The fit with first row and column, last row and column, a width and an S/N."""
    row0, col0, row1, col1 = ends
    even = np.ones(20, np.float32)
    return replace(
        fit, row0=row0, col0=col0, row1=row1, col1=col1, width_px=width_px, snr=snr,
        light_curve_e_px=even, light_curve_err_e_px=0.01 * even,
    )  # fmt: skip


def lit(fit: StreakFit, light: np.ndarray, peak: float) -> np.ndarray:
    """A sky of one count of noise with a line of its light along the way, as high as a peak."""
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    share = np.clip(
        ((row - fit.row0) * (fit.row1 - fit.row0) + (col - fit.col0) * (fit.col1 - fit.col0)) / fit.length_px**2, 0.0, 1.0
    )
    away2 = (row - fit.row0 - share * (fit.row1 - fit.row0)) ** 2 + (col - fit.col0 - share * (fit.col1 - fit.col0)) ** 2
    height = peak * np.interp(share, np.linspace(0.0, 1.0, light.size), light)
    return np.random.default_rng(7).normal(100.0, 1.0, SHAPE) + height * np.exp(-0.5 * away2 / fit.width_px**2)


def tiles(pixels: np.ndarray, *fits: StreakFit) -> Tiles:
    """The tiles of an image along lines."""
    ends = [(fit.row0, fit.col0, fit.row1, fit.col1) for fit in fits]
    return Tiles.of(pixels.astype(np.float32), np.zeros(SHAPE, np.uint8), ends)


def judged_by(
    vetter: Any, fits: list[StreakFit], pixels: np.ndarray, psf_sigma_px: float | None = None, **evidence: Any
) -> np.ndarray:
    """Probabilities of the fits of a frame of `SHAPE` by a vetter and the frame's own evidence.

    psf_sigma_px : what its stars tell. evidence : what else `OwnEvidence` has.
    """
    header = type("Header", (), {"frame": 0, "rows": SHAPE[0], "cols": SHAPE[1], "gain_e_adu": 1.0})()
    frame: Any = type("Frame", (), {"header": header, "psf_sigma_px": psf_sigma_px})()
    about = Surroundings.of(Picture.of(pixels, np.zeros(SHAPE, np.uint8)), [(f.row0, f.col0, f.row1, f.col1) for f in fits])
    known = {"seen": (0, SHAPE[0] - 1, 0, SHAPE[1] - 1), "tiles": tiles(pixels, *fits), "surroundings": about}
    own = OwnEvidence(**(known | evidence))
    return LookAlikeVetter(vetter=vetter, evidence={0: own}).probability(fits, frame)


class Told:
    """A vetter that gives what it was told."""

    def __init__(self, *probability: float) -> None:
        self._given = np.array(probability)

    def probability(self, _fits: Any, _frame: Any) -> np.ndarray:
        """As told."""
        return self._given


def judged(
    given: tuple[float, ...], fits: list[StreakFit], pixels: np.ndarray, psf_sigma_px: float | None = None, **evidence: Any
) -> np.ndarray:
    """Probabilities of the fits of a frame of `SHAPE` whose vetter gave these, its stars telling a width or none."""
    return judged_by(Told(*given), fits, pixels, psf_sigma_px, **evidence)
