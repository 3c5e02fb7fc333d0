"""Directions of a frame's pixels as a TAN-SIP world coordinate system for FITS headers, of frames, cut-outs and binned images.

A header's WCS gives catalogue-relative (ICRS) directions, as any catalogue overlay expects: aberration and light deflection
are taken out. Coefficients come from linear least squares on a grid of pixels in scaled coordinates (Shupe et al. 2005,
ASP Conf. 347, 491), not from an iterative fit to stars.
"""

import re
from collections.abc import Callable
from typing import Any, Final

import erfa
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from ground.sky.apparent import apparent_context, mid_frame_tai_ns, observer_at
from ground.sky.pixel_sky import mid_frame_directions
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution

Array = NDArray[np.float64]

PixelIcrs = Callable[[Array, Array], tuple[Array, Array]]
"""Rows and cols (n,) to right ascension and declination (deg), catalogue-relative."""

SIP_ORDER: Final = 5
"""The lowest order that holds the terms r^3 and r^5 of a radial distortion."""
GRID: Final = 25
"""Points along each side: 625 for the 20 terms of a SIP polynomial, so that the fit cannot swing between them."""
_COEFFICIENT: Final = re.compile(r"[AB]P?_\d_\d")


def pixel_icrs(header: FrameHeader, solution: FrameSolution, wcs: Any = None) -> PixelIcrs | None:
    """ICRS directions of a frame's pixels: through the WCS that came with it, else through its solution, else None.

    A solution holds at mid-exposure of the middle row; the turning of the camera while rows are read is left out.
    """
    if wcs is not None:
        return lambda row, col: wcs.all_pix2world(col, row, 0)
    if solution.flags & FrameFlag.NO_SOLUTION:
        return None
    return lambda row, col: _icrs(solution, header, row, col)


def sip_header(icrs: PixelIcrs, rows: int, cols: int) -> fits.Header:
    """FITS keywords of a TAN-SIP WCS for an image of rows x cols pixels."""
    middle_row, middle_col = 0.5 * (rows - 1), 0.5 * (cols - 1)
    half = 0.5 * max(rows, cols)
    v, u = (
        a.ravel() for a in np.meshgrid(np.linspace(-0.5, 0.5, GRID) * rows, np.linspace(-0.5, 0.5, GRID) * cols, indexing="ij")
    )
    ra, dec = icrs(np.append(middle_row + v, middle_row), np.append(middle_col + u, middle_col))
    ra0, dec0 = float(ra[-1]), float(dec[-1])
    xi, eta = _gnomonic_deg(ra[:-1], dec[:-1], ra0, dec0)

    powers = [(p, q) for order in range(1, SIP_ORDER + 1) for p in range(order, -1, -1) for q in (order - p,)]
    design = np.stack([(u / half) ** p * (v / half) ** q for p, q in powers], axis=1)
    scale = np.array([half ** -(p + q) for p, q in powers])
    along_xi, along_eta = (np.linalg.lstsq(design, target, rcond=None)[0] * scale for target in (xi, eta))
    cd = np.array([along_xi[:2], along_eta[:2]])
    a, b = np.linalg.solve(cd, np.stack((along_xi, along_eta)))
    # intermediate pixel coordinates back to pixels
    seen_u, seen_v = np.linalg.solve(cd, np.stack((xi, eta)))
    inverse = np.stack([(seen_u / half) ** p * (seen_v / half) ** q for p, q in powers], axis=1)
    ap, bp = (np.linalg.lstsq(inverse, target, rcond=None)[0] * scale for target in (u - seen_u, v - seen_v))

    out = fits.Header()
    out["CTYPE1"], out["CTYPE2"] = "RA---TAN-SIP", "DEC--TAN-SIP"
    out["CUNIT1"], out["CUNIT2"] = "deg", "deg"
    out["RADESYS"], out["EQUINOX"] = "ICRS", 2000.0
    # FITS counts pixels from 1
    out["CRPIX1"], out["CRPIX2"] = middle_col + 1.0, middle_row + 1.0
    out["CRVAL1"], out["CRVAL2"] = ra0, dec0
    for i in (0, 1):
        for j in (0, 1):
            out[f"CD{i + 1}_{j + 1}"] = float(cd[i, j])
    for name, coefficients in (("A", a), ("B", b), ("AP", ap), ("BP", bp)):
        out[f"{name}_ORDER"] = SIP_ORDER
        for (p, q), value in zip(powers, coefficients, strict=True):
            if p + q >= 2 or name in ("AP", "BP"):
                out[f"{name}_{p}_{q}"] = float(value)
    return out


def of_cut_out(header: fits.Header, first_row: int, first_col: int) -> fits.Header:
    """The WCS of a cut-out whose pixel (0, 0) is this pixel of the image; LTV and LTM tell viewers the pixels of the image."""
    out = header.copy()
    out["CRPIX1"], out["CRPIX2"] = header["CRPIX1"] - first_col, header["CRPIX2"] - first_row
    out["LTV1"], out["LTV2"] = -float(first_col), -float(first_row)
    out["LTM1_1"], out["LTM2_2"] = 1.0, 1.0
    return out


def without_inverse(header: fits.Header) -> fits.Header:
    """The WCS without the polynomials from directions to pixels, half of its cards: readers iterate instead."""
    return fits.Header([tuple(card) for card in header.cards if not card.keyword.startswith(("AP_", "BP_"))])


def of_binned(header: fits.Header, cell_px: int) -> fits.Header:
    """The WCS of an image of cells of cell_px x cell_px pixels."""
    out = header.copy()
    for axis in ("1", "2"):
        out[f"CRPIX{axis}"] = (header[f"CRPIX{axis}"] - 0.5) / cell_px + 0.5
        out[f"LTV{axis}"], out[f"LTM{axis}_{axis}"] = 0.5 - 0.5 / cell_px, 1.0 / cell_px
    for key, value in header.items():
        if key.startswith("CD"):
            out[key] = value * cell_px
        elif _COEFFICIENT.fullmatch(key):
            p, q = key.split("_")[1:]
            out[key] = value * float(cell_px) ** (int(p) + int(q) - 1)
    return out


def _icrs(solution: FrameSolution, header: FrameHeader, row: Array, col: Array) -> tuple[Array, Array]:
    """Catalogue-relative right ascension and declination (deg) of pixels at mid-frame."""
    apparent = mid_frame_directions(solution, row, col)
    middle = mid_frame_tai_ns(header)
    context = apparent_context(middle, *observer_at(header.observer, middle))
    ra, dec = erfa.aticq(np.arctan2(apparent[:, 1], apparent[:, 0]), np.arcsin(np.clip(apparent[:, 2], -1.0, 1.0)), context)
    return np.degrees(ra), np.degrees(dec)


def _gnomonic_deg(ra_deg: Array, dec_deg: Array, ra0_deg: float, dec0_deg: float) -> tuple[Array, Array]:
    """Standard coordinates (deg) about a tangent point (Calabretta & Greisen 2002, A&A 395, 1077, section 5.1.3)."""
    d_ra, dec, dec0 = np.radians(ra_deg - ra0_deg), np.radians(dec_deg), np.radians(dec0_deg)
    depth = np.sin(dec) * np.sin(dec0) + np.cos(dec) * np.cos(dec0) * np.cos(d_ra)
    xi = np.cos(dec) * np.sin(d_ra) / depth
    eta = (np.sin(dec) * np.cos(dec0) - np.cos(dec) * np.sin(dec0) * np.cos(d_ra)) / depth
    return np.degrees(xi), np.degrees(eta)
