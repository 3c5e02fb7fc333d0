"""Two or three trails of stars nearly on one line are no trail of an object; a satellite among such stars is one."""

import math
from typing import Any

import numpy as np
import pytest

from ground.vetting.star_trails import against_chains, move_as
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import StarMotion

LENGTH_PX = 33.0
MOTION = StarMotion(drow=0.0, dcol=LENGTH_PX, turn_rad=0.0, middle_row=255.5, middle_col=255.5)


def fit(length_px: float, off_deg: float, snr: float = 60.0, row: float = 250.0, col: float = 250.0) -> Any:
    """A line of this length about a place, so far off the direction of the stars."""
    d_row, d_col = (0.5 * length_px * f(math.radians(off_deg)) for f in (math.sin, math.cos))
    ends = {"row0": row - d_row, "col0": col - d_col, "row1": row + d_row, "col1": col + d_col}
    return type("Fit", (), ends | {"length_px": length_px, "snr": snr, "flags": StreakFlag(0)})()


def stars(n: int, snr: float = 60.0) -> list[Any]:
    """Single trails all over the frame, to 1 px and 1 deg."""
    rng = np.random.default_rng(5)
    return [
        fit(LENGTH_PX + rng.normal(), rng.normal(), snr * math.exp(rng.normal()), *rng.uniform(40.0, 470.0, 2)) for _ in range(n)
    ]


def drawn_chains(n_stars: int, seed: int) -> list[Any]:
    """Lines from the first end of a star's trail to the last one of another that nearly goes on from it, in a frame of 512 px."""
    rng = np.random.default_rng(seed)
    row, col = rng.uniform(30.0, 480.0, (2, n_stars))
    out = []
    for i in range(n_stars):
        for j in range(n_stars):
            gap, aside = col[j] - col[i] - LENGTH_PX, row[j] - row[i]
            if -0.5 * LENGTH_PX < gap < 0.5 * LENGTH_PX and abs(aside) < 4.0:
                off = math.degrees(math.atan2(aside, gap + 2.0 * LENGTH_PX))
                length = math.hypot(aside, gap + 2.0 * LENGTH_PX)
                out.append(fit(length, off, 80.0, 0.5 * (row[i] + row[j]), 0.5 * (col[i] + col[j])))
    return out


def test_chains_of_two_stars_are_many_where_stars_are() -> None:
    """Each is as likely as 20 objects and more. Of 24 drawn ones none is a single star by its length."""
    chains = drawn_chains(200, 7)
    assert len(chains) > 15
    singles = stars(40)
    assert not move_as(MOTION, chains).any()
    assert move_as(MOTION, singles).mean() > 0.9
    assert against_chains(MOTION, [*singles, *chains])[len(singles) :].min() > 20.0


@pytest.mark.parametrize(("length_px", "off_deg"), [(60.0, 45.0), (200.0, 25.0), (500.0, 3.0), (500.0, 0.0), (150.0, -60.0)])
def test_an_object_crosses_them_or_is_longer(length_px: float, off_deg: float) -> None:
    """What a chain of stars is not: 25 deg off their way, or fifteen times as long."""
    assert against_chains(MOTION, [*stars(60), fit(length_px, off_deg)])[-1] < 0.5


def test_stars_that_are_much_fainter_make_no_bright_line() -> None:
    """A fireball along the stars, fifty times as bright as any of them."""
    bright = fit(70.0, 4.0, snr=20_000.0)
    assert against_chains(MOTION, [*stars(60), bright])[-1] < 1e-2
    assert against_chains(MOTION, [*stars(60), fit(70.0, 4.0)])[-1] > 1e3
    assert against_chains(MOTION, [bright]).tolist() == [0.0]
    assert against_chains(MOTION, []).shape == (0,)
