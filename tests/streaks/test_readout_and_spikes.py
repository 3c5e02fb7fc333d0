"""Lines that follow rows and columns, and lines that aim at bright stars: how often a trail does so by chance."""

import math
from typing import Any

import numpy as np
import pytest

from ground.vetting.bends import bends_too_much
from ground.vetting.borders import against_border
from ground.vetting.look_alikes import of_spilled_charge
from ground.vetting.readout import drift_of, exactness, is_of_readout, odds_of_readout
from ground.vetting.spikes import BrightStars
from sboc_e2e.icd.flags import StreakFlag


def line(row0: float, col0: float, row1: float, col1: float, **more: Any) -> Any:
    """A fit of ends that are known to 0.1 px."""
    values = {"width_px": 1.0, "chi2_nu": 1.0, "flux_e": 1000.0, "snr": 50.0, "covariance_px2": 0.01 * np.eye(4)} | more
    ends = {"row0": row0, "col0": col0, "row1": row1, "col1": col1, "length_px": math.hypot(row1 - row0, col1 - col0)}
    return type("Fit", (), ends | values)()


def test_the_likelihood_ratio_averages_to_one_over_trails_of_all_directions() -> None:
    """As any does: 200,000 trails of 200 px, to 6 % (seed 11)."""
    angle = np.random.default_rng(11).uniform(0.0, math.pi, 200_000)
    near = np.abs(np.sin(2.0 * angle)) < 0.2
    total = sum(exactness(line(0.0, 0.0, 200.0 * math.sin(a), 200.0 * math.cos(a))) for a in angle[near])
    assert total / len(angle) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(("side_px", "width_px"), [(100, 2.0), (400, 4.0)])
def test_lines_across_a_frame_stay_on_a_row_or_column_as_often_as_their_width_allows(side_px: int, width_px: float) -> None:
    """By the angles within which they drift by less than 2.5 widths: 10 / pi widths over the side, and some 5 % more that cut a
    corner off. 40,000 lines through places all over the frame (seed 12)."""
    rng = np.random.default_rng(12)
    place, angle = rng.uniform(0.0, side_px, (40_000, 2)), rng.uniform(0.0, math.pi, 40_000)
    along = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    to_borders = np.sort([-place / along, (side_px - place) / along], axis=0)
    spans = np.abs(along) * (to_borders[1].min(axis=1) - to_borders[0].max(axis=1))[:, None]
    found = sum(is_of_readout(drow, dcol, width_px, (side_px, side_px)) for drow, dcol in spans.tolist())
    assert found / len(angle) == pytest.approx(10.0 / math.pi * width_px / side_px, rel=0.15)


def test_a_drift_of_several_errors_is_no_readout_whatever_the_width() -> None:
    """A column speaks the more for the readout the longer it is; texture and stars widen the error of a drift."""
    short, long, drifts, wide, point = odds_of_readout(
        [
            line(10.0, 5.0, 60.0, 5.0),
            line(10.0, 5.0, 460.0, 5.2),
            line(10.0, 5.0, 460.0, 9.0),
            line(10.0, 5.0, 460.0, 19.0, width_px=5.5, chi2_nu=9.5),
            line(10.0, 5.0, 10.0, 5.0),
        ]
    )
    assert 1.0 < short < long / 5.0
    assert max(drifts, wide) < 1e-2
    assert point < 1.0
    drift, sigma = drift_of(line(10.0, 5.0, 460.0, 9.0, chi2_nu=100.0))
    assert drift == pytest.approx(4.0)
    assert sigma == pytest.approx(math.hypot(math.sqrt(2.0), 0.5, 0.3), rel=0.01)
    assert odds_of_readout([]).shape == (0,)


def test_a_frame_with_columns_expects_more_of_them() -> None:
    """A line of 27 px along a row may be a trail; among eight such columns it is not; among thirty lines of other ways it may."""
    alone = line(10.0, 5.0, 37.0, 5.3)
    others = [line(50.0, 60.0 + 30.0 * k, 50.0 + 90.0 * math.sin(0.3 + 0.09 * k), 150.0) for k in range(30)]
    columns = [line(0.0, 20.0 + 40.0 * k, 300.0, 20.0 + 40.0 * k) for k in range(8)]
    assert odds_of_readout([alone])[0] < 1.5
    assert odds_of_readout([alone, *others])[0] < 1.5
    assert odds_of_readout([alone, *columns])[0] > 10.0


