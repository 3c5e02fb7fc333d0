"""SIP distortion (Shupe et al. 2005, ASP Conf. Ser. 347, 491): polynomials of pixel offsets from the optical axis.

Forward: ``U = u + A(u, v), V = v + B(u, v)`` with u along columns, v along rows, A the sum of ``A_pq u^p v^q``; pixels are on
the right, the focal plane of a perfect lens on the left. Rendering needs the inverse, which is found by Newton's method.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]
Terms = tuple[tuple[int, int, float], ...]
"""(power of u, power of v, coefficient in px^(1 - p - q)) of each term."""

LARGEST_SHIFT = 0.2
"""Largest shift that is accepted, of the radius where the polynomial holds."""
_SMALLEST_STRETCH = 0.2  # least ratio of areas: Newton's inverse fails where the field folds, at 0. Chosen, not measured
_HIGHEST_ORDER = 9  # the highest A_ORDER and B_ORDER of the convention (Shupe et al. 2005)


@dataclass(frozen=True, kw_only=True)
class Sip:
    """Terms of columns (a) and rows (b); nothing farther than `radius_px` from the axis has a place."""

    a: Terms
    b: Terms
    radius_px: float

    def corrected_offsets(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Focal-plane offsets (px) of pixel offsets along columns and rows."""
        return u + _sum_of(self.a, u, v, 0, 0), v + _sum_of(self.b, u, v, 0, 0)

    def pixel_offsets(self, along_col: Array, along_row: Array) -> tuple[Array, Array]:
        """Pixel offsets of focal-plane offsets, the inverse of `corrected_offsets` to 1e-9 px; NaN beyond the radius."""
        inside = np.hypot(along_col, along_row) <= self.radius_px
        target_u, target_v = np.where(inside, along_col, np.nan), np.where(inside, along_row, np.nan)
        u, v = target_u.copy(), target_v.copy()
        for _ in range(6):
            at_u, at_v = self.corrected_offsets(u, v)
            uu, uv, vu, vv = self._slopes(u, v)
            det = uu * vv - uv * vu
            error_u, error_v = at_u - target_u, at_v - target_v
            u, v = u - (vv * error_u - uv * error_v) / det, v - (uu * error_v - vu * error_u) / det
        return u, v

    def in_pixels_of(self, size: int) -> "Sip":
        """The same distortion in pixels that are `size` times as large."""
        a, b = (tuple((p, q, c * float(size) ** (p + q - 1)) for p, q, c in side) for side in (self.a, self.b))
        return Sip(a=a, b=b, radius_px=self.radius_px / size)

    def refuse_folding(self, key: str) -> None:
        """UserError for orders that SIP does not have, for shifts that are too large, and where the field would fold."""
        for side, terms in (("a", self.a), ("b", self.b)):
            for p, q, _ in terms:
                if not 2 <= p + q <= _HIGHEST_ORDER:
                    raise UserError(f"{key}_{side}: powers {p} and {q}; allowed are sums of 2 to {_HIGHEST_ORDER}")
        nodes = np.linspace(-self.radius_px, self.radius_px, 101)
        u, v = (x.ravel() for x in np.meshgrid(nodes, nodes))
        u, v = (x[np.hypot(u, v) <= self.radius_px] for x in (u, v))
        at_u, at_v = self.corrected_offsets(u, v)
        shift_px, allowed_px = float(np.hypot(at_u - u, at_v - v).max()), LARGEST_SHIFT * self.radius_px
        if shift_px > allowed_px:
            raise UserError(f"{key}_a, {key}_b: shifts of up to {shift_px:.4g} px; allowed are {allowed_px:.4g} px")
        uu, uv, vu, vv = self._slopes(u, v)
        stretch = float((uu * vv - uv * vu).min())
        if stretch < _SMALLEST_STRETCH:
            raise UserError(f"{key}_a, {key}_b: areas shrink to {stretch:.3g}; allowed is above {_SMALLEST_STRETCH:g}")

    def _slopes(self, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """dU/du, dU/dv, dV/du, dV/dv."""
        return (
            1.0 + _sum_of(self.a, u, v, 1, 0),
            _sum_of(self.a, u, v, 0, 1),
            _sum_of(self.b, u, v, 1, 0),
            1.0 + _sum_of(self.b, u, v, 0, 1),
        )


def _sum_of(terms: Terms, u: Array, v: Array, du: int, dv: int) -> Array:
    """A polynomial, or its first derivative by u or v."""
    out = np.zeros_like(u)
    for p, q, c in terms:
        factor = c * (p if du else 1) * (q if dv else 1)
        if factor != 0.0:
            out += factor * u ** (p - du) * v ** (q - dv)
    return out
