"""The WCS of a header, if its directions can be believed everywhere in the frame; otherwise what is wrong with it.

Headers of other people hold text where numbers belong, matrices of zeros, poles and projections that end inside the frame. Such
a frame is processed in pixels, and a note says why.
"""

import logging
import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from sboc_e2e.outside.frame_source import Note
from sboc_e2e.outside.header_values import MAX_SHOWN

if TYPE_CHECKING:
    from astropy.wcs import WCS

NUMBERS: Final = ("CRVAL1", "CRVAL2", "CRPIX1", "CRPIX2")
"""Without one of these the standard's default is a place on the sky that nobody meant."""

MATRIX: Final = tuple(f"{name}{i}_{j}" for name in ("CD", "PC") for i in (1, 2) for j in (1, 2))
SCALES: Final = ("CDELT1", "CDELT2", "CROTA1", "CROTA2", "EQUINOX", "LONPOLE", "LATPOLE")

FINEST_DEG: Final = 1e-7
"""Smaller pixels are not believed: 0.36 mas, a tenth of the 3.6 mas of SPHERE/ZIMPOL, which are among the finest."""
COARSEST_DEG: Final = 0.5
"""Larger pixels are not believed: 1 is the default of a header's keys."""

MOST_UNEQUAL: Final = 10.0
"""Largest over smallest step of the sky to a neighbouring pixel, in the whole frame: fisheyes reach 3."""

MARGIN_PX: Final = 20.0
"""Fits of trails that leave the frame end so far outside it."""

GRID: Final = 5
"""Points a side at which directions are tried: 25, corners and edges among them. Chosen, not measured."""
ROUND_TRIP_PX: Final = 0.5
"""Chosen, not measured: astropy's inverse iterates to 1e-4 px; where it misses by half a pixel, it has not converged."""


def usable_wcs(header: fits.Header, rows: int, cols: int) -> "tuple[WCS | None, Note | None]":
    """The WCS of a frame of that size with RA and Dec (ICRS) from pixels, or None; and a note on one that is not believed.

    No note where the header does not try to give one.
    """
    if not any(isinstance(header.get(key), str) and header[key].strip() for key in ("CTYPE1", "CTYPE2")):
        return None, None
    from astropy.wcs import WCS  # takes a fifth of a second, which frames without directions do not need

    with warnings.catch_warnings(), np.errstate(all="ignore"), _unsaid():
        warnings.simplefilter("ignore")
        try:
            wrong = _wrong_value(header)
            wcs = None if wrong else WCS(header)
            wrong = wrong or _wrong_axes(wcs) or _wrong_directions(wcs, rows, cols)
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - wcslib and astropy raise nearly everything at odd headers
            text = str(error).strip().splitlines()
            wcs, wrong = None, f"it cannot be read ({text[-1][:80] if text else type(error).__name__})"
    return (None, Note(kind="WCS", text=f"WCS not used, positions in pixels only: {wrong}")) if wrong else (wcs, None)


@contextmanager
def _unsaid() -> Iterator[None]:
    """Without astropy's own log: it writes fourteen lines about coefficients without a suffix to where our figures go."""
    log = logging.getLogger("astropy")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def _wrong_value(header: Mapping[str, Any]) -> str | None:
    """A key that holds no number, though it must."""
    for key in (*NUMBERS, *MATRIX, *SCALES):
        value = header.get(key)
        if value is None and key not in NUMBERS:
            continue
        if value is None or isinstance(value, fits.card.Undefined):
            return f"no {key}"
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return f"{key} = {str(value)[:MAX_SHOWN]!r} is no number"
    return None


def _wrong_axes(wcs: "WCS") -> str | None:
    """Axes that are not RA and Dec, in this order, of the ICRS or of J2000 (which differ by 0.02 arcsec)."""
    from astropy.coordinates import FK5, ICRS
    from astropy.wcs.utils import wcs_to_celestial_frame

    if not wcs.has_celestial or wcs.naxis != 2:
        return "it is no celestial one of two axes"
    kinds = [str(kind)[:4].rstrip("-") for kind in wcs.wcs.ctype]
    if kinds != ["RA", "DEC"]:
        return f"its axes are {' and '.join(kinds)}, not RA and DEC"
    frame = wcs_to_celestial_frame(wcs)
    if isinstance(frame, ICRS) or (isinstance(frame, FK5) and abs(frame.equinox.jyear - 2000.0) < 0.1):
        return None
    return f"its directions are {frame.name.upper()} of {frame.equinox}, not ICRS or J2000"


def _wrong_directions(wcs: "WCS", rows: int, cols: int) -> str | None:
    """Directions that are no numbers, pixels of absurd size, or places that do not come back to their pixels."""
    grid = np.meshgrid(np.linspace(-MARGIN_PX, cols - 1 + MARGIN_PX, GRID), np.linspace(-MARGIN_PX, rows - 1 + MARGIN_PX, GRID))
    col, row = (axis.ravel() for axis in grid)
    steps = _steps_deg(wcs, col, row)
    if not np.isfinite(steps).all():
        return "parts of the frame have no direction"
    if steps.min() < FINEST_DEG or steps.max() > COARSEST_DEG:
        return f"its pixels are {steps.min():.2g} to {steps.max():.2g} deg; believed are {FINEST_DEG:g} to {COARSEST_DEG:g}"
    if steps.max() > MOST_UNEQUAL * steps.min():
        return f"its pixels differ in size by {steps.max() / steps.min():.2g} within the frame"
    back_col, back_row = wcs.all_world2pix(*wcs.all_pix2world(col, row, 0), 0, quiet=True)
    if not np.hypot(back_col - col, back_row - row).max() < ROUND_TRIP_PX:
        return "its directions do not lead back to their pixels"
    return None


def _steps_deg(wcs: "WCS", col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) longest and shortest way on the sky that one pixel makes, from half-pixel steps; holds at the poles too."""

    def direction(col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        ra, dec = (np.radians(angle) for angle in wcs.all_pix2world(col, row, 0))
        return np.stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)), axis=-1)

    slope = np.stack(
        (direction(col + 0.5, row) - direction(col - 0.5, row), direction(col, row + 0.5) - direction(col, row - 0.5)), axis=-1
    )
    if not np.isfinite(slope).all():
        return np.full((len(col), 2), np.nan)
    return np.degrees(np.linalg.svd(slope, compute_uv=False))
