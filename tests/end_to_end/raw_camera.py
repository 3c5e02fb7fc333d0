"""Raw frames of a camera that nobody calibrated: dust rings, vignetting, warm columns, hot pixels, stars that move, a trail."""

from pathlib import Path
from typing import Final

import numpy as np
from astropy.io import fits
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.icd.flags import StreakFlag

SIDE_PX: Final = 512
PSF_SIGMA_PX: Final = 1.4
SKY_E: Final = 1500.0
TRAIL: Final = (100.0, 60.0, 400.0, 430.0)
"""Row and column of both ends."""

Pattern = tuple[NDArray[np.float64], NDArray[np.float64]]
CLEAN: Final[Pattern] = (np.ones((SIDE_PX, SIDE_PX)), np.zeros((SIDE_PX, SIDE_PX)))


def dusty(seed: int, *, rings: int = 25, depth: float = 0.03) -> Pattern:
    """What multiplies and what is added to the light: a flat with rings of dust, six warm columns, 60 hot pixels."""
    rng = np.random.default_rng([77, seed])
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX].astype(float)
    flat = 1.0 - 0.15 * ((row - SIDE_PX / 2) ** 2 + (col - SIDE_PX / 2) ** 2) / (SIDE_PX**2 / 2)
    for _ in range(rings):
        row0, col0 = rng.uniform(0, SIDE_PX, 2)
        radius, width = rng.uniform(8, 25), rng.uniform(2, 4)
        away = np.hypot(row - row0, col - col0) - radius
        flat -= depth * np.exp(-0.5 * (away / width) ** 2) - 0.5 * depth * np.exp(-0.5 * ((away - 2.0 * width) / width) ** 2)
    for column in rng.integers(0, SIDE_PX, 6):
        flat[:, column] += rng.uniform(0.005, 0.02)
    dark = np.zeros((SIDE_PX, SIDE_PX))
    places = rng.integers(0, SIDE_PX, (60, 2))
    dark[places[:, 0], places[:, 1]] = rng.uniform(200, 5000, 60)
    return flat, dark


def _add(image: NDArray[np.float64], row: float, col: float, light_e: float) -> None:
    top, left = int(row) - 8, int(col) - 8
    if not (0 <= top < SIDE_PX - 17 and 0 <= left < SIDE_PX - 17):
        return
    rows, cols = np.mgrid[top : top + 17, left : left + 17]
    image[top : top + 17, left : left + 17] += (
        light_e / (2.0 * np.pi * PSF_SIGMA_PX**2) * np.exp(-0.5 * ((rows - row) ** 2 + (cols - col) ** 2) / PSF_SIGMA_PX**2)
    )


def raw_frame(seed: int, pattern: Pattern = CLEAN, *, sky: int, trail_e_px: float = 0.0) -> NDArray[np.uint16]:
    """A frame of 1 e-/ADU. sky : seed of its 120 stars. trail_e_px : light of `TRAIL` on each of its pixels of length."""
    stars, rng = np.random.default_rng([79, sky]), np.random.default_rng([80, seed])
    light = np.zeros((SIDE_PX, SIDE_PX))
    for (row, col), flux in zip(stars.uniform(0, SIDE_PX, (120, 2)), 10 ** stars.uniform(2.6, 5.0, 120), strict=True):
        _add(light, row, col, flux)
    if trail_e_px > 0.0:
        steps = int(2.0 * np.hypot(TRAIL[2] - TRAIL[0], TRAIL[3] - TRAIL[1]))
        for share in np.linspace(0.0, 1.0, steps):
            row, col = TRAIL[0] + share * (TRAIL[2] - TRAIL[0]), TRAIL[1] + share * (TRAIL[3] - TRAIL[1])
            _add(light, row, col, 0.5 * trail_e_px)
    flat, dark = pattern
    counts = rng.poisson(np.maximum((SKY_E + light) * flat + dark, 0.0)) + rng.normal(300.0, 6.0, light.shape)
    return np.clip(np.round(counts), 0, 65535).astype(np.uint16)


def write(path: Path, image: NDArray[np.uint16], camera: str = "one") -> None:
    """A frame as a FITS file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    hdu = fits.PrimaryHDU(image)
    hdu.header.update({"EXPTIME": 10.0, "GAIN": 1.0, "INSTRUME": camera})
    hdu.writeto(path)


def streaks_of(run: Path) -> tuple[Table, NDArray[np.bool_]]:
    """Measured streaks of a run, and which of them are published."""
    table = Table.read(run / "products" / "streaks.ecsv", format="ascii.ecsv")
    return table, np.array([not int(flags) & StreakFlag.VETOED for flags in table["flags"]], dtype=bool)
