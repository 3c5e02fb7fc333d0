"""Entries of the star list that are pieces of a trail, drawn here, not by the simulator."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.detect.star_mask import pieces_across, trail_pieces

SIDE, PSF_SIGMA_PX = 200, 1.2


def pieces(light: NDArray[np.float64], places: NDArray[np.float64], *, psf_known: bool, times: float = 1.0) -> NDArray[np.bool_]:
    """Of light (rows, cols) in sigmas, over white noise, with entries at some places (n, 2: row, col).

    times : flux that is listed over that of the PSF at the place.
    """
    image = (light + np.random.default_rng(1).normal(size=light.shape)).astype(np.float32)
    row, col = np.mgrid[-6:7, -6:7]
    near = np.rint(places).astype(int)[:, :, None, None] + np.stack([row, col])
    template = np.exp(-0.5 * (row**2 + col**2) / PSF_SIGMA_PX**2)
    snr = times * (image[near[:, 0], near[:, 1]] * template).sum(axis=(1, 2)) / np.sqrt((template**2).sum())
    no_smooth, sigma = np.zeros((SIDE, SIDE), np.int8), np.ones((4, 4), np.float32)
    return trail_pieces(image, no_smooth, sigma, 64, *places.T.copy(), snr.astype(np.float32), PSF_SIGMA_PX, psf_known)


@pytest.mark.parametrize("sigma_px", [0.4, 0.6, 1.2])
def test_entries_along_a_line_that_is_narrower_than_what_is_assumed_are_its_pieces(sigma_px: float) -> None:
    """A meteor of 150 px, one pixel wide, 50 sigma in each, was listed as thirty stars and masked, in a picture without a PSF.

    With 1.2 px assumed, light beside an entry seemed too bright to be of its line.
    """
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    slope = 0.4
    across = (col - 60.0 - slope * (row - 30.0)) / np.hypot(1.0, slope)
    light = 60.0 * np.exp(-0.5 * (across / sigma_px) ** 2) * ((row > 30.0) & (row < 170.0))
    rows = np.arange(45.0, 155.0, 4.0)
    places = np.column_stack([rows, 60.0 + slope * (rows - 30.0)])
    assert pieces(light, places, psf_known=False).mean() > 0.9


def test_stars_are_no_pieces_of_trails() -> None:
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    places = np.random.default_rng(2).uniform(10.0, SIDE - 10.0, (25, 2))
    light = sum(50.0 * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / PSF_SIGMA_PX**2) for r, c in places)
    for psf_known in (True, False):
        assert pieces(np.asarray(light), places, psf_known=psf_known).mean() < 0.1


@pytest.mark.parametrize("psf_known", [True, False])
def test_entries_whose_flux_counts_the_wings_of_a_wide_line_are_its_pieces(psf_known: bool) -> None:
    """A trail of 557 px, S/N 10,000 and twice the PSF's width was masked whole: fits gave its entries 2.5 times their light."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    slope = 0.4
    across = (col - 60.0 - slope * (row - 30.0)) / np.hypot(1.0, slope)
    light = 200.0 * np.exp(-0.5 * (across / (2.0 * PSF_SIGMA_PX)) ** 2)
    rows = np.arange(45.0, 155.0, 4.0)
    places = np.column_stack([rows, 60.0 + slope * (rows - 30.0)])
    assert pieces(light, places, psf_known=psf_known, times=2.5).mean() > 0.9


@pytest.mark.parametrize("psf_known", [True, False])
def test_entries_in_a_patch_of_light_are_no_pieces(psf_known: bool) -> None:
    """Light of a nebula goes on on every side, and an entry's flux may count much of it."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    light = 200.0 * np.exp(-0.5 * ((row - 100.0) ** 2 + (col - 100.0) ** 2) / 30.0**2)
    places = 100.0 + np.random.default_rng(3).uniform(-10.0, 10.0, (25, 2))
    assert pieces(light, places, psf_known=psf_known, times=2.5).mean() < 0.1


@pytest.mark.parametrize(("slope", "way_px"), [(2.0, 10.0), (0.1, 5.0)])
def test_entries_on_a_line_that_the_stars_do_not_follow_are_its_pieces(slope: float, way_px: float) -> None:
    """Meteors among trailed stars were listed as trailed stars and masked. Stars stay, also where two follow each other.

    Where stars move by a few pixels along the columns, a line may run along them: no star is as long.
    """
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    step = np.array([slope, 1.0]) / np.hypot(slope, 1.0)
    along = (row - 100.0) * step[0] + (col - 100.0) * step[1]
    light = 30.0 * np.exp(-0.5 * ((row - 100.0) * step[1] - (col - 100.0) * step[0]) ** 2) * (np.abs(along) < 70.0)
    stars = np.array([[50.0, 120.0], [50.0, 119.0 - way_px], [60.0, 170.0], [150.0, 40.0], [140.0, 170.0]])
    for r, c in stars:
        light += 40.0 * np.exp(-0.5 * (row - r) ** 2) * (np.abs(col - c) < 0.5 * way_px)
    image = (light + np.random.default_rng(5).normal(size=light.shape)).astype(np.float32)
    on_line = 100.0 + np.arange(-50.0, 51.0, 5.0)[:, None] * step
    places = np.concatenate([on_line, stars])
    way = np.zeros(len(places)), np.full(len(places), way_px)
    told = pieces_across(image, np.ones((4, 4), np.float32), 64, *places.T.copy(), *way)
    assert told[: len(on_line)].mean() > 0.9
    assert not told[len(on_line) :].any()


def test_a_line_that_flickers_is_still_one_and_a_row_of_far_dots_is_not() -> None:
    """Blocks of JPEG left a third of a meteor's light at every tenth pixel: six entries on it were masked as trailed stars."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    step = np.array([2.0, 1.0]) / np.hypot(2.0, 1.0)
    along = (row - 100.0) * step[0] + (col - 100.0) * step[1]
    line = 30.0 * np.exp(-0.5 * ((row - 100.0) * step[1] - (col - 100.0) * step[0]) ** 2) * (np.abs(along) < 70.0)
    noise = np.random.default_rng(5).normal(size=line.shape)
    places = 100.0 + np.arange(-40.0, 41.0, 10.0)[:, None] * step
    way = np.zeros(len(places)), np.full(len(places), 10.0)
    shares = []
    for dark_px in (0.0, 2.0, 7.0):  # of each 10 px, midway between the entries
        light = np.where(np.abs((along % 10.0) - 5.0) < 0.5 * dark_px, 0.3, 1.0) * line
        told = pieces_across((light + noise).astype(np.float32), np.ones((4, 4), np.float32), 64, *places.T.copy(), *way)
        shares.append(told.mean())
    assert min(shares[:2]) > 0.9
    assert shares[2] < 0.1
