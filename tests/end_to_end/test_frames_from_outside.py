"""`sboc process` on frames of odd kinds: sizes, compression, floats, several HDUs, and where directions come from."""

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.scenario.toml_files import FOLDER as SCENARIOS
from sboc_e2e.scenario.toml_files import preset_path

SIGMA_PX = 1.2


def image_of(rows: int, cols: int) -> np.ndarray:
    """Sky, a dozen stars, and one bright trail through the middle of the frame, in whose line no star stands."""
    rng = np.random.default_rng(rows * cols)
    grid = np.mgrid[:rows, :cols].astype(float)
    image = np.full((rows, cols), 300.0)
    along = np.array([0.2 * rows, 0.4 * cols]) / np.hypot(0.2 * rows, 0.4 * cols)
    spots: list[tuple[float, float, float]] = []
    while len(spots) < 12:
        row, col = rng.uniform(0.1, 0.9, 2) * (rows, cols)
        if abs((row - 0.5 * rows) * along[1] - (col - 0.5 * cols) * along[0]) > 8.0:
            spots.append((row, col, 4000.0))
    spots += [(rows * (0.40 + 0.2 * p), cols * (0.3 + 0.4 * p), 300.0) for p in np.linspace(0.0, 1.0, rows)]
    for row, col, flux in spots:
        image += flux / (2 * np.pi * SIGMA_PX**2) * np.exp(-0.5 * ((grid[0] - row) ** 2 + (grid[1] - col) ** 2) / SIGMA_PX**2)
    return rng.normal(image, 4.0)


def processed(source: Path, out: Path, *extra: str) -> tuple[Table, Table]:
    assert cli.run(["process", str(source), "--out", str(out), *extra]) == 0
    frames, streaks = (Table.read(out / "products" / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "streaks"))
    return frames, streaks


def near_the_trail(streaks: Table, frame: int, rows: int, cols: int) -> bool:
    """Whether a streak of the frame has both ends within 3 px of the true ones."""
    true = np.array([0.4 * rows, 0.3 * cols, 0.6 * rows, 0.7 * cols])
    mine = streaks[np.asarray(streaks["frame"]) == frame]
    found = np.array([mine[name] for name in ("row0", "col0", "row1", "col1")], dtype=float).T
    return bool(len(found)) and float(np.abs(found - true).max(axis=1).min()) < 3.0


@pytest.mark.parametrize("shape", [(64, 64), (65, 97), (130, 71)])
def test_frames_of_any_size_and_kind_are_taken(tmp_path: Path, shape: tuple[int, int]) -> None:
    image = image_of(*shape)
    # the others are mirrored: what stays at its place from frame to frame is no mover, in the first frame neither
    mirrored = np.rint(image[::-1])
    tiles = fits.CompImageHDU(np.rint(image).astype(np.int16), compression_type="RICE_1", tile_shape=(16, shape[1]))
    several = [fits.PrimaryHDU(), tiles, fits.ImageHDU(mirrored.astype(np.float32)), fits.ImageHDU(mirrored.astype(np.uint16))]
    fits.HDUList(several).writeto(tmp_path / "odd.fits.fz")
    frames, streaks = processed(tmp_path / "odd.fits.fz", tmp_path / "out", "--wcs", "none")
    assert list(frames["hdu"]) == [1, 2, 3]
    assert [(int(rows), int(cols)) for rows, cols in zip(frames["rows"], frames["cols"], strict=True)] == [shape] * 3
    assert near_the_trail(streaks, 0, *shape), streaks
    assert not np.asarray(frames["solved"]).any()
    for name in ("ra_mid_deg", "mag"):
        assert not np.isfinite(np.asarray(streaks[name], dtype=float)).any()


def test_directions_come_from_the_header_and_a_camera_from_a_file(tmp_path: Path) -> None:
    hdu = fits.PrimaryHDU(np.rint(image_of(96, 96)).astype(np.uint16))
    hdu.header.update({"DATE-OBS": "2027-01-29T00:00:00", "EXPTIME": 0.2, "GAIN": 1.5, "RDNOISE": 3.0})
    hdu.header.update(
        {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 10.0, "CRVAL2": 20.0, "CRPIX1": 48.5, "CRPIX2": 48.5}
    )
    hdu.header.update({"CD1_1": -2e-3, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 2e-3})
    hdu.writeto(tmp_path / "sky.fits")
    camera = tmp_path / "camera.toml"
    camera.write_text(preset_path("smoke_wide", "instrument", SCENARIOS, "test").read_text())
    _, streaks = processed(tmp_path / "sky.fits", tmp_path / "header", "--wcs", "header", "--camera", str(camera))
    assert near_the_trail(streaks, 0, 96, 96)
    # The trail's middle is (47.5, 47.5), the pixel of CRVAL by FITS's count from one.
    best = streaks[np.argmax(streaks["snr"])]
    assert abs(best["ra_mid_deg"] - 10.0) < 2e-3 * 2
    assert abs(best["dec_mid_deg"] - 20.0) < 2e-3 * 2
    _, bare = processed(tmp_path / "sky.fits", tmp_path / "none", "--wcs", "none", "--camera", str(camera))
    assert not np.isfinite(bare["ra_mid_deg"]).any()


def test_a_camera_file_that_is_none_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fits.PrimaryHDU(np.rint(image_of(64, 64)).astype(np.uint16)).writeto(tmp_path / "a.fits")
    (tmp_path / "bad.toml").write_text("[instrument]\nrowz = 3\n")
    for camera, words in ((tmp_path / "bad.toml", 'unknown key "rowz"'), (tmp_path / "none.toml", "cannot be read")):
        capsys.readouterr()
        assert cli.run(["process", str(tmp_path / "a.fits"), "--out", str(tmp_path / "out"), "--camera", str(camera)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert words in line
        assert not (tmp_path / "out").exists()


def test_a_page_says_what_was_found_and_what_is_lacking(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pixels = np.rint(image_of(96, 96)).astype(np.uint16)
    (tmp_path / "frames").mkdir()
    fits.PrimaryHDU(pixels).writeto(tmp_path / "frames" / "a.fits")
    out = tmp_path / "out"
    _, streaks = processed(tmp_path / "frames", out, "--wcs", "none")
    shown = capsys.readouterr().out
    n_published = sum(1 for flags in streaks["flags"] if not flags & StreakFlag.VETOED)
    assert n_published
    assert f"streaks published {n_published} ({n_published:.2f} a frame)" in " ".join(shown.split())
    # the noise was drawn with 4.0 ADU; 9,120 differences tell it to 2 %
    noise = float(next(line for line in shown.splitlines() if line.startswith("noise of a pixel")).split()[5])
    assert noise == pytest.approx(4.0, rel=0.06)
    assert "annual aberration" in shown
    page = (out / "report.html").read_text()
    assert "no DATE-OBS: the epoch is a number, not a time" in page
    assert page.count("<div class='case'>") == n_published
    # without truth there is no score, and the report is that page again
    assert cli.run(["score", str(out)]) == 2
    assert "frames from outside come without truth; give a list with --truth" in capsys.readouterr().err
    (out / "report.html").unlink()
    assert cli.run(["report", str(out)]) == 0
    assert (out / "report.html").read_text() == page
