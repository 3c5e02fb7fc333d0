"""Cameras of frames from outside: of a preset or a file, and the focal length that star patterns show."""

from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any, Final

from ground.astrometry import lost_in_space
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside.frame_source import FrameSource
from sboc_e2e.outside.star_width import sources_of
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import from_document
from sboc_e2e.scenario.toml_files import FOLDER, preset_path, read

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
