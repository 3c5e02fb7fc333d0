"""Width of the PSF over the field, learned from the trails themselves.

The nominal camera knows one width; real lenses widen towards the corner. A trail fitted 10 % too narrow loses 5 % of its
flux. A single trail shows its width only if it is bright. Together the trails give ``ln sigma = ln nominal + a + b r^2`` (r in
units of the corner's radius; the lowest order of field curvature and coma). For the caller: keep one field in the state of the
run, take `sigma_px` at the middle of each detection for `StreakPixels.psf_sigma_px`, and pass each frame's fits to `updated`.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

PRIOR_OFFSET: Final = 0.05
"""Prior sigma of a, the width over the nominal one at the centre. Chosen, not measured."""
PRIOR_GROWTH: Final = 0.15
"""Prior sigmas of a and b."""

SCATTER: Final = 0.02
"""Of single trails about the field, beyond their errors."""

LEAST_SNR: Final = 12.0
"""A fainter trail tells its width to worse than 12 % (sqrt(2) over S/N), six times `SCATTER`."""
OUTLIER_SIGMAS: Final = 3.5
"""One trail in 2,000 of a normal distribution is beyond it; tumbling and defocused ones are."""

UNFIT: Final = (
    StreakFlag.FIT_FAILED | StreakFlag.COSMIC_LIKE | StreakFlag.DEFOCUSED | StreakFlag.SATURATED | StreakFlag.STATIC
    | StreakFlag.SPIKE_LIKE | StreakFlag.CROSSES_STAR | StreakFlag.POINT_LIKE
)  # fmt: skip
"""Flags of fits that are not used. A bright point that moves by a pixel is much wider than the PSF, without a flag for it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PsfField:
    """Normal equations of (a, b): `normal` (2, 2), `right` (2,); prior included. Picklable, immutable."""

    nominal_px: float
    center_row: float
    center_col: float
    corner_radius_px: float
    normal: NDArray[np.float64]
    right: NDArray[np.float64]

    @classmethod
    def nominal(cls, psf_sigma_px: float, shape: tuple[int, int]) -> "PsfField":
        """The field before any trail: the nominal width everywhere."""
        center = (0.5 * (shape[0] - 1), 0.5 * (shape[1] - 1))
        return cls(
            nominal_px=psf_sigma_px,
            center_row=center[0],
            center_col=center[1],
            corner_radius_px=math.hypot(*center) + 1e-9,
            normal=np.diag([PRIOR_OFFSET**-2, PRIOR_GROWTH**-2]),
            right=np.zeros(2),
        )

    def sigma_px(self, row: float, col: float, length_px: float = 0.0) -> float:
        """PSF sigma at a place, or averaged along a trail whose middle it is."""
        coefficients = np.linalg.solve(self.normal, self.right)
        return self.nominal_px * math.exp(float(self._basis(row, col, length_px) @ coefficients))

    def updated(self, fits: Iterable[StreakFit]) -> "PsfField":
        """The field after another frame's fits."""
        field = self
        for fit in fits:
            field = field._with(fit)
        return field

    def _basis(self, row: float, col: float, length_px: float) -> NDArray[np.float64]:
        """(1, r^2); along a straight trail r^2 averages to that of the middle plus L^2 / 12."""
        r2 = (row - self.center_row) ** 2 + (col - self.center_col) ** 2 + length_px**2 / 12.0
        return np.array([1.0, r2 / self.corner_radius_px**2])

    def _with(self, fit: StreakFit) -> "PsfField":
        """The field with one more trail, if it is one to learn from."""
        if fit.flags & UNFIT or fit.snr < LEAST_SNR or not fit.width_px > 0.0:
            return self
        basis = self._basis(0.5 * (fit.row0 + fit.row1), 0.5 * (fit.col0 + fit.col1), fit.length_px)
        covariance = np.linalg.inv(self.normal)
        expected = float(basis @ covariance @ self.right)
        variance = (fit.width_err_px / fit.width_px) ** 2 + SCATTER**2
        surprise = math.log(fit.width_px / self.nominal_px) - expected
        if not surprise**2 < OUTLIER_SIGMAS**2 * (variance + float(basis @ covariance @ basis)):
            return self
        weight = 1.0 / variance
        return replace(
            self,
            normal=self.normal + weight * np.outer(basis, basis),
            right=self.right + weight * (surprise + expected) * basis,
        )
