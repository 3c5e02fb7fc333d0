"""detect, measure and solve on arrays: what they give, in which units, and what they refuse."""

from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.table import Table
from astropy.wcs import WCS

from sboc_e2e.api import detect, measure, solve
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import StarFlag, StreakFlag
from tests.validation.star_field import solve_field


def trail_image(ends: tuple[float, float, float, float], flux_adu_px: float, *, gain: float = 1.0) -> np.ndarray:
    """A noisy sky of 400 e- with one trail of sigma 1.2 px, in ADU."""
    rng = np.random.default_rng(3)
    row, col = np.mgrid[:160, :200].astype(float)
    start, stop = np.array(ends[:2]), np.array(ends[2:])
    length = float(np.linalg.norm(stop - start))
    light = np.zeros(row.shape)
    for share in (np.arange(2000) + 0.5) / 2000:
        at = start + share * (stop - start)
        light += np.exp(-0.5 * ((row - at[0]) ** 2 + (col - at[1]) ** 2) / 1.44) / (2.0 * np.pi * 1.44)
    electrons = 400.0 + flux_adu_px * length * light / 2000
    return (electrons + rng.normal(0.0, np.sqrt(electrons))) / gain


def test_a_trail_of_known_light_comes_back_in_electrons_whatever_the_gain() -> None:
    ends, per_px = (30.0, 25.0, 120.0, 170.0), 300.0
    true_e = per_px * float(np.hypot(90.0, 145.0))
    for gain in (1.0, 4.0):
        image = trail_image(ends, per_px, gain=gain)
        trails = measure(image, detect(image, gain_e_adu=gain).detections, gain_e_adu=gain)
        best = trails[np.argmax(trails["snr"])]
        assert np.abs(np.array([best[name] for name in ("row0", "col0", "row1", "col1")]) - ends).max() < 1.0
        assert abs(best["flux_e"] - true_e) < 4.0 * best["flux_err_e"] + 0.02 * true_e
        assert best["probability"] > 0.5


@pytest.mark.parametrize("scale", [1e3, 1.0, 1e-2, 1e-4, 1e-20])
def test_the_unit_of_the_pixels_does_not_matter(scale: float) -> None:
    """Where no gain is given: a stack in counts per second, one divided by its sky, and fluxes in erg/(s cm2 A). One electron a
    number made the photon noise of small numbers too large, and both ends of a trail of S/N 367 were 2.7 px off."""
    ends = (30.0, 25.0, 120.0, 170.0)
    image = scale * trail_image(ends, 300.0)
    trails = measure(image, detect(image).detections)
    best = trails[np.argmax(trails["snr"])]
    assert np.abs(np.array([best[name] for name in ("row0", "col0", "row1", "col1")]) - ends).max() < 0.3
    assert 0.7 < best["chi2_nu"] < 1.3
    assert best["probability"] > 0.5
    assert best["flags"] & StreakFlag.GAIN_ASSUMED


@pytest.mark.parametrize("scale", [1e-3, 1e-9, 1e-20])
def test_the_gain_that_detect_tells_is_that_of_the_image_as_given(scale: float) -> None:
    """The noise of the sky is 20 ADU times the scale, and a guessed gain makes 5 e- of less. What has no gain is measured so."""
    image = scale * trail_image((30.0, 25.0, 120.0, 170.0), 300.0)
    found = detect(image)
    gain = found.stars.meta["gain_e_adu"]
    assert gain * scale * 20.0 == pytest.approx(5.0 if scale < 0.25 else 20.0, rel=0.1)
    by_guess, by_gain = measure(image, found.detections), measure(image, found.detections, gain_e_adu=gain)
    assert len(by_gain) == len(by_guess) > 0
    for name in ("row0", "col0", "row1", "col1", "flux_e", "flux_err_e", "snr", "probability"):
        assert by_gain[name].tolist() == pytest.approx(by_guess[name].tolist(), rel=1e-3)
    assert detect(image, gain_e_adu=gain).stars.meta["gain_e_adu"] == pytest.approx(gain, rel=1e-12)


