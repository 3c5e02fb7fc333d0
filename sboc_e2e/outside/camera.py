"""A nominal camera for frames of an unknown one: what headers say, what stars show, and neutral values for the rest."""

from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import sep
from numpy.typing import NDArray

from ground.astrometry import lost_in_space
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import from_document
from sboc_e2e.scenario.toml_files import FOLDER, preset_path, read

ASSUMED_PSF_SIGMA_PX: Final = 1.2
"""Where stars do not tell it: an FWHM of 2.8 px, between a sampled and an undersampled camera's. Chosen."""
ASSUMED_FOCAL_PX: Final = 1e5
"""Where nothing tells it: 2 arcsec/px. Chosen; without a WCS or a solution by stars, positions are published in pixels only."""
ASSUMED_SATURATION_ADU: Final = 1e9  # Above the numbers of cameras (16 bits hold 65,535): no pixel counts as full.
FEWEST_STARS: Final = 5  # The median width of five stars leaves out two that are none. Chosen, not measured.
FRAMES_TRIED: Final = 3
"""Frames whose stars are solved blindly. Chosen, not measured: more frames cost time where no pattern fits."""
ROUNDEST_TRAIL: Final = 0.5
"""Sources whose minor axis is less than this share of the major one are no stars."""

NO_SOURCES: Final = np.zeros(0, dtype=[(name, "f8") for name in ("x", "y", "a", "b", "flux", "peak")] + [("flag", "i8")])


def camera_of_preset(name: str, registry: Registry) -> NominalCamera:
    """The nominal camera of an instrument preset: a name in scenarios/presets or the path of a TOML file; or of a file that
    `sboc camera make` wrote.
    """
    path = Path(name) if name.endswith(".toml") else preset_path(name, "instrument", FOLDER, "--camera")
    tables = read(path)
    if set(tables) == {"camera"}:
        return camera_of_table(tables["camera"], str(path))
    document = tables | {"frames": 1, "population": {"classes": []}, "objects": {"passing": []}}
    scenario = from_document(document, name=path.stem, registry=registry, where=str(path))
    from simulator.chain import Simulator  # takes half a second, which a camera that is guessed does not need

    return Simulator(scenario.simulator, seed=scenario.seed, catalogue=StarCatalogue.embedded()).camera()


def camera_of_table(table: dict[str, Any], where: str) -> NominalCamera:
    """The camera of a file's table. Raises `UserError` for keys that it does not have and values that it refuses."""
    known = {each.name for each in fields(NominalCamera)}
    odd = sorted(set(table) - known)
    if odd:
        raise UserError(f"{where}: camera.{odd[0]} is no key of a camera; known: {', '.join(sorted(known))}")
    try:
        return NominalCamera(**({"zero_point_e_s": None} | table))
    except (TypeError, ContractError) as error:
        raise UserError(f"{where}: camera: {error}") from error


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
        focal_px=next(iter(sourced.focal_hints_px), ASSUMED_FOCAL_PX),
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


def focal_px_by_stars(source: FrameSource, catalogue: StarCatalogue) -> float:
    """Focal length in pixels of an unknown camera, from star patterns of its first frames.

    Raises `UserError` where none of them fits; the error says what to give instead.
    """
    fields: list[lost_in_space.StarField] = []
    hints: tuple[float, ...] = ()
    for sourced in islice(source.frames(), FRAMES_TRIED):
        fields.append(_star_field(sourced.frame))
        hints = hints or sourced.focal_hints_px
    found = lost_in_space.find_scale(fields, hints, catalogue)
    if found is not None:
        return found.focal_px
    narrowest, widest = lost_in_space.NARROWEST_DEG, lost_in_space.DATABASES[0][2]
    hinted = f"; the header says {lost_in_space.width_of(hints[0], fields[0].cols):.2g} deg" if hints else ""
    raise UserError(
        f"--wcs solve: the stars of the first {len(fields)} frames fit no field {narrowest:g} to {widest:g} deg wide{hinted}; "
        "give --camera, or PIXSCALE (arcsec) in the headers, or take --wcs header or --wcs none"
    )


def refuse_narrow_field(camera: NominalCamera) -> None:
    """Raises `UserError` for a field that star patterns cannot solve."""
    width_deg = lost_in_space.width_of(camera.focal_px, camera.cols)
    if width_deg < lost_in_space.NARROWEST_DEG:
        raise UserError(
            f"--wcs solve: {camera.cols} columns of camera {camera.name} are {width_deg:.2g} deg; patterns need "
            f"{lost_in_space.NARROWEST_DEG:g}; take --wcs header or --wcs none"
        )


def _star_field(frame: Frame) -> lost_in_space.StarField:
    """Star-like sources of a frame."""
    sources = _sources(frame.pixels)[0]
    stars = sources[sources["b"] > ROUNDEST_TRAIL * sources["a"]]
    return lost_in_space.StarField(
        row=stars["y"], col=stars["x"], flux=stars["flux"], rows=frame.header.rows, cols=frame.header.cols
    )


def star_sigma_px(pixels: NDArray[np.float32]) -> float | None:
    """PSF sigma from round, unblended, unsaturated sources (SExtractor moments); None when there are too few.

    Moments above a threshold miss the wings; sources well above it, as taken here, give the width to 15 %. Below 1 px the
    pixels themselves widen it, by a third at 0.8 px.
    """
    sources, noise, peak = _sources(pixels)
    stars = sources[
        (sources["flag"] == 0)
        & (sources["b"] > 0.7 * sources["a"])
        & (sources["peak"] > 15.0 * noise)
        & (sources["peak"] < 0.7 * peak)
    ]
    if len(stars) < FEWEST_STARS:
        return None
    return float(np.clip(np.median(np.sqrt(stars["a"] * stars["b"])), 0.4, 20.0))


def _sources(pixels: NDArray[Any]) -> tuple[NDArray[Any], float, float]:
    """SExtractor's records of what is brighter than 5 sigma, none in frames too crowded for it; noise and highest value."""
    image = np.nan_to_num(np.ascontiguousarray(pixels, dtype=np.float32), nan=float(np.nanmedian(pixels)))
    background = sep.Background(image)
    noise, peak = max(float(background.globalrms), 1e-6), float(image.max())
    image -= background.back()
    try:
        return sep.extract(image, 5.0, err=noise, minarea=5), noise, peak
    except Exception as error:  # sep raises bare Exception when its buffers overflow in crowded frames
        if "internal pixel buffer full" in str(error) or "object deblending overflow" in str(error):
            return NO_SOURCES, noise, peak
        raise
