"""Point-spread function: a Gaussian whose width grows towards the corner of the field, integrated over pixels.

The width holds diffraction, aberrations and focus of the real lens in one number; near objects add the disc of
`simulator.optics.defocus`. With errors of a wavefront, an aureole, vanes or a ghost it is that of `simulator.optics.psf_field`.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics.halo import AureoleOptions, GhostOptions, SpiderOptions
from simulator.optics.wavefront import WavefrontOptions

FWHM_PER_SIGMA: Final = 2.0 * math.sqrt(2.0 * math.log(2.0))


@dataclass(frozen=True, kw_only=True)
class PsfOptions:
    """Width of the PSF on axis, its growth over the field, and defocus of near objects."""

    fwhm_px: float = field(default=2.0, metadata={"doc": "full width at half maximum on axis", "min": 0.2, "max": 100.0})
    corner_growth: float = field(
        default=0.15,
        metadata={"doc": "relative widening at the corner of the field, quadratic in radius", "min": 0.0, "max": 5.0},
    )
    near_field_defocus: bool = field(
        default=True, metadata={"doc": "objects at a finite range are blurred by a disc of angle aperture / range"}
    )
    wavefront: WavefrontOptions = field(default_factory=WavefrontOptions, metadata={"doc": "errors of the wavefront"})
    aureole: AureoleOptions = field(default_factory=AureoleOptions, metadata={"doc": "scattered light around stars"})
    spider: SpiderOptions = field(default_factory=SpiderOptions, metadata={"doc": "vanes in the pupil"})
    ghost: GhostOptions = field(default_factory=GhostOptions, metadata={"doc": "ghosts of bright stars"})

    @property
    def sigma_px(self) -> float:
        """Gaussian sigma on axis."""
        return self.fwhm_px / FWHM_PER_SIGMA

    @property
    def is_gaussian(self) -> bool:
        """Whether nothing but the Gaussian is there."""
        return not (self.wavefront.rms_nm or self.aureole.share or self.spider.vanes or self.ghost.share)


def sigma_at(
    options: PsfOptions, row: ArrayLike, col: ArrayLike, *, center_row: float, center_col: float, corner_radius_px: float
) -> NDArray[np.float64]:
    """PSF sigma in px at pixel positions: ``sigma (1 + growth r2)``, r2 in units of the corner radius squared.

    Coma and field curvature both widen a spot in proportion to the square of the field angle to lowest order
    (Seidel; e.g. Born & Wolf, Principles of Optics, section 5.3).
    """
    r2 = ((np.asarray(row) - center_row) ** 2 + (np.asarray(col) - center_col) ** 2) / corner_radius_px**2
    return np.asarray(options.sigma_px * (1.0 + options.corner_growth * r2), dtype=np.float64)


@numba.njit(cache=True, inline="always")
def pixel_weights(centre_px: float, first: int, sigma_px: float, out: NDArray[np.float64], count: int) -> None:
    """Share of a unit Gaussian inside pixels ``first ... first + count - 1`` of one axis.

    Differences of the error function at pixel borders; pixel k covers [k - 1/2, k + 1/2].
    """
    scale = 1.0 / (sigma_px * math.sqrt(2.0))
    lower = math.erf((first - 0.5 - centre_px) * scale)
    for k in range(count):
        upper = math.erf((first + k + 0.5 - centre_px) * scale)
        out[k] = 0.5 * (upper - lower)
        lower = upper


@numba.njit(cache=True)
def cut_radius_px(flux_e: float, sigma_px: float, loss_e: float) -> float:
    """Half-width of the square stamp outside which a Gaussian keeps less than `loss_e` electrons and 1e-4 of its flux.

    The light beyond x sigma on either axis is at most ``2 erfc(x / sqrt 2) flux``; the Chernoff bound ``erfc(y) <= exp(-y^2)``
    gives ``x = sqrt(2 ln(2 flux / loss))``.
    """
    return sigma_px * math.sqrt(2.0 * math.log(2.0 * max(flux_e / loss_e, 1e4)))