@pytest.mark.parametrize("gain", [1.0, 0.0, -1.0, np.nan, 1e300])
def test_a_gain_that_leaves_no_numbers_is_refused_in_one_line(gain: float) -> None:
    image = 1e-9 * trail_image((30.0, 25.0, 120.0, 170.0), 300.0)
    for step in (lambda: detect(image, gain_e_adu=gain), lambda: measure(image, [], gain_e_adu=gain)):
        with pytest.raises(UserError, match=r"^gain_e_adu: "):
            step()


def test_numbers_that_cannot_be_computed_with_are_the_image_s(monkeypatch: pytest.MonkeyPatch) -> None:
    def singular(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("sboc_e2e.outside.one_step.GivenDetections.detect", singular)
    with pytest.raises(UserError, match=r"^image: .*Singular matrix"):
        measure(trail_image((30.0, 25.0, 120.0, 170.0), 300.0), [])


def test_detections_of_another_program_are_measured_where_they_are() -> None:
    image = trail_image((30.0, 25.0, 120.0, 170.0), 300.0)
    (trail,) = measure(image, [(31.0, 24.0, 118.0, 168.0)])
    assert np.abs(np.array([trail[name] for name in ("row0", "col0", "row1", "col1")]) - [30, 25, 120, 170]).max() < 1.0


def test_each_detection_has_a_row_in_its_place() -> None:
    """One on a trail, one off it, one without usable pixels, and the same again; whatever their S/N."""
    image = trail_image((30.0, 25.0, 120.0, 170.0), 300.0)
    image[:20, 140:] = np.nan
    ends = [(140.0, 20.0, 150.0, 60.0), (31.0, 24.0, 118.0, 168.0), (5.0, 150.0, 12.0, 190.0), (31.0, 24.0, 118.0, 168.0)]
    trails = measure(image, Table(rows=[(*each, snr) for each, snr in zip(ends, (5.0, 90.0, 7.0, 3.0), strict=True)],
                                  names=("row0", "col0", "row1", "col1", "snr")))  # fmt: skip
    assert trails.colnames[0] == "detection"
    assert trails["detection"].tolist() == [0, 1, 2, 3]
    assert [bool(flags & StreakFlag.FIT_FAILED) for flags in trails["flags"][1:]] == [False, True, False]
    assert tuple(trails[name][2] for name in ("row0", "col0", "row1", "col1")) == ends[2]
    assert trails["row0"][1] == pytest.approx(30.0, abs=0.5)
    assert trails["row0"][3] == pytest.approx(30.0, abs=0.5)


def test_more_detections_than_a_frame_in_orbit_may_measure_have_a_row_each() -> None:
    """Of 900 regions of 172 px the work of a frame allowed 199, and the others were left out without a word."""
    image = trail_image((30.0, 25.0, 120.0, 170.0), 300.0)
    assert measure(image, [(31.0, 24.0, 118.0, 168.0)] * 300)["detection"].tolist() == list(range(300))


@pytest.mark.parametrize(
    ("detections", "says"),
    [
        ([(31, 24, 118, 168), (-30, 20, -10, 40)], r"up to 2 px outside it; detection 1 \("),
        ([(31, 24, 118, 168), (150, 20, 200, 40)], r"up to 2 px outside it; detection 1 \("),
        ([(500, 0, 510, 9)] * 8, r"detection 0, 1, 2, 3, 4 and 3 more"),
        ([(31, 24, np.nan, 168)], r"finite ends; detection 0"),
        ([(31, 24, 118)], r"four numbers each"),
        ([(31, 24, 118)] * 4, r"four numbers each"),
        ([(10**400, 24, 118, 168)], r"four numbers each"),
        (Table({name: np.ones((3, 2)) for name in ("row0", "col0", "row1", "col1")}), r"one number a row in row0"),
        ([("a", 24, 118, 168)], r"four numbers each"),
        ([(31, 24, 118, 168)] * 1001, r"1000 at most, got 1001"),
        (Table({"row0": [1.0]}), r"no col0, row1, col1"),
        (Table({"row0": [9.0], "col0": [9.0], "row1": [30.0], "col1": [30.0], "snr": [np.nan]}), r"S/N from 0 to 1e\+09"),
    ],
)
def test_detections_that_cannot_be_measured_are_named_in_one_line(detections: Any, says: str) -> None:
    with pytest.raises(UserError, match=rf"^detections: .*{says}"):
        measure(trail_image((30.0, 25.0, 120.0, 170.0), 300.0), detections)


def test_what_a_mask_hides_is_no_light() -> None:
    """A block of 5000 ADU below the mask of an array was found as a trail of S/N 10,882, and so below that of a CCDData."""
    ends = (30.0, 25.0, 120.0, 170.0)
    image = trail_image(ends, 300.0)
    image[130:134, 20:60] += 5000.0
    hidden = np.zeros(image.shape, dtype=bool)
    hidden[128:136, 15:65] = True
    as_nan = np.where(hidden, np.nan, image)
    wanted = detect(as_nan)
    assert len(wanted.detections) == 1
    for masked in (np.ma.array(image, mask=hidden), CCDData(image, mask=hidden, unit="adu")):
        found = detect(masked)
        assert found.detections["snr"].tolist() == wanted.detections["snr"].tolist()
        assert found.stars["row"].tolist() == wanted.stars["row"].tolist()
        assert measure(masked, found.detections)["snr"].tolist() == measure(as_nan, wanted.detections)["snr"].tolist()
    assert detect(np.ma.array(np.rint(image).astype(np.int16), mask=hidden)).detections["snr"][0] > 50.0
    table = Table(wanted.detections, masked=True)
    table["col1"].mask[0] = True
    with pytest.raises(UserError, match=r"^detections: expected ends that are not masked; detection 0 "):
        measure(image, table)


def test_pixels_that_are_full_by_their_number_type_are_full_below_a_mask_too() -> None:
    """A mask made floats of whole numbers, which have no largest one; and what it hides may be larger than the type of pixels."""
    image = np.rint(trail_image((30.0, 25.0, 120.0, 170.0), 300.0)).astype(np.int32) + 60000
    row, col = np.mgrid[:160, :200]
    image = np.minimum(image + np.rint(3e4 * np.exp(-0.5 * ((row - 120) ** 2 + (col - 40) ** 2) / 1.44)).astype(np.int32), 65535)
    hidden = np.zeros(image.shape, dtype=np.bool_)
    hidden[:10, :10] = True
    image[hidden] = 999999
    (star,) = (
        row for row in detect(np.ma.array(image, mask=hidden)).stars if abs(row["row"] - 120) < 2 and abs(row["col"] - 40) < 2
    )
    assert star["flags"] & StarFlag.SATURATED


def test_rows_of_a_masked_table_are_refused_where_an_end_is_hidden_and_measured_where_only_their_snr_is() -> None:
    image = trail_image((30.0, 25.0, 120.0, 170.0), 300.0)
    table = Table(rows=[(31.0, 24.0, 118.0, 168.0, 1e30)] * 2, names=("row0", "col0", "row1", "col1", "snr"), masked=True)
    table["snr"].mask = True
    assert measure(image, table)["row0"].tolist() == measure(image, [(31.0, 24.0, 118.0, 168.0)] * 2)["row0"].tolist()
    table["col0"].mask[1] = True
    for given in (table, list(table), np.ma.array([[31.0, 24.0, 118.0, 168.0]] * 2, mask=[[0] * 4, [0, 1, 0, 0]])):
        with pytest.raises(UserError, match=r"^detections: expected ends that are not masked; detection 1 "):
            measure(image, given)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"saturation_adu": 0.0}, "saturation_adu: expected more than 0"),
        ({"saturation_adu": -5.0}, "saturation_adu: expected more than 0"),
        ({"read_noise_e": -1.0}, "read_noise_e: expected 0 to 1e6"),
        ({"read_noise_e": np.nan}, "read_noise_e: expected 0 to 1e6"),
        ({"gain_e_adu": "2"}, "gain_e_adu: expected a number"),
        ({"exposure_s": None}, "exposure_s: expected a number"),
        ({"exposure_s": "a"}, "exposure_s: expected a number"),
        ({"exposure_s": [1.0]}, "exposure_s: expected a number"),
        ({"saturation_adu": np.inf}, "saturation_adu: expected more than 0 and at most"),
        ({"saturation_adu": 10**400}, "saturation_adu: expected a number"),
        ({"read_noise_e": 1e9}, "read_noise_e: expected 0 to 1e6"),
    ],
)
def test_options_that_are_no_numbers_are_named_in_one_line(given: dict[str, Any], says: str) -> None:
    with pytest.raises(UserError, match="^" + says):
        detect(trail_image((30.0, 25.0, 120.0, 170.0), 300.0), **given)


