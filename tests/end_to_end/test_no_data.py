"""Gaps between chips and other areas of one value are masked; a trail across them is published whole, and no edge is."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from astropy.io import fits
from numpy.typing import NDArray

from sboc_e2e.outside.fits_frames import images_of, read_frame
from sboc_e2e.outside.no_data import MARGIN_PX, without_data
from tests.end_to_end.raw_camera import streaks_of
from tests.fuzz.outside import run

ROWS, COLS = 600, 800
SKY, NOISE = 1_000.0, 12.0
TRAIL = (140.0, 0.0, 460.0, 799.0)
"""Row and column where it enters and leaves; it crosses all gaps between columns."""


def gaps() -> NDArray[np.bool_]:
    """Between three columns of chips in two rows, of which the lower one is shifted; and a turned corner."""
    row, col = np.mgrid[:ROWS, :COLS]
    upper, lower = (np.abs((col + shift) % 270 - 200) < 9 for shift in (0, 60))
    return np.asarray(np.where(row < 300, upper, lower) | (np.abs(row - 300) < 8) | (row + 2 * col < 120))


def sky_image(seed: int, trail_adu: float = 0.0) -> NDArray[np.float64]:
    """Noise, 60 stars and a trail, ADU."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    light = rng.normal(SKY, NOISE, (ROWS, COLS))
    for r, c, flux in zip(rng.uniform(0, ROWS, 60), rng.uniform(0, COLS, 60), 10 ** rng.uniform(2.8, 5.5, 60), strict=True):
        light += flux / (2.0 * np.pi * 1.96) * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / 1.96)
    length = np.hypot(TRAIL[2] - TRAIL[0], TRAIL[3] - TRAIL[1])
    across = ((row - TRAIL[0]) * (TRAIL[3] - TRAIL[1]) - (col - TRAIL[1]) * (TRAIL[2] - TRAIL[0])) / length
    return np.asarray(light + trail_adu * np.exp(-0.5 * (across / 1.4) ** 2))


def mosaic(kind: str, seed: int, trail_adu: float = 0.0) -> NDArray[np.uint16] | NDArray[np.float32]:
    """A mosaic as files have it: counts, a stack in which -999 stands for nothing, and a picture that was coded as JPEG."""
    light = sky_image(seed, trail_adu)
    if kind == "stack":
        return np.where(gaps(), -999.0, light).astype(np.float32)
    if kind == "counts":
        return np.where(gaps(), 0.0, np.clip(light, 0, 65535)).astype(np.uint16)
    eight = np.where(gaps(), 0.0, np.clip((light - 900.0) / 2.5, 0.0, 255.0)).astype(np.uint8)
    done, coded = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, 90])
    assert done
    return cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE).astype(np.uint16)


def widened(area: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    """An area and what lies within some pixels of it."""
    return np.asarray(cv2.dilate(area.astype(np.uint8), np.ones((2 * by_px + 1, 2 * by_px + 1), np.uint8)) > 0)


@pytest.mark.parametrize(("kind", "blurred_px"), [("counts", 0), ("stack", 0), ("jpeg", 8)])
def test_gaps_are_masked_with_a_margin_and_nothing_else(kind: str, blurred_px: int) -> None:
    """JPEG codes blocks of 8 px, in which an edge is blurred."""
    found = without_data(mosaic(kind, 1, 200.0))
    assert found is not None
    assert found[gaps()].all()
    assert not found[~widened(gaps(), MARGIN_PX + blurred_px)].any()


def black_sky(rng: np.random.Generator) -> NDArray[np.float64]:
    """A sky that is cut off at black."""
    return np.clip(rng.normal(1.0, 3.0, (ROWS, COLS)), 0.0, None)


def dark_corners(_rng: np.random.Generator) -> NDArray[np.float64]:
    """A lens whose light fades to nothing."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    away = np.hypot(row - 300.0, col - 400.0)
    return np.asarray(np.clip(sky_image(2) * (1.0 - (away / 450.0) ** 2), 0.0, None))


def full_stars(rng: np.random.Generator) -> NDArray[np.float64]:
    """Stars with a full core of 30 px, dead columns, and hot pixels."""
    light = sky_image(3)
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    for r, c in rng.uniform(50, 550, (5, 2)):
        light = np.maximum(light, 65_535.0 * np.exp(15.0 - np.hypot(row - r, col - c)))
    light[:, 200:203] = 0.0
    light[rng.integers(0, ROWS, 50), rng.integers(0, COLS, 50)] = 60_000.0
    return np.clip(light, 0.0, 65_535.0)


@pytest.mark.parametrize("make", [black_sky, dark_corners, full_stars])
def test_what_was_measured_is_not_masked(make: object) -> None:
    """A sky at the end of the scale, light that fades, and bright or defective pixels."""
    assert callable(make)
    assert without_data(np.rint(make(np.random.default_rng(4))).astype(np.uint16)) is None


def test_frames_of_one_value_and_of_none() -> None:
    """Nothing tells sky from gap there."""
    assert without_data(np.zeros((ROWS, COLS), np.uint16)) is None
    assert without_data(np.full((ROWS, COLS), np.nan, np.float32)) is None
    assert without_data(np.full((3, 3), 7.0, np.float32)) is None


def test_a_frame_says_what_was_masked(tmp_path: Path) -> None:
    """In a note; the pixels are no numbers then."""
    fits.PrimaryHDU(mosaic("counts", 1)).writeto(tmp_path / "mosaic.fits")
    (place,) = images_of(tmp_path / "mosaic.fits")
    read = read_frame(place, 0)
    assert np.isnan(read.frame.pixels[gaps()]).all()
    (note,) = [note.text for note in read.notes if note.kind == "no data"]
    assert "gaps between chips" in note


@pytest.mark.parametrize("kind", ["counts", "jpeg"])
def test_a_trail_across_gaps_is_published_whole(kind: str, tmp_path: Path) -> None:
    """One line from border to border, and none in a blank mosaic."""
    for name, light in (("blank", 0.0), ("trail", 60.0)):
        (tmp_path / name).mkdir()
        fits.PrimaryHDU(mosaic(kind, 5, light)).writeto(tmp_path / name / "mosaic.fits")
        run(tmp_path / name, tmp_path / f"{name}-out")
        table, published = streaks_of(tmp_path / f"{name}-out")
        assert np.count_nonzero(published) == (light > 0.0)
        for each in table[published]:
            ends = sorted([(each["row0"], each["col0"]), (each["row1"], each["col1"])], key=lambda end: end[1])
            assert np.abs(np.ravel(ends) - TRAIL).max() < 4.0
