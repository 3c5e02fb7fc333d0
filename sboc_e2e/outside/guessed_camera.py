"""A nominal camera for frames of an unknown one: what headers say, what stars show, and neutral values for the rest."""

from typing import Final

import numpy as np

from ground.vetting.likelihood import UNKNOWN_PSF_SIGMA_PX
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.pixel_unit import assumed_gain_e_adu

ASSUMED_PSF_SIGMA_PX: Final = UNKNOWN_PSF_SIGMA_PX
"""Where stars do not tell it: what the vetter takes then, too."""
ASSUMED_FOCAL_PX: Final = 1e5
"""Where nothing tells it: 2 arcsec/px. Chosen; without a WCS or a solution by stars, positions are published in pixels only."""
ASSUMED_SATURATION_ADU: Final = 1e9  # Above the numbers of cameras (16 bits hold 65,535): no pixel counts as full.


def camera_of_frame(sourced: SourcedFrame, star_sigma_px: float | None) -> NominalCamera:
    """A camera guessed from one frame and the width of its stars, None where they do not tell it."""
    header, pixels = sourced.frame.header, sourced.frame.pixels
    finite = pixels if pixels.dtype.kind == "u" else pixels[np.isfinite(pixels)]
    top = float(finite.max()) if finite.size else 1.0
    saturation = header.saturation_adu or max(ASSUMED_SATURATION_ADU, 2.0 * top)
    gain = header.gain_e_adu or assumed_gain_e_adu(pixels)
    return NominalCamera(
        name="unknown",
        rows=header.rows,
        cols=header.cols,
        focal_px=next(iter(sourced.focal_hints_px), ASSUMED_FOCAL_PX),
        center_row=0.5 * (header.rows - 1),
        center_col=0.5 * (header.cols - 1),
        psf_sigma_px=star_sigma_px or ASSUMED_PSF_SIGMA_PX,
        psf_known=False,
        gain_e_adu=gain,
        read_noise_e=header.read_noise_e or 0.0,
        saturation_adu=saturation,
        full_well_e=saturation * gain,
        zero_point_e_s=None,
        aperture_m=1.0,
    )
