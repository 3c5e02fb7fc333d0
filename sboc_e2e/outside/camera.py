"""A nominal camera for frames of an unknown one: what headers say, what stars show, and neutral values for the rest."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import sep
from astropy.wcs.utils import proj_plane_pixel_scales
from numpy.typing import NDArray

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import from_document
from sboc_e2e.scenario.toml_files import FOLDER, preset_path, read
from simulator.chain import Simulator

ASSUMED_PSF_SIGMA_PX: Final = 1.2
ASSUMED_FOCAL_PX: Final = 1e5
ASSUMED_SATURATION_ADU: Final = 1e9
FEWEST_STARS: Final = 5


def camera_of_preset(name: str, registry: Registry) -> NominalCamera:
    """The nominal camera of an instrument preset: a name in scenarios/presets or the path of a TOML file."""
    path = Path(name) if name.endswith(".toml") else preset_path(name, FOLDER, "--camera")
    document = read(path) | {"frames": 1, "population": {"classes": []}, "objects": {"passing": []}}
    scenario = from_document(document, name=path.stem, registry=registry, where=str(path))
    return Simulator(scenario.simulator, seed=scenario.seed, catalogue=StarCatalogue.embedded()).camera()


def camera_of_frame(sourced: SourcedFrame) -> NominalCamera:
    """A camera guessed from one frame."""
    header, pixels = sourced.frame.header, sourced.frame.pixels
    finite = pixels[np.isfinite(pixels)]
    top = float(finite.max()) if finite.size else 1.0
    saturation = header.saturation_adu or max(ASSUMED_SATURATION_ADU, 2.0 * top)
    gain = header.gain_e_adu or 1.0
    return NominalCamera(
        name="unknown",
        rows=header.rows,
        cols=header.cols,
        focal_px=focal_px_of(sourced.wcs),
        center_row=0.5 * (header.rows - 1),
        center_col=0.5 * (header.cols - 1),
        psf_sigma_px=star_sigma_px(np.asarray(pixels, dtype=np.float32)) or ASSUMED_PSF_SIGMA_PX,
        psf_known=False,
        gain_e_adu=gain,
        read_noise_e=header.read_noise_e or 0.0,
        saturation_adu=saturation,
        full_well_e=saturation * gain,
        zero_point_e_s=None,
        aperture_m=1.0,
    )


def focal_px_of(wcs: Any) -> float:
    """Focal length in pixels from the plate scale of a WCS; a neutral value without one."""
    if wcs is None:
        return ASSUMED_FOCAL_PX
    scale_deg = float(np.sqrt(np.prod(proj_plane_pixel_scales(wcs.celestial))))
    return float(1.0 / np.radians(scale_deg)) if 0.0 < scale_deg < 10.0 else ASSUMED_FOCAL_PX


def star_sigma_px(pixels: NDArray[np.float32]) -> float | None:
    """PSF sigma from round, unblended, unsaturated sources (SExtractor moments); None when there are too few.

    Moments above a threshold miss the wings; sources well above it, as taken here, give the width to 15 %. Below 1 px the
    pixels themselves widen it, by a third at 0.8 px.
    """
    image = np.nan_to_num(np.ascontiguousarray(pixels, dtype=np.float32), nan=float(np.nanmedian(pixels)))
    try:
        background = sep.Background(image)
        sources = sep.extract(image - background.back(), 5.0, err=max(background.globalrms, 1e-6), minarea=5)
    except Exception as error:  # sep raises bare Exception when its buffers overflow in crowded frames
        if "internal pixel buffer full" in str(error) or "object deblending overflow" in str(error):
            return None
        raise
    if len(sources) == 0:
        return None
    noise = max(float(background.globalrms), 1e-6)
    peak = float(image.max())
    stars = sources[
        (sources["flag"] == 0)
        & (sources["b"] > 0.7 * sources["a"])
        & (sources["peak"] > 15.0 * noise)
        & (sources["peak"] < 0.7 * peak)
    ]
    if len(stars) < FEWEST_STARS:
        return None
    return float(np.clip(np.median(np.sqrt(stars["a"] * stars["b"])), 0.4, 20.0))
