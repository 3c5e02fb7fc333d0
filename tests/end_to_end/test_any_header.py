"""No frame ends the run: headers and contents at random through the whole of `process`, and the crashes that were found."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from onboard.stars.trail_vectors import fitted_vectors
from sboc_e2e.icd.signals import StarMotion
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.header_wcs import usable_wcs
from tests.benchmarks.fuzz_frames import tried
from tests.fuzz.outside import content, one_input, run

TAN = {
    "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 10.0, "CRVAL2": 20.0, "CRPIX1": 24.0, "CRPIX2": 24.0,
    "CD1_1": -1e-3, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-3,
}  # fmt: skip


def plain(seed: int = 1, **cards: object) -> fits.PrimaryHDU:
    hdu = fits.PrimaryHDU(content(np.random.default_rng(seed), (48, 48), "trail").astype(np.float32))
    hdu.header.update(cards)
    return hdu


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.binary(min_size=1, max_size=8))
@pytest.mark.slow
def test_any_header_and_content_give_products_and_cost_no_other_frame(data: bytes) -> None:
    one_input(data)


@pytest.mark.parametrize(("stage", "frames"), [("reader", 150), ("process", 25)])
def test_drawn_frames_break_nothing(stage: str, frames: int) -> None:
    """A part of what `tests.benchmarks.fuzz_frames` draws: seed 6 is a cube, which went without a word."""
    found = tried(0, frames, stage)
    assert found["frames"] == frames
    assert found["broken"] == []


@pytest.mark.parametrize("shape", [(20,), (1, 20, 20), (2, 20, 20), None])
def test_a_file_without_a_picture_is_named(tmp_path: Path, shape: tuple[int, ...] | None) -> None:
    plain().writeto(tmp_path / "b.fits")
    fits.PrimaryHDU(None if shape is None else np.zeros(shape)).writeto(tmp_path / "a.fits")
    source = FitsFolder(path=tmp_path)
    assert [sourced.file for sourced in source.frames()] == ["b.fits"]
    (line,) = source.left_out
    if shape is not None and len(shape) == 3:
        assert f"a.fits, HDU 0: holds a cube of {shape[0]} x 20 x 20; save each" in line
    else:
        assert "a.fits: holds no two-dimensional image" in line


@pytest.mark.parametrize(
    "cards",
    [
        {"CRVAL1": "10.0", "CRVAL2": "20.0"},
        {"CD1_1": "x"},
        {"CD1_1": 0.0, "CD2_2": 0.0},
        {"CD2_2": 0.0},
        {"CD1_1": 40.0, "CD2_2": 40.0},
        {"CTYPE1": "GLON-TAN", "CTYPE2": "GLAT-TAN"},
        {"CTYPE1": "DEC--TAN", "CTYPE2": "RA---TAN"},
        {"RADESYS": "FK4", "EQUINOX": 1950.0},
        {"CUNIT1": "furlong"},
        {"CRPIX1": 1e12},
    ],
)
def test_a_wcs_that_cannot_be_believed_leaves_pixels_and_a_note(tmp_path: Path, cards: dict[str, object]) -> None:
    """Text for numbers, matrices of zeros, axes and systems that are others: two such frames ended with exit code 3."""
    (tmp_path / "in").mkdir()
    for name in ("a", "b"):
        plain(1, **(TAN | cards)).writeto(tmp_path / "in" / f"{name}.fits")
    ingest = run(tmp_path / "in", tmp_path / "out")
    for frame in ingest["outside"]["frames"]:
        assert any("WCS not used" in note for note in frame["notes"])
    frames, streaks = (
        Table.read(tmp_path / "out" / "products" / f"{n}.ecsv", format="ascii.ecsv") for n in ("frames", "streaks")
    )
    assert all("WCS not used" in note for note in frames["notes"])
    assert not np.isfinite(np.asarray(streaks["ra_mid_deg"], dtype=float)).any()


@pytest.mark.parametrize("projection", ["TAN", "SIN", "STG", "ARC", "ZEA", "TPV"])
@pytest.mark.parametrize("dec_deg", [0.0, 60.0, 90.0, -90.0])
def test_projections_in_use_are_believed_also_over_the_poles(projection: str, dec_deg: float) -> None:
    header = fits.Header(TAN | {"CRVAL2": dec_deg, "CTYPE1": f"RA---{projection}", "CTYPE2": f"DEC--{projection}"})
    if projection == "TPV":
        header.update({"PV1_1": 1.0, "PV2_1": 1.0})
    wcs, note = usable_wcs(header, 48, 48)
    assert note is None
    assert wcs is not None


def test_a_header_without_a_wcs_needs_no_note() -> None:
    assert usable_wcs(fits.Header(), 48, 48) == (None, None)


def test_bright_places_without_light_are_no_trailed_stars() -> None:
    """Peaks over ground whose sum is negative gave a scale that scipy refuses."""
    image = np.full((64, 64), -1.0, dtype=np.float32)
    peaks = np.array([[32.0, 32.0, 10.0]], dtype=np.float32)
    guess = StarMotion(drow=0.0, dcol=12.0, turn_rad=0.0, middle_row=31.5, middle_col=31.5)
    places, _, _, _ = fitted_vectors(image, np.zeros((64, 64), np.uint8), peaks[:, :2].astype(float), guess, 1.2)
    assert len(places) == 0


def test_frames_that_do_not_tell_their_exposure_are_linked_without_error(tmp_path: Path) -> None:
    """A static trail in two frames without EXPTIME: a trail of no duration has no speed."""
    (tmp_path / "in").mkdir()
    for name in ("a", "b"):
        plain().writeto(tmp_path / "in" / f"{name}.fits")
    run(tmp_path / "in", tmp_path / "out")


def test_a_bad_file_costs_only_itself(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    plain().writeto(tmp_path / "in" / "b.fits")
    (tmp_path / "in" / "a.fits").write_bytes(b"no FITS file")
    whole = plain()
    whole.writeto(tmp_path / "in" / "c.fits")
    (tmp_path / "in" / "d.fits").write_bytes((tmp_path / "in" / "c.fits").read_bytes()[:5000])
    fits.PrimaryHDU(np.zeros((4, 4))).writeto(tmp_path / "in" / "e.fits")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ingest = run(tmp_path / "in", tmp_path / "out")
    assert [frame["file"] for frame in ingest["outside"]["frames"]] == ["b.fits", "c.fits"]
    left_out = ingest["outside"]["left_out"]
    assert [Path(line.split(":")[0].split(",")[0]).name for line in left_out] == ["a.fits", "e.fits", "d.fits"]


@pytest.mark.parametrize(
    ("name", "unit", "blind"),
    [("BPM", None, True), ("DQ", None, False), ("MASK", None, False), ("VAR", None, False), ("ERR_1", None, False),
     ("WHT", None, True), ("X", "electron**2", False), ("", None, False)],
)  # fmt: skip
def test_planes_that_are_no_pictures_are_not_searched(tmp_path: Path, name: str, unit: str | None, blind: bool) -> None:
    """HST, Gemini, LSST and others write masks, variances and weights as image HDUs; only certain meanings mask pixels."""
    picture, flags = plain(), np.zeros((48, 48), dtype=np.int16)
    flags[10:14, 5:40] = 4
    plane = fits.ImageHDU(48 * [48 * [1]] - np.sign(flags) if name == "WHT" else flags, name=name or None)
    if unit:
        plane.header["BUNIT"] = unit
    fits.HDUList([picture, plane]).writeto(tmp_path / "a.fits")
    (place,) = FitsFolder(path=tmp_path / "a.fits").places
    (frame,) = FitsFolder(path=tmp_path / "a.fits").frames()
    assert place.hdu == 0
    assert any("not searched" in note.text for note in frame.notes)
    assert np.array_equal(np.isnan(frame.frame.pixels), (flags > 0) & blind)


def test_planes_that_only_exttype_names_are_not_searched(tmp_path: Path) -> None:
    """As in LSST's calibrated exposures, whose planes are compressed and have no EXTNAME of their own."""
    planes = [fits.ImageHDU(np.random.default_rng(3).normal(9.0, 1.0, (48, 48)).astype(np.float32)) for _ in range(2)]
    for plane, kind in zip(planes, ("MASK", "VARIANCE"), strict=True):
        plane.header["EXTTYPE"] = kind
    fits.HDUList([plain(), *planes]).writeto(tmp_path / "a.fits")
    assert [place.hdu for place in FitsFolder(path=tmp_path / "a.fits").places] == [0]


def test_the_notes_are_kept_in_the_products(tmp_path: Path) -> None:
    fits.HDUList([plain(), fits.ImageHDU(np.ones((48, 48), np.float32), name="VARIANCE")]).writeto(tmp_path / "a.fits")
    run(tmp_path / "a.fits", tmp_path / "out")
    text = (tmp_path / "out" / "products" / "ingest.json").read_text(encoding="utf-8")
    (frame,) = json.loads(text)["outside"]["frames"]
    assert any("variance" in note for note in frame["notes"])


def test_coefficients_without_their_suffix_are_used_in_silence(capfd: pytest.CaptureFixture[str]) -> None:
    """astropy writes fourteen lines about SIP under RA---TAN to the standard output, where our own lines go."""
    cards = fits.Header()
    for key, value in {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 10.0, "CRVAL2": 20.0, "CRPIX1": 32.0, "CRPIX2": 32.0,
        "CD1_1": -1e-3, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-3, "A_ORDER": 2, "B_ORDER": 2, "A_2_0": 1e-7,
    }.items():  # fmt: skip
        cards[key] = value
    wcs, note = usable_wcs(cards, 64, 64)
    assert wcs is not None
    assert wcs.sip is not None
    assert note is None
    assert capfd.readouterr() == ("", "")
