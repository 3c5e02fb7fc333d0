"""Pixels that came down, written as FITS: every value as sent, what was not sent is blank, every image knows its directions."""

import io
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS

from ground.astrometry.astrometer import CameraFit
from ground.astrometry.wcs_export import pixel_icrs
from ground.products.images import frame_images, has_images
from ground.streak_rows import STREAKS_PER_FRAME
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.signals import FIXED_POINT, Detection, RoiGroup, Strip
from tests.astrometry.star_fields import grid, make_field

SIDE, CELL = 4096, 64


def _strip(rng: np.random.Generator, row: int, col: int, dtype: type = np.int32) -> Strip:
    """Forty lines of twelve pixels, half a pixel further left each."""
    return Strip(
        axis=0,
        major0=row,
        minor0_fp=col * FIXED_POINT,
        slope_fp=-FIXED_POINT // 2,
        level_adu=3,
        values_adu=rng.integers(-50, 50_000, (40, 12)).astype(dtype),
    )


@pytest.fixture(scope="module")
def seen():
    """A frame that came down whole, with a thumbnail, a region of two strips and one that reaches across the frame."""
    rng, catalogue = np.random.default_rng(3), StarCatalogue.embedded()
    fit, field = CameraFit(), make_field(catalogue, 5)
    solution = fit.solve(fit.initial_state(field.calibration, catalogue), field.frame)[1]
    found = Detection(row0=100.0, col0=206.0, row1=170.0, col1=180.0, snr=20.0)
    near = RoiGroup(roi_id=4, detection=found, strips=(_strip(rng, 100, 200), _strip(rng, 138, 181)), n_strips=3)
    far = RoiGroup(roi_id=7, detection=found, strips=(_strip(rng, 0, 2), _strip(rng, 4080, 4000)), n_strips=2)
    return (
        replace(
            field.frame,
            whole_frame=rng.integers(-100, 65_535, (SIDE, SIDE)).astype(np.int32),
            thumbnail_adu=rng.normal(10.0, 1.0, (SIDE // CELL, SIDE // CELL)).astype(np.float32),
            rois=(near, far),
        ),
        solution,
    )


def _written(frame, icrs, wanted="all") -> bytes:
    stream = io.BytesIO()
    frame_images(frame, icrs, wanted).writeto(stream)
    return stream.getvalue()


@pytest.fixture(scope="module")
def opened(seen):
    frame, solution = seen
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hdus = fits.open(io.BytesIO(_written(frame, pixel_icrs(frame.header, solution))))
        for hdu in hdus[1:]:
            WCS(hdu.header)
            assert hdu.data is not None
    return hdus


def test_files_are_read_without_a_warning_and_name_their_parts(opened):
    assert [hdu.name for hdu in opened] == ["PRIMARY", "FRAME", "THUMBNAIL", "ROI", "ROI", "ROI"]
    assert [opened[k].header["EXTVER"] for k in (3, 4, 5)] == [1, 2, 3]
    assert [opened[k].header["ROIID"] for k in (3, 4, 5)] == [4, 7, 7]
    assert opened["ROI", 1].header["STREAKID"] == opened[0].header["FRAMENO"] * STREAKS_PER_FRAME
    assert (opened["ROI", 1].header["NSTRIPS"], opened["ROI", 1].header["NARRIVED"]) == (3, 2)


def test_pixels_are_those_that_were_sent(seen, opened):
    frame, _ = seen
    assert np.array_equal(opened["FRAME"].data, frame.whole_frame)
    assert np.array_equal(opened["THUMBNAIL"].data, frame.thumbnail_adu)
    near, far = frame.rois
    for extension, strips in ((1, near.strips), (2, far.strips[:1]), (3, far.strips[1:])):
        box, sent = opened["ROI", extension], {}
        for strip in strips:
            for row, col, inside, value in zip(
                *(a.ravel() for a in strip.pixel_coordinates(SIDE, SIDE)), strip.values_adu.ravel(), strict=True
            ):
                if inside:
                    sent.setdefault((int(row), int(col)), int(value))
        got = box.data
        row, col = np.nonzero(np.isfinite(got))
        row0, col0 = box.header["ROW0"], box.header["COL0"]
        assert {(int(r) + row0, int(c) + col0): got[r, c] for r, c in zip(row, col, strict=True)} == sent


def test_every_image_has_the_directions_of_the_solved_camera(seen, opened):
    """Over the whole frame, and where a cut-out or a cell lies in it: to 0.02 arcsec there and 0.001 px back."""
    frame, solution = seen
    icrs = pixel_icrs(frame.header, solution)
    row, col = grid(SIDE, 17)
    box = opened["ROI", 1].header
    places = [("FRAME", row, col, row, col), ("THUMBNAIL", row, col, (row - 31.5) / CELL, (col - 31.5) / CELL)]
    for extension in (1, 2, 3):
        box = opened["ROI", extension].header
        inner_row, inner_col = (a[:: 17 + 1] * 50.0 / SIDE for a in (row, col))
        places.append((("ROI", extension), inner_row + box["ROW0"], inner_col + box["COL0"], inner_row, inner_col))
    for name, row_px, col_px, here_row, here_col in places:
        wcs = WCS(opened[name].header)
        want = SkyCoord(*icrs(row_px, col_px), unit="deg")
        got = SkyCoord(*wcs.all_pix2world(here_col, here_row, 0), unit="deg")
        assert got.separation(want).to_value(u.arcsec).max() < 0.02
        back_col, back_row = wcs.all_world2pix(got.ra.deg, got.dec.deg, 0)
        assert np.abs(back_row - here_row).max() < 1e-3
        assert np.abs(back_col - here_col).max() < 1e-3


def test_headers_say_when_and_from_where(seen, opened):
    """Row r opens r line times after row 0, so the middle of the frame is exposed half of all line times later than its start.

    Epochs by astropy, whose TAI begins in 1958 as the contract's does.
    """
    header = seen[0].header
    assert header.line_time_ns != 0
    opened_at = Time("1958-01-01", scale="tai") + header.t_start_tai_ns // 10**9 * u.s + header.t_start_tai_ns % 10**9 * u.ns
    middle = opened_at + (0.5 * header.exposure_ns + header.line_time_ns * 0.5 * (header.rows - 1)) * u.ns
    for cards in (opened[0].header, opened["FRAME"].header):
        assert cards["TIMESYS"] == "UTC"
        for which, epoch in (("OBS", opened_at), ("AVG", middle)):
            assert abs((Time(cards[f"DATE-{which}"], scale="utc") - epoch).to_value("us")) < 1.0
            assert cards[f"MJD-{which}"] == pytest.approx(epoch.utc.mjd, abs=1e-9)
        assert cards["EXPTIME"] == header.exposure_ns * 1e-9
        assert cards["LINETIME"] == header.line_time_ns * 1e-9
        assert [cards[f"GCRS_{axis}"] for axis in "XYZ"] == header.observer.position_m.tolist()
        assert [cards[f"GCRS_V{axis}"] for axis in "XYZ"] == header.observer.velocity_m_s.tolist()
    assert "annual aberration" in "".join(opened[0].header["COMMENT"])


def test_the_same_frame_gives_the_same_bytes(seen):
    frame, solution = seen
    small = replace(frame, whole_frame=None)
    icrs = pixel_icrs(frame.header, solution)
    assert _written(small, icrs) == _written(small, icrs)


def test_without_a_solution_there_are_pixels_but_no_directions(seen):
    frame, _ = seen
    with fits.open(io.BytesIO(_written(replace(frame, whole_frame=None), None))) as hdus:
        assert not any("CTYPE1" in hdu.header for hdu in hdus)
        assert len(hdus) == 5


def test_scaled_and_lossy_pixels_are_floats(seen):
    """Float frames travel in units of their own, lossy strips hold halves: both are ADU in the file."""
    frame, _ = seen
    rng = np.random.default_rng(1)
    group = replace(frame.rois[0], strips=(_strip(rng, 100, 200, np.float32),))
    scaled = replace(frame, whole_frame=None, rois=(group, frame.rois[0]), adu_scale=0.5, adu_offset=20.0)
    with fits.open(io.BytesIO(_written(scaled, None))) as hdus:
        for extension, strip in ((1, group.strips[0]), (2, frame.rois[0].strips[0])):
            got = hdus["ROI", extension].data
            assert got[0, -12:] == pytest.approx(0.5 * strip.values_adu[0] + 20.0)
            assert np.isnan(got).any()


def test_only_what_is_wanted_is_written(seen):
    frame, _ = seen
    bare = replace(frame, whole_frame=None)
    empty = replace(bare, thumbnail_adu=None, rois=())
    found = [[has_images(one, wanted) for one in (frame, bare, empty)] for wanted in ("none", "frames", "all")]
    assert found == [[False, False, False], [True, False, False], [True, True, False]]
    assert [hdu.name for hdu in frame_images(frame, None, "frames")] == ["PRIMARY", "FRAME"]
