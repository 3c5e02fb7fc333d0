"""Frames full of stars, drawn by numpy alone: what stars and an uneven sky leave is not sure, and faint trails are published."""

import math
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.icd.flags import StreakFlag
from tests.end_to_end.raw_camera import write
from tests.fuzz.outside import run

SIDE_PX = 512
SKY_E = 900.0
MOFFAT_BETA = 3.0
TRAIL_PX = 200.0
TRAIL_SNR = 12.0


def crowded(rng: np.random.Generator, density_px2: float, fwhm_px: float, unevenness: float) -> NDArray[np.float64]:
    """Mean light of a field: Moffat stars, 1 / flux of them from 60 e- on, over a sky with ripples of 12 px."""
    image = np.full((SIDE_PX, SIDE_PX), SKY_E)
    if unevenness > 0.0:
        wave = np.fft.fftfreq(SIDE_PX)
        smooth = np.exp(-2.0 * (math.pi * 12.0) ** 2 * (wave[:, None] ** 2 + wave**2))
        ripple = np.fft.ifft2(np.fft.fft2(rng.normal(size=image.shape)) * smooth).real
        image *= 1.0 + unevenness * ripple / ripple.std()
    core = 0.5 * fwhm_px / math.sqrt(2.0 ** (1.0 / MOFFAT_BETA) - 1.0)
    peak = (MOFFAT_BETA - 1.0) / (math.pi * core**2)
    n = rng.poisson(density_px2 * (SIDE_PX + 80) ** 2)
    flux_e = 60.0 * np.minimum(1.0 / rng.random(n), 4e4)
    for (row, col), flux in zip(rng.uniform(-40.0, SIDE_PX + 40.0, (n, 2)), flux_e, strict=True):
        reach = int(np.clip(3.0 * fwhm_px * (flux * peak / (0.1 * math.sqrt(SKY_E))) ** (0.5 / MOFFAT_BETA), 6.0, 120.0))
        rows, cols = (np.arange(max(0, int(at) - reach), min(SIDE_PX, int(at) + reach + 1)) for at in (row, col))
        if rows.size and cols.size:
            away2 = (rows[:, None] - row) ** 2 + (cols - col) ** 2
            image[np.ix_(rows, cols)] += flux * peak * (1.0 + away2 / core**2) ** -MOFFAT_BETA
    return image


def with_trail(
    image: NDArray[np.float64], rng: np.random.Generator, fwhm_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same with a trail of `TRAIL_SNR` against the noise of the sky, and the trail's middle (row, col)."""
    sigma = fwhm_px / 2.355
    height = TRAIL_SNR * math.sqrt(SKY_E) / math.sqrt(TRAIL_PX * math.sqrt(math.pi) * sigma)
    angle, middle = rng.uniform(0.0, math.pi), rng.uniform(150.0, SIDE_PX - 150.0, 2)
    away = np.moveaxis(np.mgrid[:SIDE_PX, :SIDE_PX], 0, -1) - middle
    along, across = away @ [math.sin(angle), math.cos(angle)], away @ [math.cos(angle), -math.sin(angle)]
    return image + height * np.exp(-0.5 * (across / sigma) ** 2) * (np.abs(along) < 0.5 * TRAIL_PX), middle


def judged(image: NDArray[np.float64], rng: np.random.Generator, folder: Path) -> Table:
    """What `sboc process` publishes of an exposure of this light."""
    counts = rng.poisson(image) + rng.normal(200.0, 5.0, image.shape)
    write(folder / "in" / "a.fits", np.clip(np.round(counts), 0.0, 65535.0).astype(np.uint16))
    run(folder / "in", folder / "out")
    table = Table.read(folder / "out" / "products" / "streaks.ecsv", format="ascii.ecsv")
    return table[[not int(flags) & StreakFlag.VETOED for flags in table["flags"]]]


@pytest.mark.slow
@pytest.mark.parametrize(("density_px2", "fwhm_px"), [(0.004, 2.4), (0.016, 2.4), (0.016, 4.0)])
def test_what_a_crowded_field_leaves_is_not_sure_and_a_faint_trail_across_it_is_published(
    density_px2: float, fwhm_px: float, tmp_path: Path
) -> None:
    """1,000 and 4,000 stars in 512 x 512 px. Where 1,000 stars are 4 px wide, too few tell the PSF, and faint trails
    are refused (docs/real-frames.md, "Faint trails without a PSF")."""
    rng = np.random.default_rng([91, int(1e4 * density_px2), int(10 * fwhm_px)])
    uneven = judged(crowded(rng, density_px2, fwhm_px, 0.01), rng, tmp_path / "uneven")
    assert not np.any(uneven["probability"] >= 0.9)
    image, middle = with_trail(crowded(rng, density_px2, fwhm_px, 0.0), rng, fwhm_px)
    table = judged(image, rng, tmp_path / "trail")
    centre = np.array([[0.5 * (s["row0"] + s["row1"]), 0.5 * (s["col0"] + s["col1"])] for s in table]).reshape(-1, 2)
    on = np.hypot(*(centre - middle).T) < 0.25 * TRAIL_PX
    assert np.max(table["probability"][on], initial=0.0) > 0.9
