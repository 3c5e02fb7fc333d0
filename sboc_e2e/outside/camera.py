"""A nominal camera for frames of an unknown one: what headers say, what stars show, and neutral values for the rest."""

from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from ground.astrometry import lost_in_space
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.outside.star_width import sources_of
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import from_document
from sboc_e2e.scenario.toml_files import FOLDER, preset_path, read

ASSUMED_PSF_SIGMA_PX: Final = 1.2
"""Where stars do not tell it: an FWHM of 2.8 px, between a sampled and an undersampled camera's. Chosen."""
ASSUMED_FOCAL_PX: Final = 1e5
"""Where nothing tells it: 2 arcsec/px. Chosen; without a WCS or a solution by stars, positions are published in pixels only."""
ASSUMED_SATURATION_ADU: Final = 1e9  # Above the numbers of cameras (16 bits hold 65,535): no pixel counts as full.
FRAMES_TRIED: Final = 3
"""Frames whose stars are solved blindly. Chosen, not measured: more frames cost time where no pattern fits."""
ROUNDEST_TRAIL: Final = 0.5
"""Sources whose minor axis is less than this share of the major one are no stars."""


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


def camera_of_frame(sourced: SourcedFrame, star_sigma_px: float | None) -> NominalCamera:
    """A camera guessed from one frame and the width of its stars, None where they do not tell it."""
    header, pixels = sourced.frame.header, sourced.frame.pixels
    finite = pixels if pixels.dtype.kind == "u" else pixels[np.isfinite(pixels)]
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
        psf_sigma_px=star_sigma_px or ASSUMED_PSF_SIGMA_PX,
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
    sources = sources_of(frame.pixels)[0]
    stars = sources[sources["b"] > ROUNDEST_TRAIL * sources["a"]]
    return lost_in_space.StarField(
        row=stars["y"], col=stars["x"], flux=stars["flux"], rows=frame.header.rows, cols=frame.header.cols
    )
