"""Trails of stated S/N: what detectors are to find and fitters to measure."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.trail import TruePath, draw
from sboc_e2e.truth import PATH_NODES

PSF_SIGMA_PX: Final = 0.85  # Of the preset `sboc_like`, whose PSF has an FWHM of 2 px: 2 / 2.3548.


@dataclass(frozen=True, kw_only=True, eq=False)
class Trail:
    """A straight trail. snr : matched-filter S/N over the noise without it. row, col, light_e : (n,) of its pixels."""

    path: TruePath
    snr: float
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    light_e: NDArray[np.float64]


def trail(
    middle: tuple[float, float], length_px: float, angle_deg: float, snr: float, shape: tuple[int, int], noise_e: float
) -> Trail:
    """A trail of this length and angle (atan2(drow, dcol)) through a point, as bright as its S/N says. noise_e : of a pixel."""
    along = np.linspace(-0.5, 0.5, PATH_NODES) * length_px
    angle = np.radians(angle_deg)
    unit = TruePath(
        row=middle[0] + along * np.sin(angle), col=middle[1] + along * np.cos(angle), flux_e_s=np.ones(PATH_NODES),
        duration_s=1.0, sigma_px=PSF_SIGMA_PX, edge0=False, edge1=False,
    )  # fmt: skip
    row, col, light = draw(unit).pixels(*shape)
    flux_e = snr * noise_e / float(np.sqrt((light**2).sum()))
    return Trail(path=replace(unit, flux_e_s=unit.flux_e_s * flux_e), snr=snr, row=row, col=col, light_e=light * flux_e)
