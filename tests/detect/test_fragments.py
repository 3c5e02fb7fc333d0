"""Pieces of one trail become one detection, whichever of them is the brighter."""

from dataclasses import replace

import pytest

from onboard.detect.line_integral.fragments import join
from sboc_e2e.icd.signals import Detection

SHORT = Detection(row0=295.0, col0=100.0, row1=355.0, col1=100.0, snr=9.0)
LONG = Detection(row0=387.0, col0=100.0, row1=471.0, col1=100.0, snr=7.0)
ASIDE = Detection(row0=387.0, col0=110.0, row1=471.0, col1=110.0, snr=7.0)


@pytest.mark.parametrize("pieces", [(SHORT, LONG), (LONG, SHORT)])
def test_short_bright_and_long_faint_piece_are_one(pieces: tuple[Detection, Detection]) -> None:
    (one,) = join(pieces)
    assert (one.row0, one.row1) == (295.0, 471.0)
    assert one.snr == pytest.approx((9.0**2 + 7.0**2) ** 0.5)


def test_parallel_pieces_stay_two_by_falling_snr() -> None:
    assert join([ASIDE, SHORT]) == [SHORT, ASIDE]


def test_a_bright_trail_on_a_long_faint_line_stays_by_itself_where_the_sky_is_not_even() -> None:
    """A meteor of S/N 244, 180 px long, went into a line of S/N 19 through its neighbourhood, 420 px long, and was lost."""
    line = Detection(row0=100.0, col0=100.0, row1=520.0, col1=100.0, snr=19.0)
    meteor = Detection(row0=200.0, col0=101.0, row1=380.0, col1=101.0, snr=244.0)
    assert join([line, meteor]) == [line]
    assert join([line, meteor], brighter_apart=True) == [meteor, line]
    # the light of one trail goes on beyond its bright part
    assert len(join([SHORT, LONG], brighter_apart=True)) == 1
    assert join([line, replace(meteor, snr=9.0)], brighter_apart=True) == [line]
