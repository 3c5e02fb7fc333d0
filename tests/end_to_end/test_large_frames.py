"""`sboc process` on frames of 9,000 px and on strips: trails found, memory bounded."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.icd.flags import StreakFlag

SKY_ADU, NOISE_ADU, SIGMA_PX = 300.0, 4.0, 1.2
HALF = 8

Trail = tuple[float, float, float, float]
"""Row and col of one end and of the other."""


def drawn(rows: int, cols: int, trails: list[Trail]) -> np.ndarray:
    """Sky, a star in each 20,000 px^2, and trails of 150 ADU per px of length."""
    rng = np.random.default_rng(rows + cols)
    image = rng.standard_normal((rows, cols), dtype=np.float32)
    image *= NOISE_ADU
    image += SKY_ADU
    n_stars = rows * cols // 20_000
    flux = 10.0 ** rng.uniform(2.5, 4.5, n_stars)
    spots = list(zip(rng.uniform(0, rows, n_stars), rng.uniform(0, cols, n_stars), flux, strict=True))
    for row0, col0, row1, col1 in trails:
        share = np.linspace(0.0, 1.0, round(2.0 * np.hypot(row1 - row0, col1 - col0)))
        spots += [(row0 + s * (row1 - row0), col0 + s * (col1 - col0), 75.0) for s in share]
    for row, col, light in spots:
        r, c = round(row), round(col)
        i, j = np.arange(max(r - HALF, 0), min(r + HALF + 1, rows)), np.arange(max(c - HALF, 0), min(c + HALF + 1, cols))
        if len(i) and len(j):
            shape = np.exp(-0.5 * (i[:, None] - row) ** 2 / SIGMA_PX**2) * np.exp(-0.5 * (j - col) ** 2 / SIGMA_PX**2)
            image[i[0] : i[-1] + 1, j[0] : j[-1] + 1] += (light / (2.0 * np.pi * SIGMA_PX**2) * shape).astype(np.float32)
    np.rint(image, out=image)
    return image.clip(0, 65535).astype(np.uint16)


def published(out: Path) -> Table:
    table = Table.read(out / "products" / "streaks.ecsv", format="ascii.ecsv")
    return table[(np.asarray(table["flags"]) & int(StreakFlag.VETOED)) == 0]


def peak_mb(arguments: list[str]) -> float:
    """Most memory that `sboc` held in a process of its own, looked up every 10 ms: its stages reset the kernel's own record."""
    child = subprocess.Popen([sys.executable, "-m", "sboc_e2e", *arguments], stdout=subprocess.DEVNULL)
    status, highest = Path(f"/proc/{child.pid}/status"), 0.0
    while child.poll() is None:
        if status.exists():
            held = [line for line in status.read_text().splitlines() if line.startswith("VmRSS:")]
            highest = max(highest, *(float(line.split()[1]) / 1024.0 for line in held), 0.0)
        time.sleep(0.01)
    assert child.returncode == 0
    return highest


def away_px(streaks: Table, trail: Trail) -> float:
    """How far the ends of the nearest streak are from a trail's."""
    ends = np.array([streaks[name] for name in ("row0", "col0", "row1", "col1")], dtype=float).T
    ways = [np.abs(ends - way).max(axis=1).min(initial=np.inf) for way in (trail, (*trail[2:], *trail[:2]))]
    return float(min(ways))


@pytest.mark.parametrize(
    ("rows", "cols", "trails"),
    [(9001, 64, [(4000.0, 12.0, 4120.0, 50.0)]), (64, 8999, [(10.0, 7000.0, 52.0, 7150.0)])],
    ids=["tall", "broad"],
)
@pytest.mark.slow
def test_strips_are_taken(tmp_path: Path, rows: int, cols: int, trails: list[Trail]) -> None:
    fits.PrimaryHDU(drawn(rows, cols, trails)).writeto(tmp_path / "strip.fits")
    assert cli.run(["process", str(tmp_path / "strip.fits"), "--out", str(tmp_path / "out"), "--wcs", "none"]) == 0
    streaks = published(tmp_path / "out")
    assert [away_px(streaks, trail) < 1.0 for trail in trails] == [True] * len(streaks)


@pytest.mark.slow
def test_a_frame_of_nine_thousand_pixels_a_side(tmp_path: Path) -> None:
    """81 million pixels, odd numbers of rows and columns; trails in the middle, in the last corner, over most of the frame."""
    trails = [(4400.0, 4500.0, 4500.0, 4790.0), (8800.0, 8700.0, 8980.0, 8985.0), (500.0, 8000.0, 8100.0, 1200.0)]
    fits.PrimaryHDU(drawn(9001, 8999, trails)).writeto(tmp_path / "large.fits")
    held_mb = peak_mb(["process", str(tmp_path / "large.fits"), "--out", str(tmp_path / "out"), "--wcs", "none"])
    streaks = published(tmp_path / "out")
    assert [away_px(streaks, trail) < 1.0 for trail in trails] == [True] * len(streaks)
    # the file's 162 MB, as float32 324: a handful of frames' worth (1,600 MB measured)
    assert held_mb < 2000.0
