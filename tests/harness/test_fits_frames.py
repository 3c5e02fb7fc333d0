"""FITS files of others as frames: forms of data, headers with and without the keys that matter, WCS."""

import bz2
import gzip
import lzma
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from scipy.special import ndtr

from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.tai import from_jd_parts
from sboc_e2e.outside import star_width
from sboc_e2e.outside.first_frame import FirstFrame
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.guessed_camera import camera_of_frame
from sboc_e2e.outside.header_times import FIRST_ASSUMED_TAI_NS
from sboc_e2e.outside.star_width import star_sigma_px

SKY = np.random.default_rng(4).normal(1000.0, 5.0, (65, 71))


def frames(folder: Path) -> list[SourcedFrame]:
    return list(FitsFolder(path=folder).frames())


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"])
def test_every_type_of_pixel_keeps_its_values(tmp_path: Path, dtype: str) -> None:
    image = (SKY / 8 if dtype == "uint8" else SKY).astype(dtype)
    fits.PrimaryHDU(image).writeto(tmp_path / "a.fits")
    (found,) = frames(tmp_path)
    assert found.frame.pixels.dtype == (np.float32 if dtype.startswith("float") else np.uint16)
    assert np.array_equal(found.frame.pixels, image.astype(found.frame.pixels.dtype))
    assert found.frame.pixels.dtype.isnative


@pytest.mark.parametrize("key", ["SKEW", "CTYPE1", "EXPTIME", "BLANK", "BITPIX"])
def test_a_card_without_a_closing_quote_is_left_out_and_named(tmp_path: Path, key: str) -> None:
    """SKEW of an archive's picture began with a quote that did not end, and the frame was refused for it."""
    header = fits.Header({"OBJECT": "a field", "SKEW": "-1.1, -2.2", "CTYPE1": "RA---TAN", "EXPTIME": "10", "BLANK": -1})
    fits.PrimaryHDU(SKY.astype(np.int16), header).writeto(tmp_path / "a.fits")
    data = (tmp_path / "a.fits").read_bytes()
    at = data.index(f"{key:<8}=".encode())
    broken = f"{key:<8}= '-1.1119389479069E-01, -2.1538987987253E-01 / Measure of skew".ljust(80).encode()
    (tmp_path / "a.fits").write_bytes(data[:at] + broken + data[at + 80 :])
    if key in ("BLANK", "BITPIX"):  # without these nothing says what the numbers are
        with pytest.raises(UserError, match="not a readable FITS file"):
            frames(tmp_path)
        return
    (found,) = frames(tmp_path)
    assert np.array_equal(found.frame.pixels, SKY.astype(np.int16))
    (note,) = [note.text for note in found.notes if note.kind == "header"]
    assert note.endswith(f": {key}")
    assert (found.frame.header.exposure_ns == 0) == (key == "EXPTIME")


def test_negative_large_and_missing_values_become_float_with_nan(tmp_path: Path) -> None:
    fits.PrimaryHDU((SKY - 1000).astype(np.int16)).writeto(tmp_path / "a.fits")
    fits.PrimaryHDU((SKY * 1000).astype(np.int32)).writeto(tmp_path / "b.fits")
    holes = SKY.astype(np.float32)
    holes[3, 4], holes[5, 6] = np.nan, np.inf
    fits.PrimaryHDU(holes).writeto(tmp_path / "c.fits")
    negative, large, missing = (found.frame.pixels for found in frames(tmp_path))
    assert negative.dtype == large.dtype == missing.dtype == np.float32
    assert negative.min() < 0
    assert large.max() > 65535
    assert np.isnan(missing[3, 4])
    assert np.isnan(missing[5, 6])
    assert np.isnan(missing).sum() == 2