def stars(n: int, *, flux_e: float = 1e6) -> BrightStars:
    """The first at (300, 300), the others anywhere in 1000 x 1000 px."""
    places = np.random.default_rng(4).uniform(0.0, 1000.0, (2, n))
    places[:, 0] = 300.0
    return BrightStars.of(places[0], places[1], np.full(n, flux_e, np.float32), 1e6)


@pytest.mark.parametrize("shift", [-120.0, 0.0, 90.0])
def test_a_line_through_a_bright_star_is_a_spike(shift: float) -> None:
    """The star on the line, before it and behind it; 4 px beside it; and a star that is not bright enough."""
    along = np.array([math.sin(0.7), math.cos(0.7)])
    start, stop = (300.0 + (shift + half) * along for half in (-50.0, 50.0))
    spike = line(*start, *stop)
    assert stars(1).against(spike) > 100.0
    assert stars(1).against(line(start[0] + 4.0, start[1], stop[0] + 4.0, stop[1])) == 0.0
    assert stars(1, flux_e=1.5e4).against(spike) == 0.0
    assert stars(40).against(spike) < 10.0, "in a field of forty such stars every tenth line aims at one"
    assert BrightStars.of(np.zeros(0), np.zeros(0), np.zeros(0, np.float32), 1e6).against(spike) == 0.0


def test_a_bright_line_that_is_one_full_star_is_none() -> None:
    """A star of the line's own light on it, S/N 100,000: spilled charge, 31 px long, had p 0.99. At S/N 50 it crosses a star."""
    star = stars(1, flux_e=1000.0)
    assert star.against(line(285.0, 300.0, 316.0, 302.0, snr=1e5)) > 100.0
    assert star.against(line(285.0, 300.0, 316.0, 302.0)) == 0.0
    assert star.against(line(320.0, 300.0, 351.0, 302.0, snr=1e5)) == 0.0, "before it and not on it"


def test_a_fireball_is_no_full_star_though_its_core_is_listed_as_one() -> None:
    """S/N 2,156, 83 px long and 2.4 px wide, 20 deg from the columns. Along a column it may be spilled charge, and a short one
    may be the star."""
    core = stars(1, flux_e=1000.0)
    more = {"snr": 2156.0, "width_px": 2.4}
    assert core.against(line(261.0, 286.0, 339.0, 314.0, **more)) == 0.0
    assert core.against(line(261.0, 300.0, 339.0, 300.0, **more)) > 10.0
    assert core.against(line(281.0, 293.0, 319.0, 307.0, **more)) > 10.0


def test_the_rim_of_a_nebula_bends_more_than_any_lens_bends_a_path() -> None:
    """A quarter of a ring of 80 px, and great circles through a fisheye of 500 px (distance from the axis as the angle), 5 to 160
    deg long and 0 to 85 deg from the axis: their bend is below that of the horizon."""
    rim = line(300.0, 300.0, 300.0, 418.0, width_px=7.7, sagitta_px=-24.3)
    assert bends_too_much(rim, (1023, 1536))
    assert not bends_too_much(line(300.0, 300.0, 300.0, 418.0, width_px=7.7, sagitta_px=2.0), (1023, 1536))
    assert not bends_too_much(rim, (100, 100)), "a cut-out tells little of its lens"
    assert bends_too_much(line(300.0, 300.0, 300.0, 418.0, width_px=1.0, sagitta_px=6.0), (1023, 1536))
    assert not bends_too_much(line(300.0, 300.0, 300.0, 418.0, width_px=1.0, sagitta_px=6.0), (1023, 1536), 300.0)
    scale = 500.0 / (0.5 * math.pi)
    for away in np.radians([0.0, 20.0, 45.0, 70.0, 85.0]):
        for half in np.radians([2.5, 20.0, 50.0, 80.0]):
            along = np.array([-half, 0.0, half])
            z, x, y = math.cos(away) * np.cos(along), math.sin(away) * np.cos(along), np.sin(along)
            theta = np.arccos(z)
            col, row = scale * theta * np.array([x, y]) / np.maximum(np.hypot(x, y), 1e-12)
            bend = col[1] - 0.5 * (col[0] + col[2])
            path = line(row[0], col[0], row[2], col[2], width_px=1.0, sagitta_px=bend)
            assert not bends_too_much(path, (1000, 1000))


