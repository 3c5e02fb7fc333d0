"""`sboc validate`: its files, and one line for whatever is wrong with its input."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from scipy.spatial import cKDTree

from ground.astrometry import lost_in_space
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.cli.main import run
from sboc_e2e.registry import Registry
from sboc_e2e.validation.background import measure_background
from sboc_e2e.validation.figures import compare
from sboc_e2e.validation.sources import find_sources
from sboc_e2e.validation.subjects import from_fits, from_scenario
from tests.browser import SCHEMES, WIDTHS, excess_and_errors
from tests.validation import star_field
from tests.validation.test_measurements import star_frame

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios" / "validation"


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    path = tmp_path_factory.mktemp("real") / "real.fits"
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(star_frame(seed=5)[0]), fits.ImageHDU(star_frame(seed=6)[0])]
    fits.HDUList(hdus).writeto(path)
    return path


@pytest.fixture(scope="module")
def compared(real, tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    sim = folder / "sim.fits"
    fits.PrimaryHDU(star_frame(seed=7)[0]).writeto(sim)
    assert run(["validate", str(sim), "--against", str(real), "--hdu", "2", "--out", str(folder / "out")]) == 0
    return folder / "out"


def test_two_files(compared):
    figures = json.loads((compared / "validation.json").read_text())
    assert figures["real"]["name"] == "real.fits[2]"
    page = (compared / "validation.html").read_text()
    assert page.count("<svg") == 4
    assert "http-equiv" not in page
    assert 'src="http' not in page
    picture = (compared / "validation.png").read_bytes()
    assert picture[1:4] == b"PNG"
    assert len(picture) < 200_000


def test_proper_motion_is_that_of_the_frames_own_date(tmp_path, monkeypatch):
    image = fits.PrimaryHDU(star_frame(seed=5)[0])
    image.header.update({"DATE-OBS": "2026-01-01T12:00:00", "EXPTIME": 1.0, "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN"})
    image.header.update({"CRVAL1": 10.0, "CRVAL2": 20.0, "CRPIX1": 100.0, "CRPIX2": 100.0, "CDELT1": -1e-3, "CDELT2": 1e-3})
    image.writeto(tmp_path / "dated.fits")
    epochs, cone = [], StarCatalogue.cone

    def noted(self, *place, epoch_jyear):
        epochs.append(epoch_jyear)
        return cone(self, *place, epoch_jyear=epoch_jyear)

    monkeypatch.setattr(StarCatalogue, "cone", noted)
    from_fits(tmp_path / "dated.fits", None, StarCatalogue.embedded)
    # J2000.0 is noon of 2000 January 1; 26 years with 7 leap days are 9,497 days, a quarter of a day less than 26 Julian years
    assert epochs == [pytest.approx(2000.0 + 9497.0 / 365.25, abs=1e-5)]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_fits(chromium, compared, width, scheme):
    assert excess_and_errors(chromium, compared / "validation.html", width, scheme) == (0, [])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no-such-scenario", "--against", "REAL"], "there is no scenario"),
        (["missing.fits", "--against", "REAL"], "no such FITS file"),
        (["SIM", "--against", "missing.fits"], "no such FITS file"),
        (["SIM", "--against", "TEXT"], "not a readable FITS file"),
        (["SIM", "--against", "TABLE"], "no two-dimensional image"),
        (["SIM", "--against", "REAL", "--hdu", "0"], "allowed are 1, 2"),
        (["SIM", "--against", "FLAT"], "has no noise"),
        (["SIM", "--against", "NAN"], "hold a number"),
        (["SIM", "--against", "SMALL"], "allowed are sides"),
        (["smoke", "--against", "REAL", "--frame", "99"], "frame 99"),
        (["SIM", "--against", "REAL", "--frame", "77"], "--frame: has no effect on a FITS file"),
        (["SIM", "--against", "REAL", "--set", "nonsense"], "--set: has no effect on a FITS file"),
        (["SIM", "--against", "REAL", "--plugin", "my_lab"], "--plugin: has no effect on a FITS file"),
    ],
)
def test_bad_input_is_one_line(arguments, words, real, tmp_path, capsys):
    images = {
        "SIM": star_frame(seed=8)[0],
        "FLAT": np.ones((128, 128), np.float32),
        "NAN": np.full((128, 128), np.nan, np.float32),
        "SMALL": star_frame(seed=8)[0][:40, :40],
    }
    files = {"REAL": str(real)}
    for name, image in images.items():
        files[name] = str(tmp_path / f"{name}.fits")
        fits.PrimaryHDU(image).writeto(files[name])
    files["TEXT"] = str(tmp_path / "text.fits")
    Path(files["TEXT"]).write_text("not a picture")
    files["TABLE"] = str(tmp_path / "table.fits")
    fits.HDUList([fits.PrimaryHDU(), fits.BinTableHDU(np.zeros(3, dtype=[("a", "f4")]))]).writeto(files["TABLE"])
    code = run(["validate", *(files.get(a, a) for a in arguments), "--out", str(tmp_path / "out")])
    text = capsys.readouterr().err
    assert code == 2
    assert text.count("\n") == 1
    assert words in text
    assert not (tmp_path / "out").exists()


def test_pictures_without_a_star_have_curves_without_a_legend(tmp_path):
    """matplotlib warns of a legend without an entry, and warnings are errors here."""
    rng = np.random.default_rng(4)
    for name in ("one", "two"):
        fits.PrimaryHDU(rng.normal(100.0, 5.0, (160, 160)).astype(np.float32)).writeto(tmp_path / f"{name}.fits")
    arguments = ["validate", str(tmp_path / "one.fits"), "--against", str(tmp_path / "two.fits"), "--out", str(tmp_path / "out")]
    assert run(arguments) == 0
    assert (tmp_path / "out" / "validation.html").is_file()


def test_out_that_is_a_file(real, capsys):
    assert run(["validate", str(real), "--against", str(real), "--out", str(real)]) == 2
    assert "is a file" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "frame", "limits"),
    [
        ("saao_ystar", "saao_ystar_one_streak.fits", {"wasserstein": 0.10, "counts": (0.7, 1.4), "width": 0.25}),
        ("opd_ixon", "opd_control.fits", {"wasserstein": 0.05, "counts": (0.4, 2.5), "width": 0.5}),
    ],
)
def test_recreated_real_frames(scenario, frame, limits, shared_data, tmp_path):
    path = shared_data / "real" / frame
    if not path.is_file():
        pytest.skip(f"real frame not present: {path}")
    out = tmp_path / "out"
    assert run(["validate", str(SCENARIOS / f"{scenario}.toml"), "--against", str(path), "--out", str(out)]) == 0
    figures = json.loads((out / "validation.json").read_text())
    assert figures["match"]["gain"] == pytest.approx(1.0, abs=0.1)
    assert abs(figures["match"]["simulated_level_adu"] / figures["match"]["real_level_adu"] - 1) < 0.05
    assert figures["histogram"]["background"]["wasserstein_sigma"] < limits["wasserstein"]
    counts = [figures["stars"][side]["per_mpx"]["value"] for side in ("simulated", "real")]
    assert limits["counts"][0] < counts[0] / counts[1] < limits["counts"][1]
    for axis in ("fwhm_major_px", "fwhm_minor_px"):
        widths = [figures["psf"][side][axis]["value"] for side in ("simulated", "real")]
        assert widths[0] == pytest.approx(widths[1], abs=limits["width"])


@pytest.fixture(scope="module")
def solved_field(shared_data, tmp_path_factory):
    """A real star field, a frame without header, solved lost in space."""
    tiff = shared_data / "real" / "2019-07-29T204726_Alt60_Azi135_Try1.tiff"
    if not tiff.is_file() or not lost_in_space.installed():
        pytest.skip(f"real frame or extra `solve` not present: {tiff}")
    folder = tmp_path_factory.mktemp("delft")
    assert star_field.solve_field(tiff, folder / "field.fits") > 150
    return folder / "field.fits"


@pytest.fixture(scope="module")
def delft(solved_field):
    """Figures of the field against its recreation."""
    out = solved_field.parent / "out"
    assert run(["validate", str(SCENARIOS / "delft_field.toml"), "--against", str(solved_field), "--out", str(out)]) == 0
    return json.loads((out / "validation.json").read_text())


def test_magnitudes_of_a_real_star_field_and_their_scatter(delft):
    """The zero point of the recreation is fitted to the field, the scatter of the magnitudes is not."""
    stars = delft["catalogue"]
    scatter = [stars[side]["magnitude_scatter_mag"]["value"] for side in ("real", "simulated")]
    assert scatter[0] == pytest.approx(scatter[1], abs=0.06)
    assert abs(stars["real_minus_simulated"]["offset_mag"]) < 0.05


def test_places_and_magnitudes_of_a_real_star_field(delft):
    """230 stars in both."""
    figures = delft
    assert figures["match"]["gain"] == pytest.approx(1.0, abs=0.1)
    stars = figures["catalogue"]
    both = stars["real_minus_simulated"]
    assert both["n"] > 230
    assert np.abs(both["offset_px"]).max() < 0.1  # the direction, fitted
    for axis in ("row_rms_px", "col_rms_px"):  # 40.3 arcsec each pixel: 10 arcsec
        assert stars["real"][axis]["value"] < 0.25
        assert 0.7 < stars["real"][axis]["value"] / stars["simulated"][axis]["value"] < 1.8
    counts = [figures["stars"][side]["per_mpx"]["value"] for side in ("simulated", "real")]
    assert counts[0] / counts[1] == pytest.approx(1.0, abs=0.25)


def share_of_wings(picture):
    """Light of isolated bright stars per pixel of rings, 2.5 to 3.5 and 5 to 7 px, over that within 2.5 px: medians, errors."""
    background = measure_background(picture.image)
    sources, image = find_sources(background, 4.0), picture.image - background.level
    place = np.stack([sources.row, sources.col], axis=1)
    alone = cKDTree(place).query_ball_point(place, 14.0, return_length=True) == 1
    bright = (sources.flux > np.sort(sources.flux)[-120]) & np.all((place > 16) & (place < np.array(image.shape) - 16), axis=1)
    found = []
    for row, col in place[alone & bright]:
        part = np.s_[int(row) - 14 : int(row) + 15, int(col) - 14 : int(col) + 15]
        rows, cols = np.ogrid[part]
        distance, light = np.hypot(rows - row, cols - col), image[part]
        if light.max() > 2500.0:
            continue
        light = light - np.median(light[distance > 11.0])
        core = light[distance < 2.5].sum()
        found.append([light[(distance >= low) & (distance < high)].mean() / core for low, high in ((2.5, 3.5), (5.0, 7.0))])
    return np.median(found, axis=0), 1.25 * np.std(found, axis=0) / len(found) ** 0.5


@pytest.mark.slow
def test_the_psf_of_a_real_star_field_lies_among_those_of_the_wavefront(solved_field):
    """Axis ratio, its raggedness over the field and the wings of the real stars, against five draws of the errors."""
    real = from_fits(solved_field, None, StarCatalogue.embedded)
    wings, wings_error = share_of_wings(real)
    seen, halos, measured = [], [], {}
    for seed in range(2019, 2024):
        drawn = from_scenario(str(SCENARIOS / "delft_field.toml"), 0, Registry(), (f"seed={seed}",))
        figures = compare(drawn, real).figures["psf"]
        measured = figures["real"]
        seen.append([figures["simulated"][k]["value"] for k in ("axis_ratio", "scatter_px")])
        halos.append(share_of_wings(drawn)[0])
    for k, name in enumerate(("axis_ratio", "scatter_px")):
        assert np.min(seen, axis=0)[k] < measured[name]["value"] < np.max(seen, axis=0)[k], name
    assert np.all(np.min(halos, axis=0) - 2.0 * wings_error < wings)
    assert np.all(wings < np.max(halos, axis=0) + 2.0 * wings_error)
