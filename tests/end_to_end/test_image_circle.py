"""The image circle of an all-sky lens is found and masked with its rim; nothing is published there, and a trail inside is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from numpy.typing import NDArray
from scipy.special import erf

from ground.vetting.rim import ALONG_RIM_DEG, RIM, ImageCircle
from sboc_e2e.outside.fits_frames import images_of, read_frame
from sboc_e2e.outside.image_circle import MARGIN, beyond, image_circle
from tests.end_to_end.raw_camera import streaks_of
from tests.fuzz.outside import run

ROWS, COLS = 480, 640
CIRCLE = ImageCircle(row=228.0, col=331.0, radius_px=205.0)
TRAIL = (150.0, 300.0, 260.0, 400.0)
"""Row and column of both ends, inside the circle."""


def from_middle() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distance of each pixel from the circle's centre, and its angle."""
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    return np.hypot(row - CIRCLE.row, col - CIRCLE.col), np.arctan2(row - CIRCLE.row, col - CIRCLE.col)


def all_sky(seed: int, trail_adu: float = 0.0) -> NDArray[np.uint16]:
    """Sky in the circle with an edge of 2 px, roofs in a third of its rim, glow of a town in another, stars; dark corners."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:ROWS, :COLS].astype(float)
    away, angle = from_middle()
    inside = 0.5 * (1.0 - erf((away - CIRCLE.radius_px) / 2.0))
    light = 1_500.0 + 4_000.0 * np.exp(-0.5 * ((away - 200.0) / 4.0) ** 2) * (np.abs(angle - 0.9) < 0.5)
    roof = (away > 192.0 + 5.0 * np.sin(40.0 * angle)) & (np.abs(angle + 1.8) < 1.0)
    light = inside * np.where(roof, 60.0, light)
    for r, c, flux in zip(rng.uniform(0, ROWS, 150), rng.uniform(0, COLS, 150), 10 ** rng.uniform(2.8, 4.2, 150), strict=True):
        if np.hypot(r - CIRCLE.row, c - CIRCLE.col) < 185.0:
            light += flux / (2.0 * np.pi * 1.69) * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / 1.69)
    length = np.hypot(TRAIL[2] - TRAIL[0], TRAIL[3] - TRAIL[1])
    u, v = (TRAIL[2] - TRAIL[0]) / length, (TRAIL[3] - TRAIL[1]) / length
    along, across = (row - TRAIL[0]) * u + (col - TRAIL[1]) * v, (row - TRAIL[0]) * v - (col - TRAIL[1]) * u
    ends = 0.5 * (erf(along / 1.84) - erf((along - length) / 1.84))
    light += trail_adu * ends * np.exp(-0.5 * (across / 1.3) ** 2)
    return np.clip(np.round(rng.poisson(light) + rng.normal(300.0, 6.0, light.shape)), 0, 65535).astype(np.uint16)


def vignetted(kind: str) -> NDArray[np.float64]:
    """Frames with light in their middle and no rim: cos^4 of 60 deg, a nebula, a globular cluster, and the sky alone."""
    away, _ = from_middle()
    tangent = away / np.hypot(ROWS, COLS) * 2.0 * np.tan(np.radians(60.0))
    light = {
        "cos4": 2_000.0 * np.cos(np.arctan(tangent)) ** 4,
        "nebula": 2_000.0 * np.exp(-0.5 * (away / 120.0) ** 2),
        "cluster": 2_000.0 / (1.0 + (away / 60.0) ** 2),
        "sky": np.full(away.shape, 2_000.0),
    }[kind]
    return np.asarray(light + np.random.default_rng(1).normal(300.0, 20.0, light.shape))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_circle_is_found_to_two_per_cent(seed: int) -> None:
    """Roofs, a town and stars move it little; a frame with NaN in its corners and a larger one have it too."""
    image = all_sky(seed)
    holed = image.astype(np.float32)
    holed[:40, :40] = np.nan
    for pixels, scale in ((image, 1.0), (holed, 1.0), (np.kron(image, np.ones((2, 2), np.uint16)), 2.0)):
        found = image_circle(pixels)
        assert found is not None
        ours = np.array([CIRCLE.row, CIRCLE.col, CIRCLE.radius_px]) * scale
        assert np.abs(np.array([found.row, found.col, found.radius_px]) - ours).max() < 0.04 * CIRCLE.radius_px * scale


@pytest.mark.parametrize("kind", ["cos4", "nebula", "cluster", "sky"])
def test_what_has_no_rim_has_no_circle(kind: str) -> None:
    """Light that falls off smoothly is no edge of a lens."""
    assert image_circle(vignetted(kind)) is None
    assert image_circle(np.full((ROWS, COLS), np.nan)) is None
    assert image_circle(np.zeros((20, 30))) is None


def test_the_mask_has_the_circles_area() -> None:
    """pi r^2 of the part that is left."""
    seen = ~beyond(CIRCLE, (ROWS, COLS))
    assert seen.sum() == pytest.approx(np.pi * ((1.0 - MARGIN) * CIRCLE.radius_px) ** 2, rel=2e-3)


def line(away: float, turned_deg: float) -> Any:
    """A line of 40 px at a share of the radius from the centre, turned against the rim by an angle."""
    middle = np.array([CIRCLE.row, CIRCLE.col + away * CIRCLE.radius_px])
    step = 20.0 * np.array([np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))])
    ends = (*(middle - step), *(middle + step))
    return type("Fit", (), dict(zip(("row0", "col0", "row1", "col1"), ends, strict=True)) | {"length_px": 40.0})()


def test_lines_along_the_rim_are_refused_and_others_are_not() -> None:
    """Near the rim, by direction; in the middle none."""
    near, far = RIM + 0.05, RIM - 0.05
    assert CIRCLE.refuses(line(near, 0.0))
    assert CIRCLE.refuses(line(near, ALONG_RIM_DEG - 2.0))
    assert not CIRCLE.refuses(line(near, ALONG_RIM_DEG + 2.0))
    assert not CIRCLE.refuses(line(near, 90.0))
    assert not CIRCLE.refuses(line(far, 0.0))


def test_a_frame_comes_without_what_lies_beyond_its_circle(tmp_path: Path) -> None:
    """It says so in a note, and hands the circle on."""
    fits.PrimaryHDU(all_sky(3)).writeto(tmp_path / "sky.fits")
    (place,) = images_of(tmp_path / "sky.fits")
    read = read_frame(place, 0)
    assert read.circle is not None
    assert np.isnan(read.frame.pixels[:20, :20]).all()
    assert np.isfinite(read.frame.pixels[200:260, 300:360]).all()
    assert "circle" in {note.kind for note in read.notes}


def test_of_an_all_sky_picture_the_trail_is_published_and_nothing_of_the_rim(tmp_path: Path) -> None:
    """One trail, and a blank picture."""
    for name, light in (("blank", 0.0), ("trail", 250.0)):
        (tmp_path / name).mkdir()
        fits.PrimaryHDU(all_sky(4, light)).writeto(tmp_path / name / "sky.fits")
        run(tmp_path / name, tmp_path / f"{name}-out")
        table, published = streaks_of(tmp_path / f"{name}-out")
        assert np.count_nonzero(published) == (light > 0.0)
        for each in table[published]:
            ends = np.array([each[key] for key in ("row0", "col0", "row1", "col1")])
            assert np.abs(ends - TRAIL).max() < 5.0