def test_tile_compressed_and_many_hdus_come_in_order_of_names(tmp_path: Path) -> None:
    image = SKY.astype(np.int16)
    table = fits.BinTableHDU(np.array([(1,)], dtype=[("x", "i4")]))
    cube = fits.ImageHDU(np.zeros((3, 20, 20), np.int16))
    compressed = fits.CompImageHDU(image, compression_type="RICE_1")
    fits.HDUList([fits.PrimaryHDU(), table, compressed, cube, fits.ImageHDU(image + 1)]).writeto(tmp_path / "b.fits.fz")
    fits.PrimaryHDU(image + 2).writeto(tmp_path / "a.FITS")
    (tmp_path / "notes.txt").write_text("no image")
    found = frames(tmp_path)
    assert [(f.file, f.hdu, f.frame.header.frame) for f in found] == [("a.FITS", 0, 0), ("b.fits.fz", 2, 1), ("b.fits.fz", 4, 2)]
    assert [int(f.frame.pixels[0, 0]) - int(image[0, 0]) for f in found] == [2, 0, 1]


def test_headers_are_read_where_present(tmp_path: Path) -> None:
    hdu = fits.PrimaryHDU(SKY.astype(np.uint16))
    hdu.header.update({"DATE-OBS": "2024-03-01T02:03:04.5", "EXPTIME": 30.0, "GAIN": 1.6, "RDNOISE": 4.1, "SATURATE": 60000})
    hdu.header.update(
        {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 10.0, "CRVAL2": 20.0, "CRPIX1": 36.0, "CRPIX2": 33.0}
    )
    hdu.header.update({"CD1_1": -1e-3, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-3})
    hdu.writeto(tmp_path / "a.fits")
    (found,) = frames(tmp_path)
    header = found.frame.header
    assert (header.exposure_ns, header.gain_e_adu, header.read_noise_e, header.saturation_adu) == (30 * 10**9, 1.6, 4.1, 60000.0)
    # TAI - UTC has been 37 s since 2017.
    assert header.t_start_tai_ns == from_jd_parts(2460370.5, (2 * 3600 + 3 * 60 + 4.5 + 37) / 86400)
    assert found.wcs is not None
    assert found.notes == ()
    assert camera_of_frame(found, None).focal_px == pytest.approx(np.degrees(1) / 1e-3, rel=1e-6)
    (bare,) = FitsFolder(path=tmp_path, use_wcs=False).frames()
    assert bare.wcs is None


@pytest.mark.parametrize(
    ("keys", "scales_arcsec"),
    [
        ({"PIXSCALE": 2.5}, [2.5]),
        ({"SECPIX1": 0.6, "PIXSCALE": "coarse"}, [0.6]),
        ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0}, [1.8564]),
        ({"FOCALLEN": 1000.0, "PIXSIZE1": 9.0, "XBINNING": 2}, [1.8564, 3.7128]),
        ({"PIXSCALE": 1.85, "FOCALLEN": 1000.0, "XPIXSZ": 9.0}, [1.85]),
        ({"CDELT1": -1e-3}, [3.6]),
        ({"CDELT1": 1.0, "PIXSCALE": -3.0, "FOCALLEN": 0.0, "XPIXSZ": 9.0}, []),
    ],
)
def test_the_pixel_scale_is_read_in_many_forms(tmp_path: Path, keys: dict[str, object], scales_arcsec: list[float]) -> None:
    hdu = fits.PrimaryHDU(SKY.astype(np.uint16))
    hdu.header.update(keys)
    hdu.writeto(tmp_path / "a.fits")
    (found,) = frames(tmp_path)
    assert np.degrees(1.0 / np.array(found.focal_hints_px)) * 3600.0 == pytest.approx(scales_arcsec, rel=1e-3)


def test_without_headers_all_is_assumed_and_said(tmp_path: Path) -> None:
    fits.PrimaryHDU(SKY.astype(np.uint16)).writeto(tmp_path / "a.fits")
    (found,) = frames(tmp_path)
    assert found.frame.header.t_start_tai_ns == FIRST_ASSUMED_TAI_NS
    assert found.frame.header.gain_e_adu is None
    assert found.frame.header.exposure_ns == 0
    assert [note.text.partition(":")[0] for note in found.notes] == ["no DATE-OBS", "no EXPTIME", "no GAIN"]


