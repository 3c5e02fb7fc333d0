"""`sboc camera make`: what it measures of cameras whose numbers are known, and that `--camera` takes its file."""

import errno
import lzma
import math
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.files import atomic, calibration_files
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Frame, FrameHeader
from sboc_e2e.outside.camera import camera_of_table
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.guessed_camera import camera_of_frame
from sboc_e2e.outside.make_camera import made_camera, nominal, photon_transfer, saturation_of
from sboc_e2e.outside.overscan import without_sky

GAIN_E_ADU, NOISE_E, BIAS_ADU, SIGMA_PX, FULL_ADU = 1.6, 9.0, 300.0, 1.4, 20000.0


def frame(seed: int, *, overscan: bool = True, level_e: float = 900.0) -> np.ndarray:
    """A vignetted sky with stars on a gradient of the response, an overscan of 24 columns, in whole ADU."""
    rng, stars = np.random.default_rng(seed), np.random.default_rng(99)
    rows, cols = 320, 384
    row, col = np.mgrid[:rows, :cols].astype(float)
    light = level_e * (1.0 - 0.7 * ((row - 160) ** 2 + (col - 192) ** 2) / (160**2 + 192**2))
    for _ in range(60):
        r, c, flux = stars.uniform(10, rows - 10), stars.uniform(10, cols - 34), 10 ** stars.uniform(3.3, 5.9)
        spot = np.s_[int(r) - 9 : int(r) + 10, max(int(c) - 9, 0) : int(c) + 10]
        light[spot] += (
            flux * np.exp(-0.5 * ((row[spot] - r) ** 2 + (col[spot] - c) ** 2) / SIGMA_PX**2) / (2 * np.pi * SIGMA_PX**2)
        )
    if overscan:
        light[:, -24:] = 0.0
    electrons = rng.poisson(light) + rng.normal(0.0, NOISE_E, light.shape)
    return np.clip(np.round(electrons / GAIN_E_ADU + BIAS_ADU), 0, FULL_ADU).astype(np.uint16)


def written(folder: Path, images: list[np.ndarray]) -> list[Path]:
    paths = []
    for number, image in enumerate(images):
        paths.append(folder / f"frame{number}.fits")
        fits.PrimaryHDU(image).writeto(paths[-1])
    return paths


