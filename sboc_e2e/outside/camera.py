"""Cameras of frames from outside: of a preset or a file, and the focal length that star patterns show."""

import math
from dataclasses import dataclass, fields, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from ground.astrometry import lost_in_space
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.outside.guessed_camera import ASSUMED_SATURATION_ADU
from sboc_e2e.outside.star_width import sources_of
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import from_document
from sboc_e2e.scenario.toml_files import FOLDER, preset_path, read

FRAMES_TRIED: Final = 3
"""Frames whose stars are solved blindly. Chosen, not measured: more frames cost time where no pattern fits."""
ROUNDEST_TRAIL: Final = 0.5
"""Sources whose minor axis is less than this share of the major one are no stars."""


PIXELS_TIMES: Final = "pixels_times"
"""Key of a camera file: what the numbers of FITS files are multiplied by before they are the camera's ADU."""


@dataclass(frozen=True, kw_only=True)
class KnownCamera:
    """A camera that was given. pixels_times : its ADU are the numbers of files times this; None: whatever a frame's are."""

    nominal: NominalCamera
    pixels_times: float | None = None

    def for_frame(self, frame: Frame, unit: float) -> NominalCamera:
        """The camera for frames of the size and the unit of this one: same scale, axis in the middle, gain and saturation in ADU
        that are the file's numbers times `unit`. Raises `UserError` where such ADU have no gain that a camera may have.
        """
        header, camera = frame.header, self.nominal
        if (camera.rows, camera.cols) != (header.rows, header.cols):
            middle_row, middle_col = 0.5 * (header.rows - 1), 0.5 * (header.cols - 1)
            camera = replace(camera, rows=header.rows, cols=header.cols, center_row=middle_row, center_col=middle_col)
        if self.pixels_times is None or math.isclose(self.pixels_times, unit):
            return camera
        times = unit / self.pixels_times
        full = camera.saturation_adu * (1.0 if camera.saturation_adu >= ASSUMED_SATURATION_ADU else times)
        try:
            return replace(camera, gain_e_adu=camera.gain_e_adu / times, saturation_adu=full)
        except ContractError as error:
            text = f"--camera: made of pixels times {self.pixels_times:g}, and these frames are pixels times {unit:g}"
            raise UserError(f"{text}, which leaves no gain; make a camera of such frames ({error})") from error


def camera_of_preset(name: str, registry: Registry) -> KnownCamera:
    """The camera of an instrument preset: a name in scenarios/presets or the path of a TOML file; or of a file that
    `sboc camera make` wrote.
    """
    path = Path(name) if name.endswith(".toml") else preset_path(name, "instrument", FOLDER, "--camera")
    tables = read(path)
    if set(tables) == {"camera"}:
        return camera_of_table(tables["camera"], str(path))
    document = tables | {"frames": 1, "population": {"classes": []}, "objects": {"passing": []}}
    scenario = from_document(document, name=path.stem, registry=registry, where=str(path))
    from simulator.chain import Simulator  # takes half a second, which a camera that is guessed does not need

    nominal = Simulator(scenario.simulator, seed=scenario.seed, catalogue=StarCatalogue.embedded()).camera()
    return KnownCamera(nominal=nominal)


def camera_of_table(table: dict[str, Any], where: str) -> KnownCamera:
    """The camera of a file's table. Raises `UserError` for keys that it does not have and values that it refuses."""
    known = {each.name for each in fields(NominalCamera)} | {PIXELS_TIMES}
    odd = sorted(set(table) - known)
    if odd:
        raise UserError(f"{where}: camera.{odd[0]} is no key of a camera; known: {', '.join(sorted(known))}")
    times = table.get(PIXELS_TIMES)
    if times is not None and (isinstance(times, bool) or not isinstance(times, int | float) or not 0.0 < times < math.inf):
        raise UserError(f"{where}: camera.{PIXELS_TIMES}: expected a number above 0, got {times!r}")
    values = {key: value for key, value in table.items() if key != PIXELS_TIMES}
    try:
        return KnownCamera(nominal=NominalCamera(**({"zero_point_e_s": None} | values)), pixels_times=times)
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


def focal_px_of_frame(sourced: SourcedFrame, catalogue: StarCatalogue, otherwise: float) -> float:
    """Focal length in pixels of the camera of a frame from its star patterns; where none fits, of its header, or `otherwise`."""
    found = lost_in_space.find_scale([_star_field(sourced.frame)], sourced.focal_hints_px, catalogue)
    return found.focal_px if found is not None else next(iter(sourced.focal_hints_px), otherwise)


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