@pytest.mark.parametrize("key", ["GAIN", "EXPTIME", "RDNOISE"])
@pytest.mark.parametrize("value", ["high", -3.0, 1e30, True])
def test_nonsense_in_a_header_counts_as_absent(tmp_path: Path, key: str, value: object) -> None:
    hdu = fits.PrimaryHDU(SKY.astype(np.uint16))
    hdu.header[key] = value
    hdu.writeto(tmp_path / "a.fits")
    (found,) = frames(tmp_path)
    assert found.frame.header.gain_e_adu is None
    assert found.frame.header.read_noise_e is None
    assert found.frame.header.exposure_ns == 0
    # What is there and no use is not said to be missing.
    (note,) = (note for note in found.notes if note.kind == key)
    assert note.text.startswith(f"{key} = {str(value)!r} is no number from ")


def test_packed_files_of_a_folder_are_frames_whatever_their_letters(tmp_path: Path) -> None:
    """a.fit.gz, b.fits.xz and c.fits.bz2 were passed over without a word, and read when they were given alone."""
    whole = tmp_path / "whole.FIT"
    fits.PrimaryHDU(np.arange(400, dtype=np.int16).reshape(20, 20)).writeto(whole)
    for name, pack in (("a.fit.gz", gzip.compress), ("b.FITS.XZ", lzma.compress), ("c.fts.bz2", bz2.compress)):
        (tmp_path / name).write_bytes(pack(whole.read_bytes()))
    (tmp_path / "d.fits.bz2").write_bytes(b"no such thing")
    source = FitsFolder(path=tmp_path)
    assert [sourced.file for sourced in source.frames()] == ["a.fit.gz", "b.FITS.XZ", "c.fts.bz2", "whole.FIT"]
    (left_out,) = source.left_out
    assert "d.fits.bz2: not a readable FITS file" in left_out


def test_what_cannot_be_used_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such folder"):
        frames(tmp_path / "none")
    with pytest.raises(UserError, match="holds no FITS file"):
        frames(tmp_path)
    (tmp_path / "text.fits").write_text("hello")
    with pytest.raises(UserError, match=r"not a readable FITS file: it does not begin as one. Save the pixels"):
        frames(tmp_path)
    fits.PrimaryHDU().writeto(tmp_path / "text.fits", overwrite=True)
    with pytest.raises(UserError, match="no file holds a two-dimensional image"):
        frames(tmp_path)
    fits.PrimaryHDU(np.zeros((4, 400), np.int16)).writeto(tmp_path / "text.fits", overwrite=True)
    with pytest.raises(UserError, match="image of 4 x 400; allowed are sides of 16 to 16384 px"):
        frames(tmp_path)
    fits.PrimaryHDU(SKY.astype(np.uint16)).writeto(tmp_path / "text.fits", overwrite=True)
    (tmp_path / "text.fits").write_bytes((tmp_path / "text.fits").read_bytes()[:4000])
    with pytest.raises(UserError, match=r"cannot be read|not a readable FITS file"):
        frames(tmp_path)


@pytest.mark.parametrize(("sigma_px", "error"), [(0.8, 0.35), (1.2, 0.15), (2.5, 0.15)])
def test_the_width_of_stars_is_estimated(sigma_px: float, error: float) -> None:
    rng = np.random.default_rng(8)
    rows, cols = np.mgrid[:300, :300]
    image = rng.normal(100.0, 3.0, rows.shape)
    for row, col in zip(np.repeat(np.arange(20, 300, 40), 7), np.tile(np.arange(20, 300, 40), 7), strict=True):
        r, c, flux = row + rng.uniform(), col + rng.uniform(), rng.uniform(4e3, 2e4)
        image += flux / (2 * np.pi * sigma_px**2) * np.exp(-0.5 * ((rows - r) ** 2 + (cols - c) ** 2) / sigma_px**2)
    found = star_sigma_px(image.astype(np.float32))
    assert found is not None
    assert abs(found / sigma_px - 1.0) < error
    assert star_sigma_px(rng.normal(100.0, 3.0, (200, 200)).astype(np.float32)) is None


