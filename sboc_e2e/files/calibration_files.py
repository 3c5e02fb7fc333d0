"""calibration/ of a run: the nominal camera, dark, flat and defect maps; all that ground may know besides the downlink."""

import dataclasses
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_bytes, write_json
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Calibration, NominalCamera

CAMERA: Final = "camera.json"
MAPS: Final = ("dark", "flat", "defects")
MOST_FLAGS: Final = 255
"""All eight bits of a defect map's byte."""


def write(folder: Path, calibration: Calibration) -> None:
    """Write the four files, the camera last: a folder with a camera is complete."""
    maps: dict[str, NDArray[Any]] = {"dark": calibration.dark_adu, "flat": calibration.flat, "defects": calibration.defects}
    for name in MAPS:
        stream = io.BytesIO()
        fits.PrimaryHDU(np.asarray(maps[name])).writeto(stream)
        write_bytes(folder / f"{name}.fits", stream.getvalue())
    document = {"provenance": calibration.provenance, "camera": dataclasses.asdict(calibration.camera)}
    write_json(folder / CAMERA, document)


def is_whole(folder: Path) -> bool:
    """Whether the four files are there and can be read; a folder without a camera, or with a damaged file, is not."""
    try:
        read_camera(folder)
        return all(_map(folder / f"{name}.fits") is not None for name in MAPS)
    except UserError:
        return False


def write_camera(folder: Path, camera: NominalCamera, provenance: str) -> None:
    """Write a camera without maps, for frames from outside."""
    write_json(folder / CAMERA, {"provenance": provenance, "camera": dataclasses.asdict(camera)})


def write_cameras(folder: Path, cameras: Sequence[NominalCamera], camera_of: Mapping[int, int]) -> None:
    """Write cameras of frames from outside, the first of which counts where one is asked for. camera_of : by frame number."""
    listed = [
        {"frames": sorted(number for number, of in camera_of.items() if of == place), "camera": dataclasses.asdict(camera)}
        for place, camera in enumerate(cameras)
    ]
    text = "guessed from the first frame of each camera"
    write_json(folder / CAMERA, {"provenance": text, "camera": listed[0]["camera"], "cameras": listed})


def read_camera(folder: Path) -> NominalCamera:
    """The nominal camera of a run."""
    return _camera(folder)[0]


def read(folder: Path) -> Calibration | None:
    """The calibration of a run; None when it holds a camera but no maps (frames from outside)."""
    camera, provenance = _camera(folder)
    if not any((folder / f"{name}.fits").exists() for name in MAPS):
        return None
    maps = {name: _map(folder / f"{name}.fits") for name in MAPS}
    return Calibration(
        camera=camera,
        dark_adu=maps["dark"].astype(np.float32),
        flat=maps["flat"].astype(np.float32),
        defects=_flags(maps["defects"], folder / "defects.fits"),
        provenance=provenance,
    )


def _camera(folder: Path) -> tuple[NominalCamera, str]:
    path = folder / CAMERA
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        return NominalCamera(**document["camera"]), str(document["provenance"])
    except FileNotFoundError as error:
        raise UserError(f"{path}: not found; the simulate stage writes it") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: not a camera file ({error})") from error


def _map(path: Path) -> NDArray[Any]:
    try:
        return np.asarray(fits.getdata(path))
    except (OSError, ValueError, TypeError) as error:
        raise UserError(f"{path}: missing or damaged calibration map; run the simulate stage again") from error


def _flags(values: NDArray[Any], path: Path) -> NDArray[np.uint8]:
    """A map of `MaskBit` in one byte a pixel; UserError for values that would become other flags in it."""
    if values.dtype == np.uint8:
        return values
    wrong = np.argwhere(~((values >= 0) & (values <= MOST_FLAGS) & (values == np.floor(values))))
    if len(wrong):
        place = tuple(wrong[0].tolist())
        raise UserError(f"{path}: expected whole numbers from 0 to {MOST_FLAGS}, got {values[place]:g} at pixel {place}")
    return values.astype(np.uint8)
