"""The look two frames away: of starts that the three middle frames like alike it takes the one that has light in all five."""

import math

import numpy as np
import pytest

from onboard.track.corridor import MIDDLE
from onboard.track.first_look import Span
from onboard.track.trail_sums import Look, work_space
from onboard.track.wide_look import wide_look

SEED_PX = 24.0
PERIOD = 1.25  # exposures from frame to frame
FIRST_PX = -120  # where the corridors begin
PIXELS = 264
LIGHT = 4  # steps of a code a pixel
MARGIN = np.array([np.inf, np.inf, 7.5, 7.6, 7.7, 7.8])
SPAN = Span(2, 0, 4)


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_light_two_frames_away_decides(sense: float) -> None:
    """The wrong start is a third shorter: it begins where the right one does, and loses most of the trail two frames away."""
    taus = PERIOD * (np.arange(5) - 2.0)
    corridors = work_space(5)
    along = FIRST_PX + np.arange(PIXELS)
    for frame in range(5):
        begin = sense * taus[frame] * SEED_PX
        corridors.grid[frame] = FIRST_PX, 1.0
        corridors.pieces[frame] = PIXELS
        corridors.counts[frame, : PIXELS + 1] = np.arange(PIXELS + 1)[:, None]
        lit = (along >= begin) & (along < begin + SEED_PX)
        corridors.sums[frame, 1 : PIXELS + 1, MIDDLE] = np.cumsum(LIGHT * lit)
    look = Look(taus, sense, SEED_PX, 1.0, 1.0, 25.0, 0.0, 0)
    starts = np.array([[0.0, 16.0, 0.0, sense, 0.0], [0.0, SEED_PX, 0.0, sense, 0.0]])
    best, room = np.empty(4), np.empty((2, 5))

    both = wide_look(corridors, look, SPAN, MARGIN, -1e9, starts, MIDDLE, best, room)
    assert best.tolist() == [0.0, SEED_PX, 0.0, sense]
    # of five frames: LIGHT root(5 x 24 px) over a noise of 5 a pixel
    assert both == pytest.approx(LIGHT * math.sqrt(5 * SEED_PX) / 5.0 - MARGIN[5], abs=0.05)
    assert wide_look(corridors, look, SPAN, MARGIN, -1e9, starts[:1], MIDDLE, best, room) < both - 2.0
    assert wide_look(corridors, look, SPAN, MARGIN, both + 1.0, starts, MIDDLE, best, room) == both + 1.0