@pytest.mark.parametrize("width_deg", [np.nan, 0.0, -5.0, 5e-324, 1.5, 400.0, "20"])
def test_a_width_that_no_image_has_is_refused(width_deg: Any) -> None:
    with pytest.raises(UserError, match=r"^width_deg: expected"):
        solve(detect(trail_image((30.0, 25.0, 120.0, 170.0), 300.0)).stars, width_deg=width_deg)


def test_a_list_of_stars_that_lacks_something_is_refused() -> None:
    stars = detect(trail_image((30.0, 25.0, 120.0, 170.0), 300.0)).stars
    with pytest.raises(UserError, match=r"^solve: the table of stars has no flux_e"):
        solve(stars["row", "col"])
    with pytest.raises(UserError, match=r"^solve: expected a table of stars"):
        solve(np.zeros((5, 3)))
    stars.meta["rows"] = "many"
    with pytest.raises(UserError, match=r'^solve: meta\["rows"\]: expected a number'):
        solve(stars)
    with pytest.raises(UserError, match=r"^solve: the table of stars: expected one number a row in flux_e"):
        solve(Table({"row": [1.0], "col": [1.0], "flux_e": ["a"]}, meta={"rows": 64, "cols": 64}))


def test_stars_with_a_number_that_is_hidden_or_none_do_not_count() -> None:
    pytest.importorskip("tetra3rs", reason="the extra `solve` is not installed")
    place = np.arange(9.0)
    stars = Table({"row": place, "col": place, "flux_e": place}, meta={"rows": 64, "cols": 64}, masked=True)
    stars["flux_e"].mask[:3] = True
    stars["row"][4] = np.nan
    with pytest.raises(UserError, match=r"^solve: 5 stars fit no field"):
        solve(stars, width_deg=30.0)