def test_lines_that_stay_near_a_border_are_the_frames_and_trails_seldom_do() -> None:
    """Half lines of video, 580 px long with a drift of 4 px, had p 0.91. Satellites 8 px from a border (46 px long, S/N 48) and
    3 to 9 px (25 px, S/N 34) had 0.12 and 0.29. Of 15,705 trails of 100 px wholly in 500 x 700 px (seed 9) 1 in 1,000 has odds
    above one."""
    seen = (0, 551, 0, 719)
    assert against_border(line(5.0, 140.0, 1.0, 720.0), seen) > 50.0
    assert against_border(line(550.0, 140.0, 546.0, 720.0), seen) > 50.0
    assert against_border(line(140.0, 2.0, 500.0, 4.0), seen) > 50.0
    assert against_border(line(0.0, 140.0, 300.0, 260.0), seen) < 0.2, "it leaves the frame there"
    assert against_border(line(250.0, 140.0, 252.0, 600.0), seen) < 0.2
    assert against_border(line(3.0, 3.0, 3.0, 3.0), seen) == 0.0
    assert against_border(line(404.0, 1021.0, 450.0, 1016.0), (0, 1023, 0, 1023)) < 0.5
    assert against_border(line(403.0, 2.0, 427.0, 9.0), (0, 1023, 0, 1023)) < 0.5
    rng = np.random.default_rng(9)
    angle, row, col = rng.uniform(0.0, math.pi, 20_000), rng.uniform(0.0, 499.0, 20_000), rng.uniform(0.0, 699.0, 20_000)
    drow, dcol = 50.0 * np.sin(angle), 50.0 * np.abs(np.cos(angle))
    whole = (row > drow) & (row < 499.0 - drow) & (col > dcol) & (col < 699.0 - dcol)
    ends = np.column_stack([row - drow, col - dcol, row + drow, col + dcol])[whole]
    odds = [against_border(line(*each), (0, 499, 0, 699)) for each in ends.tolist()]
    assert np.mean(np.array(odds) > 1.0) < 0.002


def test_trails_aim_at_stars_as_seldom_as_the_odds_say() -> None:
    """4,000 trails of 100 px anywhere among ten stars (seed 6): 1 to 3 % aim at one, by 10 * 4 px * 300 px / 1e6 px2 = 1.2 %."""
    rng = np.random.default_rng(6)
    field, aimed = stars(10), 0
    for row, col, angle in zip(*rng.uniform(0.0, 1.0, (3, 4000)) * [[1000.0], [1000.0], [math.pi]], strict=True):
        half = 50.0 * np.array([math.sin(angle), math.cos(angle)])
        place = np.array([row, col])
        aimed += field.against(line(*(place - half), *(place + half))) > 0.0
    assert 0.008 < aimed / 4000 < 0.03


def test_charge_of_full_stars_runs_along_columns_and_a_bright_trail_seldom_does() -> None:
    """A line of S/N 24,000 that tapered for 520 px along a column was published with p 0.75. Odds by the shares of directions."""
    full, bright, plain = StreakFlag.SATURATED, 5_000.0, 200.0

    def odds(angle_deg: float, snr: float, flags: StreakFlag) -> float:
        angle = math.radians(angle_deg)
        return of_spilled_charge(line(0.0, 0.0, 500.0 * math.cos(angle), 500.0 * math.sin(angle), snr=snr, flags=flags))

    assert odds(1.6, bright, StreakFlag(0)) == odds(91.6, plain, full) > 4.0
    assert odds(1.6, plain, StreakFlag(0)) == odds(30.0, bright, full) == 0.0
    aligned = sum(odds(float(each), bright, full) > 0.0 for each in np.arange(0.05, 180.0, 0.1)) / 1_800
    assert odds(0.0, bright, full) == pytest.approx(0.2 / aligned, rel=0.05)