@pytest.mark.parametrize("kind", ["a folder", "below a file", "in a folder of others"])
def test_a_place_that_cannot_be_written_is_named_before_the_work(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The frames are not even looked for."""
    if kind == "a folder":
        out = tmp_path
    elif kind == "below a file":
        (tmp_path / "notes").write_text("mine")
        out = tmp_path / "notes" / "camera.toml"
    else:
        out = tmp_path / "theirs" / "camera.toml"

        def refused(folder: Path) -> None:
            raise PermissionError(errno.EACCES, "Permission denied", str(folder))

        monkeypatch.setattr(atomic, "require_writable", refused)
    assert cli.run(["camera", "make", str(tmp_path / "missing.fits"), "--out", str(out)]) == 2
    told = capsys.readouterr().err
    assert str(out if kind == "a folder" else out.parent) in told
    assert "missing.fits" not in told
    assert told.count("\n") == 1


def test_a_known_camera_is_measured(tmp_path: Path) -> None:
    """Gain to 4 %, read noise to 15 %, all within four of their errors; PSF to 5 %."""
    made = made_camera(written(tmp_path, [frame(k) for k in range(4)]))
    assert made.transfer is not None
    assert abs(made.transfer.gain_e_adu / GAIN_E_ADU - 1.0) < 0.04
    assert abs(made.transfer.gain_e_adu - GAIN_E_ADU) < 4.0 * made.transfer.gain_err
    assert abs(made.transfer.bias_adu - BIAS_ADU) < 1.0
    assert abs(made.transfer.read_noise_e / NOISE_E - 1.0) < 0.15
    assert abs(made.transfer.read_noise_e - NOISE_E) < 4.0 * made.transfer.read_noise_err
    assert made.psf_sigma_px is not None
    assert abs(made.psf_sigma_px / SIGMA_PX - 1.0) < 0.05
    assert made.saturation_adu == FULL_ADU


def test_errors_of_gain_and_noise_are_those_that_repeat() -> None:
    """Pulls over 24 pairs of starless frames."""
    pulls = []
    for seed in range(24):
        rng = np.random.default_rng(1000 + seed)
        light = np.linspace(200.0, 2000.0, 256)[:, None] * np.ones((256, 256))
        pair = [np.round((rng.poisson(light) + rng.normal(0.0, NOISE_E, light.shape)) / GAIN_E_ADU + BIAS_ADU) for _ in range(2)]
        found = photon_transfer([p.astype(np.float32) for p in pair], BIAS_ADU)
        assert found is not None
        pulls.append(((found.gain_e_adu - GAIN_E_ADU) / found.gain_err, (found.read_noise_e - NOISE_E) / found.read_noise_err))
    spread = np.sqrt(np.nanmean(np.square(pulls), axis=0))
    assert 0.6 < spread[0] < 1.5
    assert 0.5 < spread[1] < 1.6


def test_a_gain_that_frames_do_not_tell_is_what_process_takes_without_a_camera(tmp_path: Path) -> None:
    """1 e-/ADU and no read noise were written for an unknown gain, and taken as measured: fluxes 2.5 times too small."""
    rng = np.random.default_rng(3)
    path = tmp_path / "a.fits"
    for header in (fits.Header(), fits.Header({"GAIN": 1.7, "RDNOISE": 6.0})):
        fits.PrimaryHDU(rng.normal(100.0, 2.0, (64, 80)).astype(np.float32), header).writeto(path, overwrite=True)
        made = made_camera([path])
        guess = camera_of_frame(next(iter(FitsFolder(path=path).frames())), None)
        camera = nominal(made)
        assert made.transfer is None
        assert (camera.gain_e_adu, camera.read_noise_e) == (guess.gain_e_adu, guess.read_noise_e)
        assert camera.gain_e_adu == (1.7 if header else pytest.approx(2.5, rel=0.1))
        gain = next(line for line in made.words() if line.startswith("gain: "))
        assert f"{camera.gain_e_adu:.4g} e-/ADU is taken, from the first header or its noise" in gain


def test_one_frame_tells_no_gain_and_a_flat_pair_neither() -> None:
    flat = [np.random.default_rng(k).normal(100.0, 5.0, (128, 128)).astype(np.float32) for k in range(2)]
    assert photon_transfer(flat[:1], 0.0) is None
    assert photon_transfer(flat, 0.0) is None
    assert saturation_of(flat) is None


def test_the_file_is_a_camera_for_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = written(tmp_path, [frame(k) for k in range(2)])
    file = tmp_path / "my_camera.toml"
    assert cli.run(["camera", "make", *map(str, paths), "--out", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "gain: 1." in printed
    assert cli.run(["process", str(paths[0]), "--out", str(tmp_path / "out"), "--camera", str(file)]) == 0
    table = Table.read(tmp_path / "out" / "products" / "frames.ecsv", format="ascii.ecsv")
    assert len(table) == 1


def test_the_camera_file_names_the_images_that_were_used_and_counts_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four files of three images each, said to be of one camera: eight images are taken, of the first three files."""
    images = [np.random.default_rng(k).normal(100.0, 5.0, (96, 96)).astype(np.float32) for k in range(3)]
    paths = [tmp_path / f"{name}.fits" for name in "abcd"]
    for path in paths:
        fits.HDUList([fits.PrimaryHDU(images[0]), *map(fits.ImageHDU, images[1:])]).writeto(path)
    made = made_camera(paths, hdus=(0, 1, 2))
    assert made.sources == tuple((f"{file}.fits", hdu) for file in "abc" for hdu in range(3))[:8]
    assert made.n_left_out == 4
    hdus = [word for hdu in "012" for word in ("--hdu", hdu)]
    assert cli.run(["camera", "make", *map(str, paths), *hdus, "--out", str(tmp_path / "camera.toml")]) == 0
    words = "images: the first 8 of 12 were used, 4 left out"
    assert words in capsys.readouterr().out.splitlines()
    text = (tmp_path / "camera.toml").read_text()
    assert text.startswith("# Made by `sboc camera make` of a.fits, a.fits (HDU 1), a.fits (HDU 2), b.fits, ")
    assert "c.fits (HDU 1).\n" in text
    assert "d.fits" not in text
    assert f"# {words}\n" in text
    two = made_camera(paths[:2], hdus=(0, 1, 2))
    assert two.n_left_out == 0
    assert not any("left out" in line for line in two.words())


def chip(seed: int, gain_e_adu: float, bias_adu: float) -> np.ndarray:
    """Light of 200 to 2,000 e- on a detector of known gain and bias, in whole ADU."""
    light = np.linspace(200.0, 2000.0, 256)[:, None] * np.ones((256, 256))
    return np.round(np.random.default_rng(seed).poisson(light) / gain_e_adu + bias_adu).astype(np.uint16)


def test_chips_of_a_file_are_measured_one_by_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Gains of 1 and 4 e-/ADU: each within 4 % by its HDU, and both together are refused; paired they gave 1.25."""
    paths = [tmp_path / f"{k}.fits" for k in range(2)]
    for k, path in enumerate(paths):
        chips = [fits.ImageHDU(chip(2 * k, 1.0, 1000.0), name="CHIP1"), fits.ImageHDU(chip(2 * k + 1, 4.0, 500.0), name="CHIP2")]
        fits.HDUList([fits.PrimaryHDU(), *chips]).writeto(path)
    for hdu, gain in ((1, 1.0), (2, 4.0)):
        made = made_camera(paths, hdus=(hdu,))
        assert made.transfer is not None
        assert abs(made.transfer.gain_e_adu / gain - 1.0) < 0.04
        assert made.sources == (("0.fits", hdu), ("1.fits", hdu))
    assert cli.run(["camera", "make", *map(str, paths), "--out", str(tmp_path / "camera.toml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "got 2 by their headers (0.fits (HDU 1): CHIP1 HDU 1, 0.fits (HDU 2): CHIP2 HDU 2); --hdu N takes one" in line
    assert not (tmp_path / "camera.toml").exists()
    with pytest.raises(UserError, match=r"0\.fits: --hdu 3: no picture is in this HDU; there are pictures in 1, 2"):
        made_camera(paths, hdus=(3,))


@pytest.mark.parametrize("hdus", [(), (0,)])
def test_two_cameras_are_named_and_refused(tmp_path: Path, hdus: tuple[int, ...]) -> None:
    paths = [tmp_path / f"{name}.fits" for name in "ab"]
    for name, gain, path in zip("AB", (1.0, 4.0), paths, strict=True):
        fits.PrimaryHDU(chip(5, gain, 500.0), fits.Header({"INSTRUME": name})).writeto(path)
    with pytest.raises(UserError, match=r"got 2 by their headers \(a.fits \(HDU 0\): A HDU 0, b.fits \(HDU 0\): B HDU 0\)"):
        made_camera(paths, hdus=hdus)


@pytest.mark.parametrize("scale", [1e-8, 1e-20])
def test_a_camera_of_tiny_numbers_is_that_of_the_same_frames_in_counts(
    tmp_path: Path, scale: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its lines are in the numbers of the files, and `--camera` takes its gain for pixels that are multiplied as it says."""
    counts = written(tmp_path, [frame(k) for k in range(2)])
    paths = []
    for path in counts:
        paths.append(tmp_path / f"tiny_{path.name}")
        fits.PrimaryHDU(fits.getdata(path) * scale).writeto(paths[-1])
    plain, tiny = made_camera(counts), made_camera(paths)
    assert plain.transfer is not None
    assert tiny.transfer is not None
    assert tiny.unit > 1.0 == plain.unit
    assert tiny.transfer.gain_e_adu * tiny.unit * scale == pytest.approx(plain.transfer.gain_e_adu, rel=1e-4)
    assert tiny.transfer.bias_adu == pytest.approx(plain.transfer.bias_adu * scale * tiny.unit, rel=1e-4)
    assert tiny.transfer.read_noise_e == pytest.approx(plain.transfer.read_noise_e, rel=1e-3)
    given = made_camera(paths, bias_adu=BIAS_ADU * scale)
    assert given.transfer is not None
    assert abs(given.transfer.read_noise_e - NOISE_E) < 4.0 * given.transfer.read_noise_err
    line = next(line for line in tiny.words() if line.startswith("gain: "))
    assert float(line.split()[1]) == pytest.approx(plain.transfer.gain_e_adu / scale, rel=1e-3)
    bias = next(line for line in tiny.words() if line.startswith("read noise")).partition("(bias ")[2].split()[0]
    assert float(bias) == pytest.approx(plain.transfer.bias_adu * scale, rel=1e-3)

    file, out = tmp_path / "tiny.toml", tmp_path / "out"
    assert cli.run(["camera", "make", *map(str, paths), "--out", str(file)]) == 0
    assert f"these numbers times {tiny.unit:g}" in file.read_text()
    assert cli.run(["process", str(paths[0]), "--out", str(out), "--camera", str(file)]) == 0
    assert f"multiplied by {tiny.unit:.0e}" in "".join(Table.read(out / "products" / "frames.ecsv", format="ascii.ecsv")["notes"])
    capsys.readouterr()


def test_a_camera_fits_frames_in_another_unit() -> None:
    """Noise on both sides of the border of a thousandth: one electron stays one electron, and what is full stays full."""
    table = {"name": "made", "rows": 64, "cols": 64, "focal_px": 1e5, "center_row": 31.5, "center_col": 31.5, "psf_sigma_px": 1.2,
             "gain_e_adu": 5e-3, "read_noise_e": 3.0, "saturation_adu": 4e6, "full_well_e": 2e4, "aperture_m": 1.0}  # fmt: skip
    pixels = np.zeros((64, 64), dtype=np.float32)
    one = Frame(header=FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=0, line_time_ns=0, rows=64, cols=64), pixels=pixels)
    camera = camera_of_table(table | {"pixels_times": 1e6}, "a.toml")
    assert camera.for_frame(one, 1e6) == camera.nominal
    other = camera.for_frame(one, 1.0)
    assert (other.gain_e_adu, other.saturation_adu) == (pytest.approx(5e3), pytest.approx(4.0))
    assert (other.read_noise_e, other.full_well_e) == (3.0, 2e4)
    with pytest.raises(UserError, match=r"made of pixels times 1e\+06, and these frames are pixels times 1e\+18, .*gain_e_adu"):
        camera.for_frame(one, 1e18)
    by_hand = camera_of_table(table, "a.toml")
    assert by_hand.for_frame(one, 1e6) == by_hand.nominal
    with pytest.raises(UserError, match=r"a.toml: camera.pixels_times: expected a number above 0, got '1e6'"):
        camera_of_table(table | {"pixels_times": "1e6"}, "a.toml")


