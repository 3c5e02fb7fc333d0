"""Calibration maps as files: what a map of the user's own may hold."""

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from sboc_e2e.files import calibration_files
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Calibration, NominalCamera

ROWS, COLS = 4, 6


def folder_with(path: Path, defects: np.ndarray) -> Path:
    camera = NominalCamera(
        name="c", rows=ROWS, cols=COLS, focal_px=1e4, center_row=1.5, center_col=2.5, psf_sigma_px=1.0, gain_e_adu=1.0,
        read_noise_e=2.0, saturation_adu=6e4, full_well_e=6e4, zero_point_e_s=None, aperture_m=0.1,
    )  # fmt: skip
    maps = np.zeros((2, ROWS, COLS), np.float32)
    made = Calibration(camera=camera, dark_adu=maps[0], flat=maps[1], defects=np.zeros((ROWS, COLS), np.uint8))
    calibration_files.write(path, made)
    fits.PrimaryHDU(defects).writeto(path / "defects.fits", overwrite=True)
    return path


@pytest.mark.parametrize("kind", ["uint8", "int16", "int32", "float32", "float64"])
def test_flags_of_any_type_that_fit_are_read(tmp_path: Path, kind: str) -> None:
    defects = np.zeros((ROWS, COLS), kind)
    defects[1, 2], defects[3, 5] = 3, 255
    read = calibration_files.read(folder_with(tmp_path, defects))
    assert read is not None
    assert read.defects.dtype == np.uint8
    assert np.argwhere(read.defects).tolist() == [[1, 2], [3, 5]]
    assert (read.defects[1, 2], read.defects[3, 5]) == (3, 255)


@pytest.mark.parametrize(
    ("kind", "value", "shown"), [("int16", 256, "256"), ("int32", -1, "-1"), ("float32", 1.5, "1.5"), ("float64", np.nan, "nan")]
)
def test_flags_that_would_become_others_are_refused(tmp_path: Path, kind: str, value: float, shown: str) -> None:
    """256 in a byte is 0, a good pixel. The user's map stays: a folder with it counts as whole, and is not made again."""
    defects = np.zeros((ROWS, COLS), kind)
    defects[2, 4] = value
    folder = folder_with(tmp_path, defects)
    with pytest.raises(UserError, match=rf"defects.fits: .* from 0 to 255, got {shown} at pixel \(2, 4\)"):
        calibration_files.read(folder)
    assert calibration_files.is_whole(folder)
