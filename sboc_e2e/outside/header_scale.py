"""The scale of a frame's pixels on the sky, as its header tells it in one way or another."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sboc_e2e.outside.header_values import number_of, quietly
from sboc_e2e.outside.header_wcs import COARSEST_DEG, FINEST_DEG

if TYPE_CHECKING:
    from astropy.wcs import WCS


def focal_hints_px(header: Mapping[str, Any], wcs: "WCS | None") -> tuple[float, ...]:
    """Distinct focal lengths in pixels: by the WCS, by keys of the pixel scale (arcsec), by focal length (mm) and pixel (um).

    Programs differ on whether XPIXSZ and PIXSIZE1 count binning, so both readings are given.
    """
    scales_deg = [] if wcs is None else [_scale_deg(wcs)]
    scale_arcsec = number_of(header, ("PIXSCALE", "SECPIX", "SECPIX1", "SCALE"), 1e-3, 3600.0)
    if scale_arcsec is not None:
        scales_deg.append(scale_arcsec / 3600.0)
    focal_mm = number_of(header, ("FOCALLEN", "FOCAL"), 1.0, 1e6)
    pixel_um = number_of(header, ("XPIXSZ", "PIXSIZE1"), 0.1, 1e3)
    if focal_mm is not None and pixel_um is not None:
        binning = number_of(header, ("XBINNING", "CCDXBIN"), 1.0, 64.0) or 1.0
        scales_deg += [math.degrees(1e-3 * pixel_um * factor / focal_mm) for factor in (1.0, binning)]
    scales_deg.append(abs(number_of(header, ("CDELT1",), -COARSEST_DEG, COARSEST_DEG) or 0.0))
    hints: list[float] = []
    for scale_deg in scales_deg:
        if FINEST_DEG < scale_deg < COARSEST_DEG and all(abs(math.radians(scale_deg) * known - 1.0) > 0.02 for known in hints):
            hints.append(1.0 / math.radians(scale_deg))
    return tuple(hints)


def _scale_deg(wcs: "WCS") -> float:
    """Size of a pixel by a WCS, the geometric mean of both axes; 0 where it has none."""
    from astropy.wcs.utils import proj_plane_pixel_scales

    try:
        with quietly():
            return float(np.sqrt(np.prod(proj_plane_pixel_scales(wcs.celestial))))
    except Exception:  # noqa: BLE001 - whatever a header holds, the frame is a frame
        return 0.0