def test_process_converts_a_camera_for_frames_in_another_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Noise of 0.8 and 1.3 thousandths: only the first frames are multiplied, by a million."""
    paths, file = [], tmp_path / "camera.toml"
    for name, scale in (("a", 5e-5), ("b", 5e-5), ("c", 8e-5)):
        paths.append(tmp_path / f"{name}.fits")
        fits.PrimaryHDU(frame(len(paths)) * scale).writeto(paths[-1])
    assert cli.run(["camera", "make", *map(str, paths[:2]), "--out", str(file)]) == 0
    assert "(bias 0.015 ADU)" in capsys.readouterr().out
    assert "pixels_times = 1000000.0" in file.read_text()
    cameras = []
    for path in paths[1:]:
        out = tmp_path / path.stem
        assert cli.run(["process", str(path), "--out", str(out), "--camera", str(file)]) == 0
        cameras.append(calibration_files.read_camera(out / "calibration"))
    assert cameras[1].gain_e_adu == pytest.approx(1e6 * cameras[0].gain_e_adu)
    assert cameras[1].saturation_adu == pytest.approx(1e-6 * cameras[0].saturation_adu) == pytest.approx(1.0)


def test_a_bias_that_leaves_no_noise_is_not_asked_for_again(tmp_path: Path) -> None:
    """200 ADU below the true bias the line of photon transfer is below zero: (9 / 1.6)^2 - 200 / 1.6 ADU^2."""
    paths = written(tmp_path, [frame(k, overscan=False) for k in range(2)])
    for bias_adu, words in ((None, "needs the bias"), (BIAS_ADU - 200.0, "no noise is left at the level of the bias 100.0 ADU")):
        made = made_camera(paths, bias_adu=bias_adu)
        assert made.transfer is not None
        assert math.isnan(made.transfer.read_noise_e)
        assert f"read noise: unknown: {words}" in "\n".join(made.words())
    assert "read noise: unknown, as the gain is" in made_camera(paths[:1], bias_adu=BIAS_ADU).words()


def test_a_file_with_a_strange_key_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (path,) = written(tmp_path, [frame(0)])
    file = tmp_path / "odd.toml"
    file.write_text("[camera]\nrowz = 3\n")
    assert cli.run(["process", str(path), "--out", str(tmp_path / "out"), "--camera", str(file)]) == 2
    assert "camera.rowz is no key of a camera" in capsys.readouterr().err
    file.write_text('[camera]\nrows = "many"\n')
    assert cli.run(["process", str(path), "--out", str(tmp_path / "out"), "--camera", str(file)]) == 2
    assert cli.run(["camera", "make", str(tmp_path / "none.fits"), "--out", str(file)]) == 2


def test_borders_without_sky_are_found_and_nothing_else() -> None:
    """Overscan darker or brighter than the sky; no sky of few photons, no gradient, no bad column beside the border."""
    image = frame(1)
    assert without_sky(image) == (slice(0, 320), slice(0, 359))
    assert without_sky(image.T) == (slice(0, 359), slice(0, 320))
    assert without_sky(frame(1, overscan=False)) is None
    bad_column = frame(2, overscan=False)
    bad_column[:, 20] += 3000
    assert without_sky(bad_column) is None
    rng = np.random.default_rng(4)
    for mean in (0.1, 1.0, 30.0):
        assert without_sky(rng.poisson(mean, (64, 96))) is None
    assert without_sky(np.zeros((40, 40))) is None
    assert without_sky(np.full((40, 40), math.nan)) is None


def test_a_border_behind_columns_without_data_saw_no_sky_where_it_is_darker_and_quieter_than_the_sky() -> None:
    """A subframe with an overscan under interference, as of NEOSSat; two chips of a mosaic with levels of their own are sky."""
    rng = np.random.default_rng(6)
    image = rng.normal(2600.0, 130.0, (200, 400))
    image[:, :40] = rng.normal(1650.0, 10.0, (200, 40)) + 15.0 * np.sin(np.add.outer(np.arange(200), 2 * np.arange(40)) / 4.0)
    image[:, 40:150] = math.nan
    assert without_sky(image) == (slice(0, 200), slice(150, 400))
    assert without_sky(image[:, ::-1].T) == (slice(0, 250), slice(0, 200))
    image[:, :40] = rng.normal(1650.0, 130.0, (200, 40))
    assert without_sky(image) is None
    image[:, 150:] = math.nan
    assert without_sky(image) is None


def test_a_trail_across_the_border_columns_is_no_border() -> None:
    rng = np.random.default_rng(5)
    image = rng.normal(100.0, 5.0, (200, 200))
    image[np.arange(200), np.arange(200)] += 1e4
    image[:, 3] = 100.0 + np.arange(200)
    assert without_sky(image) is None


def test_a_real_pair_tells_one_gain_in_both_halves(shared_data: Path, tmp_path: Path) -> None:
    """Two raw frames of an SBIG STL-1001 (header INSTRUME): gain of a few e-/ADU to 5 %, stable over the halves of the frame."""
    paths = []
    for name in ("wallace_219.fits", "wallace_222.fits"):
        source = shared_data / "real2" / f"{name}.xz"
        if not source.exists():
            pytest.skip(f"real frame not present: {source}")
        paths.append(tmp_path / name)
        paths[-1].write_bytes(lzma.decompress(source.read_bytes()))
    images = [fits.getdata(path).astype(np.float32) for path in paths]
    parts = (np.s_[:], np.s_[512:], np.s_[:512])
    whole, upper, lower = (photon_transfer([image[part] for image in images], None) for part in parts)
    assert whole is not None
    assert upper is not None
    assert lower is not None
    assert whole.gain_err < 0.05 * whole.gain_e_adu
    assert abs(upper.gain_e_adu - lower.gain_e_adu) < 4.0 * np.hypot(upper.gain_err, lower.gain_err)
    assert math.isnan(whole.read_noise_e)


@pytest.mark.parametrize(
    ("option", "value"),
    [("width", "nan"), ("width", "0"), ("width", "180"), ("bias", "nan"), ("bias", "inf"), ("bias", "-1e30")],
)
def test_a_number_that_no_camera_has_is_refused_by_name(
    option: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "camera.toml"
    assert cli.run(["camera", "make", str(tmp_path / "none.fits"), "--out", str(out), f"--{option}={value}"]) == 2
    assert f"sboc: --{option}: expected " in capsys.readouterr().err
    assert not out.exists()