@pytest.mark.parametrize("n_hot", [30, 300, 3000])
def test_hot_pixels_are_no_stars(n_hot: int) -> None:
    """Raw frames of uncooled cameras have more of them than stars; their neighbours' noise made 0.7 px of stars of 1.8 px."""
    rng = np.random.default_rng(10)
    rows, cols = np.mgrid[-9:10, -9:10]
    image = rng.normal(100.0, 3.0, (420, 420))
    for row in range(20, 400, 40):
        for col in range(20, 400, 40):
            r, c = rng.uniform(-0.5, 0.5, 2)
            star = rng.uniform(100.0, 600.0) * np.exp(-0.5 * ((rows - r) ** 2 + (cols - c) ** 2) / 1.8**2)
            image[row - 9 : row + 10, col - 9 : col + 10] += star
    alone = star_sigma_px(image.astype(np.float32))
    assert alone == pytest.approx(1.8, rel=0.2)
    image[rng.integers(0, 420, n_hot), rng.integers(0, 420, n_hot)] += rng.uniform(100.0, 400.0, n_hot)
    assert star_sigma_px(image.astype(np.float32)) == pytest.approx(alone, rel=0.1)


def test_stars_as_sharp_as_a_pixel_stay_stars() -> None:
    """Undersampled optics of 0.35 px: four in ten count as single pixels, and none is resolved."""
    rng = np.random.default_rng(11)
    image = rng.normal(100.0, 3.0, (420, 420))
    edges = np.arange(-4, 6) - 0.5
    for row in range(20, 400, 20):
        for col in range(20, 400, 20):
            by = [np.diff(ndtr((edges - at) / 0.35)) for at in rng.uniform(-0.5, 0.5, 2)]
            image[row - 4 : row + 5, col - 4 : col + 5] += rng.uniform(500.0, 3000.0) * np.outer(*by)
    found = star_sigma_px(image.astype(np.float32))
    assert found is not None
    assert found < 0.9


def test_the_width_of_stars_in_a_large_frame_comes_from_a_sample_where_it_holds_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(9)
    image = rng.normal(100.0, 3.0, (640, 640)).astype(np.float32)
    rows, cols = np.mgrid[-6:7, -6:7]
    for row in range(16, 630, 16):
        for col in range(16, 630, 16):
            r, c = rng.uniform(-0.5, 0.5, 2)
            sigma_px = rng.uniform(1.2, 1.8)
            star = rng.uniform(200.0, 900.0) * np.exp(-0.5 * ((rows - r) ** 2 + (cols - c) ** 2) / sigma_px**2)
            image[row - 6 : row + 7, col - 6 : col + 7] += star
    whole = star_sigma_px(image)
    monkeypatch.setattr(star_width, "SAMPLED_PX", image.size)
    monkeypatch.setattr(star_width, "SQUARE_PX", 96)
    monkeypatch.setattr(star_width, "ENOUGH_STARS", 200)
    sampled = star_sigma_px(image)
    assert whole is not None
    assert sampled is not None
    assert sampled != whole
    assert sampled == pytest.approx(whole, rel=0.03)
    monkeypatch.setattr(star_width, "ENOUGH_STARS", 2000)
    assert star_sigma_px(image) == whole
    image[200:, 200:] = np.nan  # squares without a value
    assert star_sigma_px(image) == pytest.approx(whole, rel=0.05)


def test_a_large_frame_that_cannot_be_read_beside_is_refused_as_any_other(tmp_path: Path) -> None:
    fits.PrimaryHDU(np.zeros((1100, 1000), np.int16)).writeto(tmp_path / "a.fits")
    (tmp_path / "a.fits").write_bytes((tmp_path / "a.fits").read_bytes()[:900_000])
    with pytest.raises(UserError, match=r"cannot be read|not a readable FITS file"):
        FirstFrame.of(FitsFolder(path=tmp_path)).wait()
