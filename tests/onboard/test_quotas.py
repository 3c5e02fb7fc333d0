"""Regions of interest protect debris: quotas by length and part of the field; and credit that no clock can blow up."""

import numpy as np
import pytest

from onboard.downlink.budget import Allowance, taking_turns, within_limits
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

SHAPE = (2048, 2048)
RATE = 5e5
NONE = StreakFlag(0)


def trail(row: float, col: float, length: float, snr: float, flags: StreakFlag = NONE) -> Detection:
    return Detection(row0=row, col0=col, row1=row, col1=col + length, snr=snr, flags=flags)


def crowd(rng: np.random.Generator) -> list[Detection]:
    """Two hundred bright trails of 120 px in one corner."""
    return [trail(float(r), float(c), 120.0, float(s)) for r, c, s in rng.uniform((0, 0, 50), (400, 400, 90), (200, 3))]


def test_one_region_of_sky_cannot_take_all() -> None:
    """Eight faint trails far from the crowd, short, long, points and one that crosses the field: all of them among sixty."""
    rng = np.random.default_rng(1)
    both = StreakFlag.EDGE0 | StreakFlag.EDGE1
    apart = [
        trail(1500.0, 300.0, 0.0, 9.0),
        trail(1500.0, 1800.0, 15.0, 7.6),
        trail(900.0, 1000.0, 60.0, 7.4),
        trail(1000.0, 1500.0, 300.0, 7.3),
        trail(1800.0, 0.0, 2047.0, 7.5, both),
        trail(300.0, 1700.0, 12.0, 7.7),
        trail(1700.0, 1000.0, 80.0, 7.9),
        trail(200.0, 200.0, 0.0, 8.8),
    ]
    sent = within_limits([*crowd(rng), *apart], SHAPE, most=60, most_cosmic_like=1)
    assert len(sent) == 60
    assert all(d in sent for d in apart)


def test_half_of_the_places_go_to_the_most_significant() -> None:
    ordered = sorted(crowd(np.random.default_rng(2)), key=lambda d: -d.snr)
    chosen = within_limits(ordered, SHAPE, most=60, most_cosmic_like=1)
    assert sum(d in chosen for d in ordered[:30]) == 30
    assert sorted(map(id, taking_turns(ordered, SHAPE))) == sorted(map(id, ordered))


def test_hits_come_after_everything_else() -> None:
    hits = [trail(10.0 * k, 5.0, 0.0, 500.0, StreakFlag.COSMIC_LIKE) for k in range(50)]
    faint = [trail(1000.0, 10.0 * k, 30.0, 7.5) for k in range(20)]
    sent = within_limits([*hits, *faint], SHAPE, most=60, most_cosmic_like=2)
    assert sent[:20] == faint
    assert len(sent) == 22


@pytest.mark.parametrize("seed", range(5))
def test_no_clock_grants_more_than_a_burst(seed: int) -> None:
    """Jumps of seconds to centuries forward and back, exposures that the header has wrong by as much."""
    rng = np.random.default_rng(seed)
    allowance = Allowance(rate_bytes_s=RATE, burst_s=2.0).after(0.2, 0.2)
    for _ in range(500):
        wrong = rng.random() < 0.5
        elapsed = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3.0, 10.0)) if wrong else 0.25
        exposure = 0.2 if wrong else 10.0 ** rng.uniform(-3.0, 10.0)
        allowance = allowance.after(elapsed, exposure).spend(int(rng.integers(0, 200_000)))
        assert allowance.credit_bytes <= RATE * 2.0


def test_a_long_exposure_that_has_passed_is_paid_for() -> None:
    assert Allowance(rate_bytes_s=RATE, burst_s=2.0).after(61.0, 60.0).credit_bytes == RATE * 60.0
