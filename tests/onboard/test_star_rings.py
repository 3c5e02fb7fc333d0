"""Light that stars leave around them in the tracker's image is taken off in the mean; nothing else changes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.track.star_rings import REACH_PX, take_off
from sboc_e2e.icd.signals import UNKNOWN, StarList, StarMotion

SIDE = 900
LEFT = 6.0
"""Sixteenths of a sigma that every star leaves at a distance of 1.5 to 3 px."""


def sky(seed: int, motion: StarMotion | None = None) -> tuple[NDArray[np.int8], NDArray[np.bool_], StarList]:
    """Noise with 900 stars on a grid, far apart but for their phases, with what they leave; where; and the stars."""
    rng = np.random.default_rng(seed)
    row, col = (c.ravel() + rng.uniform(-0.5, 0.5, c.size) for c in np.mgrid[15 : SIDE - 14 : 30, 15 : SIDE - 14 : 30])
    light, lit = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE), dtype=np.bool_)
    image = rng.normal(0.0, 16.0, (SIDE, SIDE))
    i, j = np.mgrid[:SIDE, :SIDE]
    for r, c in zip(row, col, strict=True):
        near = np.s_[int(r) - 6 : int(r) + 8, int(c) - 6 : int(c) + 8]
        away = np.hypot(i[near] - r, j[near] - c)
        light[near] += LEFT * ((away > 1.5) & (away < 3.0))
        lit[near] |= away < REACH_PX + 1.0
        image[near][away < 1.0] = np.inf
    codes = np.where(np.isinf(image), UNKNOWN, np.clip(np.rint(image + light), -127, 127)).astype(np.int8)
    n = row.size
    stars = StarList(
        row=row,
        col=col,
        flux_e=np.full(n, 500.0, np.float32),
        snr=np.full(n, 20.0, np.float32),
        flags=np.zeros(n, np.uint8),
        motion=motion,
    )
    return codes, light > 0.0, stars


def test_what_all_stars_leave_is_gone_in_the_mean() -> None:
    image, lit, stars = sky(1)
    before = image.copy()
    assert before[lit & (before != UNKNOWN)].mean() == pytest.approx(LEFT, abs=0.7)
    take_off(image, stars)
    assert image[lit & (image != UNKNOWN)].mean() == pytest.approx(0.0, abs=0.7)  # rings are 0.3 px wide there, edges smear
    assert ((image == UNKNOWN) == (before == UNKNOWN)).all()
    i, j = np.mgrid[:SIDE, :SIDE]
    far = np.ones((SIDE, SIDE), dtype=np.bool_)
    for r, c in zip(stars.row, stars.col, strict=True):
        near = np.s_[int(r) - 6 : int(r) + 8, int(c) - 6 : int(c) + 8]
        far[near] &= np.hypot(i[near] - r, j[near] - c) >= REACH_PX
    assert set(np.unique(image[far].astype(int) - before[far])) == {0, 1}


def test_the_level_of_a_tile_stays() -> None:
    """What is taken off goes back to all pixels alike, along rows, columns and diagonals: a trail must not lie in a hollow."""
    image, lit, stars = sky(4)
    before = image.copy()
    take_off(image, stars)
    known = before != UNKNOWN
    for tile in (np.s_[:256, :256], np.s_[512:768, 256:512]):
        assert image[tile][known[tile]].mean() == pytest.approx(
            before[tile][known[tile]].mean(), abs=0.03
        )  # of 0.15, by stars on borders
    i, j = np.mgrid[:SIDE, :SIDE]
    reach = REACH_PX + 3.0
    far = known & ~lit & (np.abs((i - 15) % 30 - 15) < 15 - reach) & (np.abs((j - 15) % 30 - 15) < 15 - reach)
    share = (image[far].astype(int) - before[far]).mean()
    assert 0.05 < share < 0.3
    for lines in (i, j, i + j, i - j):
        line = lines[far] - lines.min()
        n, raised = np.bincount(line), np.bincount(line, image[far].astype(int) - before[far])
        assert np.abs(raised[n > 200] / n[n > 200] - share).max() < 0.1


def test_a_few_stars_tell_no_mean_and_nothing_is_taken_off() -> None:
    image, _, stars = sky(2)
    few = StarList(**{name: getattr(stars, name)[:5] for name in ("row", "col", "flux_e", "snr", "flags")})
    before = image.copy()
    take_off(image, few)
    assert (image == before).all()


def test_nothing_is_taken_off_where_stars_are_trails() -> None:
    image, _, stars = sky(3, StarMotion(drow=30.0, dcol=4.0, turn_rad=0.0, middle_row=450.0, middle_col=450.0))
    before = image.copy()
    take_off(image, stars)
    assert (image == before).all()
