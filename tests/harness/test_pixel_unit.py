"""The unit of a frame's pixels: noise, a gain that is assumed or denied, numbers that are tiny."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.pixel_unit import CameraUnits, assumed_gain_e_adu, noise_adu, usable_unit

NOISE = np.random.default_rng(6).normal(0.0, 5.0, (300, 280))


def frame_of(folder: Path, image: NDArray[Any], **header: Any) -> SourcedFrame:
    """The one frame of a file."""
    fits.PrimaryHDU(image, fits.Header(header)).writeto(folder / "a.fits")
    (found,) = FitsFolder(path=folder).frames()
    return found


def test_the_noise_of_a_pixel_is_its_scatter() -> None:
    """Where neighbours share it too, and on a sky that rises."""
    rise = 0.05 * np.arange(280.0)
    assert noise_adu(NOISE) == pytest.approx(5.0, rel=0.02)
    smooth = gaussian_filter(NOISE, 0.8)
    assert noise_adu(smooth + rise) == pytest.approx(float(smooth.std()), rel=0.05)
    assert noise_adu(np.zeros((20, 20))) == noise_adu(np.full((20, 20), np.nan)) == 0.0


@pytest.mark.parametrize("sigma_adu", [0.2, 0.5, 1.0, 1.3, 2.0, 4.0, 7.0])
def test_the_noise_of_whole_numbers_has_that_of_rounding(sigma_adu: float) -> None:
    """A twelfth of a squared number is added to the variance; percentiles of whole numbers would give 0, 0.71, 1.41 and so on."""
    rounded = np.rint(NOISE * (sigma_adu / 5.0))
    assert noise_adu(rounded) == pytest.approx(np.hypot(sigma_adu, 12**-0.5), rel=0.06 if sigma_adu > 0.5 else 0.25)


@pytest.mark.parametrize(("factor", "gain_e_adu"), [(1e-2, 100.0), (0.2, 5.0), (0.8, 1.25), (10.0, 1.0), (1e4, 1.0)])
def test_an_assumed_gain_gives_the_noise_5_electrons_or_more(factor: float, gain_e_adu: float) -> None:
    assert assumed_gain_e_adu(NOISE * factor) == pytest.approx(gain_e_adu, rel=0.02)


def test_a_gain_that_the_noise_denies_is_none(tmp_path: Path) -> None:
    """A frame divided by its exposure or its sky keeps the gain of the raw one in its header."""
    found = frame_of(tmp_path, (1.0 + NOISE / 500.0).astype(np.float32), GAIN=1.5)
    assert found.frame.header.gain_e_adu is None
    (note,) = [note.text for note in found.notes if note.kind == "GAIN denied"]
    assert note == "GAIN = 1.5 e-/ADU leaves pixels too little noise: that of --camera is taken, or a guess from the noise"


def test_a_gain_that_fits_is_taken_and_egain_goes_before_gain(tmp_path: Path) -> None:
    """Programs of amateurs write the setting of the camera as GAIN, and e-/ADU as EGAIN."""
    found = frame_of(tmp_path, (100.0 + NOISE).astype(np.float32), GAIN=120.0, EGAIN=0.8)
    assert found.frame.header.gain_e_adu == 0.8


@pytest.mark.parametrize(("scale", "unit"), [(1.0, 1.0), (1e-3, 1.0), (1e-5, 1e6), (1e-20, 1e18)])
def test_tiny_numbers_are_multiplied_and_that_is_said(tmp_path: Path, scale: float, unit: float) -> None:
    """Noise of 5 times the scale: a thousandth and more stays. Fluxes in erg/(s cm2 A) are of the order of 1e-20."""
    image = (100.0 + NOISE) * scale
    assert usable_unit(image) == pytest.approx(unit)
    found = frame_of(tmp_path, image, SATURATE=3.0)
    assert np.allclose(found.frame.pixels, image * unit, rtol=1e-6, atol=0.0)
    assert found.frame.header.saturation_adu == (pytest.approx(3.0 * unit) if unit < 1e15 else None)
    assert [note.text for note in found.notes if note.kind == "unit"] == (
        [] if unit == 1.0 else [f"pixels multiplied by {unit:.0e}: noise of this camera is below a thousandth"]
    )


def test_a_camera_keeps_the_unit_of_its_first_frame_of_real_numbers() -> None:
    units = CameraUnits()
    raw = np.rint(100.0 + NOISE).astype(np.uint16)
    tiny, larger = ((100.0 + NOISE) * noise / 5.0 for noise in (0.9e-3, 1.1e-3))
    assert [units.of_next("one", pixels) for pixels in (raw, tiny, larger, raw)] == [1.0, 1e6, 1e6, 1.0]
    assert units.of_next("two", larger) == 1.0
    assert units.of_next("one", np.full((20, 20), np.nan)) == 1e6


def test_frames_of_one_camera_have_one_unit(tmp_path: Path) -> None:
    """0.9 and 1.1 thousandths of noise lie on both sides of a border. Another camera's frame, and a raw one, have their own."""
    for name, noise, camera in (("a", 0.9e-3, "one"), ("b", 1.1e-3, "one"), ("c", 1.1e-3, "two"), ("d", 900.0, "one")):
        frame = fits.PrimaryHDU(np.asarray((100.0 + NOISE) * noise / 5.0, dtype=np.float32))
        frame.header["INSTRUME"] = camera
        frame.writeto(tmp_path / f"{name}.fits")
    raw = fits.PrimaryHDU(np.rint(100.0 + NOISE).astype(np.uint16))
    raw.header["INSTRUME"] = "one"
    raw.writeto(tmp_path / "b_raw.fits")
    sky = [float(np.median(sourced.frame.pixels)) for sourced in FitsFolder(path=tmp_path).frames()]
    assert sky == pytest.approx([20.0 * 0.9e3, 20.0 * 1.1e3, 100.0, 20.0 * 1.1e-3, 20.0 * 900.0], rel=0.01)
