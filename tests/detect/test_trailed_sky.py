"""Lines that masks of star trails leave over."""

import numpy as np
import pytest

from onboard.detect import whiten
from onboard.detect.line_integral.trailed_sky import is_left_over
from sboc_e2e.icd.signals import Detection, StarMotion

MOTION = StarMotion(drow=0.0, dcol=40.0, turn_rad=0.0, middle_row=100.0, middle_col=100.0)
"""Stars of 40 px along rows."""


@pytest.mark.parametrize(
    ("bit", "share", "length_px", "left_over"),
    [
        (whiten.STAR_BIT, 1.0, 60.0, True),  # the mask of another star's trail
        (1, 1.0, 60.0, True),  # pixels that must not be used
        (whiten.STAR_BIT, 0.25, 60.0, False),  # an object that crosses trails
        (whiten.STAR_BIT, 1.0, 170.0, False),  # longer than four trails: no star is
        (whiten.FOUND_BIT, 1.0, 60.0, False),  # its own light, as the search marks it
        (whiten.POINT_BIT, 1.0, 60.0, False),
    ],
)
def test_a_short_line_on_masks_of_trails_is_left_over(bit: int, share: float, length_px: float, left_over: bool) -> None:
    """Only pixels that must not be used counted, so that a line wholly on a star's trail was kept."""
    blocked = np.zeros((200, 200), np.uint8)
    blocked[99:102, 10 : 10 + round(share * length_px) + 1] = bit
    line = Detection(row0=100.0, col0=10.0, row1=100.0, col1=10.0 + length_px, snr=20.0)
    assert is_left_over(line, blocked, MOTION) is left_over
