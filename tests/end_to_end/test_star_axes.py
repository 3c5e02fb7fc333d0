"""Stars that the turning sky draws out along one direction tell the optics by their short axis."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ground.vetting.look_alikes import as_sharp_as
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import DetectorView, StarList
from sboc_e2e.outside.star_axes import StarAxes
from tests.benchmarks.detection_frames import Scene, view_of

SIDE, STARS = 256, 40


def view_with_stars(sigma_px: float, drawn_px: float, flags: int = 0, n: int = STARS) -> DetectorView:
    """Stars of S/N above 100, drawn out along the diagonal, pixels integrated to first order."""
    rng = np.random.default_rng(8)
    row, col = rng.uniform(20.0, SIDE - 20.0, (2, n))
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    image = rng.normal(0.0, 1.0, (SIDE, SIDE))
    width2 = sigma_px**2 + 1.0 / 12.0
    for r, c in zip(row, col, strict=True):
        for share in np.linspace(-0.5, 0.5, 13):
            away = (y - r - share * drawn_px * 0.6) ** 2 + (x - c - share * drawn_px * 0.8) ** 2
            image += 200.0 / 13.0 * np.exp(-0.5 * away / width2)
    ones = np.ones(n, np.float32)
    stars = StarList(row=row, col=col, flux_e=ones, snr=100.0 * ones, flags=np.full(n, flags, np.uint8))
    return replace(view_of(Scene(image=image.astype(np.float32))), stars=stars)


@pytest.mark.parametrize(("sigma_px", "drawn_px"), [(0.7, 0.0), (0.7, 4.0), (1.2, 5.0), (1.5, 0.0)])
def test_the_short_axis_is_that_of_the_optics(sigma_px: float, drawn_px: float) -> None:
    """To 8 %, whatever the stars are drawn out by: half of them are as sharp as this or sharper, noise in it."""
    axes = StarAxes.of(view_with_stars(sigma_px, drawn_px))
    assert axes is not None
    assert axes.short_px == pytest.approx(sigma_px, rel=0.08)


@pytest.mark.parametrize(("drawn_px", "points"), [(0.0, True), (3.0, True), (4.0, True), (8.0, False), (30.0, False)])
def test_stars_that_are_drawn_out_by_half_the_shortest_line_are_none_of_the_lines(drawn_px: float, points: bool) -> None:
    """Stars of sigma 1.2 px; the length is 1.0 to 1.35 times the true one, and noise gives a round star 1 px at most."""
    axes = StarAxes.of(view_with_stars(1.2, drawn_px))
    if drawn_px > 20.0:
        assert axes is None or not axes.are_points, "no image of a long trail settles"
        return
    assert axes is not None
    assert axes.are_points is points
    assert drawn_px <= axes.drawn_px <= max(1.35 * drawn_px, 1.0)


def test_few_stars_and_hot_pixels_tell_nothing() -> None:
    assert StarAxes.of(view_with_stars(0.7, 4.0, n=3)) is None
    assert StarAxes.of(view_with_stars(0.7, 4.0, flags=StarFlag.COSMIC_LIKE)) is None


@pytest.mark.parametrize(("psf_sigma_px", "told"), [(1.4, 0.6), (0.5, 0.5), (None, None)])
def test_only_a_known_width_becomes_sharper(psf_sigma_px: float | None, told: float | None) -> None:
    """A satellite of 0.4 px, S/N 154, was too sharp for stars of 1.4 px, which the sky had drawn out. Where stars told no width
    nothing changes."""
    fit: Any = view_of(Scene(image=np.zeros((64, 64), np.float32)))  # any record with a PSF of its own
    fit = replace(fit, psf_sigma_px=1.3)
    frame: Any = replace(fit, psf_sigma_px=psf_sigma_px)
    sharp, seen = as_sharp_as(0.6, [fit], frame)
    assert seen.psf_sigma_px == told
    assert sharp[0].psf_sigma_px == (0.6 if told == 0.6 else 1.3)