def test_detections_in_an_image_without_light_are_refused() -> None:
    with pytest.raises(UserError, match=r"^detections: expected pixels that differ"):
        measure(np.full((64, 64), 100.0), [(10, 10, 30, 30)])


@pytest.mark.parametrize(
    "image",
    [
        np.zeros(5),
        np.zeros((8, 40)),
        np.array([["a"]]),
        np.zeros((20, 20), dtype=complex),
        np.full((64, 64), np.nan),
        np.ma.masked_all((64, 64), dtype=np.uint16),
        [[1, 2], [3]],
        None,
    ],
)
def test_what_is_no_image_is_refused_in_one_line(image: Any) -> None:
    with pytest.raises(UserError, match=r"^image: expected"):
        detect(image)


def test_an_image_without_anything_gives_empty_tables() -> None:
    found = detect(np.full((64, 64), 100.0))
    assert len(found.detections) == 0
    assert len(measure(np.full((64, 64), 100.0), found.detections)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_sky_of_a_real_field(shared_data: Path, tmp_path: Path, mirrored: bool) -> None:
    """Against the WCS that astropy fits to the same image: a TAN without distortion, within 3 px in the middle half."""
    pytest.importorskip("tetra3rs", reason="the extra `solve` is not installed")
    (frame,) = (shared_data / "real").glob("*_Alt60_Azi-45_Try1.tiff")
    solve_field(frame, tmp_path / "reference.fits")
    image = matplotlib.image.imread(frame)
    wcs = solve(detect(image[:, ::-1] if mirrored else image).stars, width_deg=11.4)
    col, row = np.meshgrid(np.linspace(256, 768, 5), np.linspace(192, 576, 5))
    there = SkyCoord(*WCS(fits.getheader(tmp_path / "reference.fits")).pixel_to_world_values(col, row), unit="deg")
    here = SkyCoord(*wcs.pixel_to_world_values(image.shape[1] - 1 - col if mirrored else col, row), unit="deg")
    assert here.separation(there).deg.max() < 3.0 * 11.4 / 1024
