"""Frames of one camera calibrate each other: dust rings, vignetting and hot pixels go, trails and stars stay."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.fixed_pattern import MutuallyCalibrated, fixed_pattern
from tests.end_to_end.raw_camera import CLEAN, TRAIL, Pattern, dusty, raw_frame, streaks_of, write
from tests.fuzz.outside import run


def notes_of(folder: Path) -> list[str]:
    return [each.notes[-1].text for each in MutuallyCalibrated(source=FitsFolder(path=folder)).frames()]


def test_false_lines_go_and_the_trail_stays(tmp_path: Path) -> None:
    """Two frames have five lines and more that are not there; four of the same camera have the trail and nothing else."""
    pattern = dusty(1)
    for k in range(4):
        write(tmp_path / "four" / f"{k}.fits", raw_frame(k, pattern, sky=k, trail_e_px=150.0 if k == 1 else 0.0))
    for k in (0, 2):
        write(tmp_path / "two" / f"{k}.fits", raw_frame(k, pattern, sky=k))
    run(tmp_path / "two", tmp_path / "out-two")
    run(tmp_path / "four", tmp_path / "out-four")
    write(tmp_path / "alone" / "1.fits", raw_frame(1, pattern, sky=1, trail_e_px=150.0))
    run(tmp_path / "alone", tmp_path / "out-alone")
    assert len(streaks_of(tmp_path / "out-two")[0]) >= 4
    table, published = streaks_of(tmp_path / "out-four")
    assert len(table) == 1
    assert published.all()
    streak = table[0]
    assert streak["frame"] == 1
    ends = np.array([[streak["row0"], streak["col0"]], [streak["row1"], streak["col1"]]])
    true = np.array(TRAIL).reshape(2, 2)
    if np.linalg.norm(ends - true) > np.linalg.norm(ends[::-1] - true):
        ends = ends[::-1]
    assert np.abs(ends - true).max() < 2.0
    alone, _ = streaks_of(tmp_path / "out-alone")
    assert streak["snr"] > 0.8 * alone["snr"].max(), "four frames' median takes a part of its light"
    assert streak["probability"] > 0.9
    ingest = json.loads((tmp_path / "out-four" / "products" / "ingest.json").read_text(encoding="utf-8"))
    assert all("fixed pattern of 4 frames" in frame["notes"][-1] for frame in ingest["outside"]["frames"])


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_frames_are_said_to_be(tmp_path: Path, n: int) -> None:
    for k in range(n):
        write(tmp_path / f"{k}.fits", raw_frame(k, dusty(1), sky=k))
    assert notes_of(tmp_path) == [f"{n} frame{'s' * (n > 1)} of this camera: a fixed pattern needs 3"] * n
    (first, *_) = MutuallyCalibrated(source=FitsFolder(path=tmp_path)).frames()
    assert first.frame.pixels.dtype == np.uint16, "as it came"


def test_cameras_are_not_mixed(tmp_path: Path) -> None:
    for k in range(3):
        write(tmp_path / f"{k}.fits", raw_frame(k, dusty(1), sky=k), camera="one")
    write(tmp_path / "z.fits", raw_frame(9, dusty(2), sky=9), camera="other")
    ingest = notes_of(tmp_path)
    assert all(text.startswith("fixed pattern of 3 frames") for text in ingest[:3])
    assert ingest[3] == "1 frame of this camera: a fixed pattern needs 3"


def test_frames_without_a_pattern_in_common_stay_as_they_are(tmp_path: Path) -> None:
    for k in range(3):
        write(tmp_path / f"{k}.fits", raw_frame(k, CLEAN, sky=k))
    assert notes_of(tmp_path) == ["3 frames of this camera show no fixed pattern in common"] * 3


def test_the_pattern_is_the_camera_s() -> None:
    """Against the pattern that was put in: the flat's excess to 0.4 % rms of the level (a frame's noise is 2.2 %), and 95 % of
    hot pixels of ten sigma and more, with fewer than five others."""
    flat, dark = dusty(3)
    found = fixed_pattern([raw_frame(k, (flat, dark), sky=k) for k in range(5)])
    assert found is not None
    true = (1500.0 * flat + 300.0) / np.median(1500.0 * flat + 300.0) - 1.0
    rest = (found.excess - true)[~found.hot & (dark == 0.0)]
    assert np.std(rest) < 0.004 < 0.5 * np.std(true)
    bright = dark > 10.0 * np.sqrt(1500.0)
    assert found.hot[bright].mean() > 0.95
    assert (found.hot & (dark == 0.0)).sum() < 5


@pytest.mark.parametrize("radius_px", [None, 125.0])
def test_hot_pixels_are_found_in_frames_of_which_most_is_masked(radius_px: float | None) -> None:
    """Five frames of an all-sky camera whose circle fills 38 % of them: masked pixels are alike and say nothing of the noise.

    All 30 hot pixels, of 27 to 80 sigma of a frame's noise of 3.7 %, and at most two others; as many as without a mask.
    """
    rng = np.random.default_rng(12)
    row, col = np.mgrid[:270, :480].astype(float)
    away = np.hypot(row - 134.5, col - 239.5)
    dark = np.zeros(row.shape)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, 30), rng.uniform(5.0, 115.0, 30)
    at = np.round(134.5 + radius * np.sin(angle)).astype(int), np.round(239.5 + radius * np.cos(angle)).astype(int)
    dark[at] = rng.uniform(1000.0, 3000.0, 30)
    n_hot = int((dark > 0.0).sum())
    frames = rng.poisson(700.0 * (1.0 - 0.3 * (away / 275.0) ** 2) + dark, (5, *row.shape)) + rng.normal(
        100.0, 6.0, (5, *row.shape)
    )
    if radius_px is not None:
        frames[:, away > radius_px] = np.nan
        assert np.isnan(frames).mean() > 0.6
    found = fixed_pattern(list(frames.astype(np.float32)))
    assert found is not None
    assert found.hot[dark > 0.0].sum() == n_hot == 30
    assert found.hot.sum() <= n_hot + 2


def test_frames_of_next_to_no_pixels_have_no_pattern() -> None:
    """12 x 12 px are left, with 132 pairs of neighbours in rows: a gradient in common to all, and no noise to hold it against."""
    frames = np.full((3, 64, 64), np.nan, dtype=np.float32)
    frames[:, :12, :12] = 1000.0 - 10.0 * np.arange(12.0) + np.random.default_rng(2).normal(0.0, 5.0, (3, 12, 12))
    assert fixed_pattern(list(frames)) is None


@pytest.mark.parametrize("pattern", [dusty(1), CLEAN])
def test_a_blank_frame_agrees_with_no_pattern(pattern: Pattern) -> None:
    """Of three frames the one that makes a half alone has the same number everywhere; what the others show is not confirmed."""
    images = [raw_frame(k, pattern, sky=k) for k in range(3)]
    images[1] = np.full_like(images[1], 1800)
    assert fixed_pattern(images) is None


def test_stars_of_a_sky_that_stays_are_no_pattern(tmp_path: Path) -> None:
    """A telescope that follows the stars, with dust: as many stars as one clean frame shows, within a tenth."""
    found = {}
    for name, n, pattern in (("together", 4, dusty(1)), ("clean", 1, CLEAN)):
        for k in range(n):
            write(tmp_path / name / f"{k}.fits", raw_frame(k, pattern, sky=4))
        run(tmp_path / name, tmp_path / f"out-{name}")
        frames = Table.read(tmp_path / f"out-{name}" / "products" / "frames.ecsv", format="ascii.ecsv")
        found[name] = int(frames["n_stars_found"][0])
    assert found["clean"] > 60
    assert abs(found["together"] - found["clean"]) <= 0.1 * found["clean"]
