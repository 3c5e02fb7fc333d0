"""The rim of a vignetted field is taken out of a raw frame, and what crosses it stays."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from numpy.typing import NDArray

from sboc_e2e.outside.border_slopes import DEPTH_PX, noise_of, without_slopes
from tests.end_to_end.raw_camera import streaks_of
from tests.fuzz.outside import run

SIDE, SKY = 800, 900.0
TRAIL = (0.0, 250.0, 799.0, 560.0)
"""Row and column of both ends."""


def rim() -> NDArray[np.float64]:
    """Light that the optics let through: nothing beyond 40 px from a border, all from 120 px on; its edge is tilted by 1 deg."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    inside = [row + 0.017 * col, SIDE - 1 - row + 0.017 * col, col, SIDE - 1 - col]
    return np.asarray(np.prod([1.0 / (1.0 + np.exp(-(away - 80.0) / 12.0)) for away in inside], axis=0))


def frame(seed: int, through: NDArray[np.float64] | float, trail_e_px: float = 0.0) -> NDArray[np.uint16]:
    """Sky, 150 stars and a trail of sigma 1.4 px through such optics, 1 e-/ADU."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    light = np.full((SIDE, SIDE), SKY)
    for r, c, flux in zip(*rng.uniform(0, SIDE, (2, 150)), 10 ** rng.uniform(2.6, 4.5, 150), strict=True):
        part = np.s_[max(int(r) - 8, 0) : int(r) + 9, max(int(c) - 8, 0) : int(c) + 9]
        light[part] += flux / (2.0 * np.pi * 1.96) * np.exp(-0.5 * ((row[part] - r) ** 2 + (col[part] - c) ** 2) / 1.96)
    along = np.array([TRAIL[2] - TRAIL[0], TRAIL[3] - TRAIL[1]]) / np.hypot(TRAIL[2] - TRAIL[0], TRAIL[3] - TRAIL[1])
    across = (row - TRAIL[0]) * along[1] - (col - TRAIL[1]) * along[0]
    light += trail_e_px / (np.sqrt(2.0 * np.pi) * 1.4) * np.exp(-0.5 * (across / 1.4) ** 2)
    return np.clip(np.round(rng.poisson(light * through) + rng.normal(300.0, 5.0, light.shape)), 0, 65535).astype(np.uint16)


def test_the_rim_goes_and_light_that_crosses_it_stays() -> None:
    """The level of 16 px tiles, outside the round corners: 20 sigma of a pixel before, a fifth of one after."""
    image = frame(1, rim())
    flat, borders = without_slopes(image)
    assert borders == ("left", "right", "lower", "upper")
    tiles = np.median(flat.reshape(50, 16, 50, 16).swapaxes(1, 2).reshape(50, 50, -1), axis=-1)
    noise = noise_of(image)
    edge = np.concatenate([tiles[:8, 15:35].T, tiles[-8:, 15:35].T, tiles[15:35, :8], tiles[15:35, -8:]])
    bend = np.diff(edge, 2, axis=1)
    before = np.median(image.reshape(50, 16, 50, 16).swapaxes(1, 2).reshape(50, 50, -1), axis=-1)
    assert np.abs(np.diff(before[15:35, :8], 2, axis=1)).max() > 3.0 * noise
    assert np.sqrt(np.mean(bend**2)) < 0.3 * noise
    lit, _ = without_slopes(frame(1, rim(), trail_e_px=2_000.0))
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    near = np.abs((row - TRAIL[0]) * (TRAIL[3] - TRAIL[1]) - (col - TRAIL[1]) * (TRAIL[2] - TRAIL[0])) < 5.0 * 857.0
    rows = (row > 60.0) & (row < 240.0)
    kept = np.sum((lit - flat)[near & rows]) / np.sum(2_000.0 * rim()[near & rows] / 10.0)
    assert kept == pytest.approx(1.0, abs=0.04)


def test_frames_without_a_rim_stay_as_they_are() -> None:
    """A plain sky, one with a gentle fall to the corners as in telescopes of 0.35 m, and one that is too small."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    gentle = 1.0 - 0.15 * ((row - 400.0) ** 2 + (col - 400.0) ** 2) / 400.0**2
    for image in (frame(2, 1.0), frame(3, gentle), frame(4, rim())[: 3 * DEPTH_PX - 1]):
        same, borders = without_slopes(image)
        assert same is image
        assert borders == ()


def test_lines_of_the_rim_are_not_published_and_the_trail_is(tmp_path: Path) -> None:
    """With the rim left in, lines along it have S/N 100 to 300."""
    (tmp_path / "in").mkdir()
    for name, light in (("a", 0.0), ("b", 400.0)):
        hdu = fits.PrimaryHDU(frame(5, rim(), trail_e_px=light))
        hdu.header.update({"EXPTIME": 10.0, "GAIN": 1.0, "INSTRUME": name})
        hdu.writeto(tmp_path / "in" / f"{name}.fits")
    run(tmp_path / "in", tmp_path / "out")
    table, published = streaks_of(tmp_path / "out")
    (one,) = np.flatnonzero(published)
    assert table["frame"][one] == 1
    assert np.hypot(table["row1"] - table["row0"], table["col1"] - table["col0"])[one] > 700.0
    ingest = json.loads((tmp_path / "out" / "products" / "ingest.json").read_text(encoding="utf-8"))
    assert ["steep sky subtracted" in " ".join(each["notes"]) for each in ingest["outside"]["frames"]] == [True, True]
