"""What stands still at a trail's places: pixels that the other frames show lit as well are told apart, and the light there."""

import math

import numpy as np
import pytest

from onboard.track.frames import Frames, halved_transforms
from onboard.track.packed import STEP, packed
from onboard.track.standing_light import standing
from sboc_e2e.icd.signals import UNKNOWN

N = 5
SIDE = 64
OWN = 2
TRAIL = slice(20, 40)
STAR = slice(28, 31)
SHIFT = np.array([0, 1, 3, -2, 4])  # of the stars in each frame, px along the columns


def _frames(n_old: int = 0) -> Frames:
    transforms = np.repeat(np.eye(2, 3)[None], N, axis=0)
    transforms[:, 1, 2] = SHIFT - SHIFT[OWN]
    taus = 1.25 * (np.arange(N) - OWN)
    return Frames(transforms, halved_transforms(transforms), taus, n_old, N, OWN, 0.849, np.full(N + 1, 7.5))


def _sky(star: int, trail: int) -> tuple[np.ndarray, ...]:
    """Frames of nothing but a star that stands still and a trail in the middle one; both in steps of a code a pixel."""
    images = []
    for frame in range(N):
        smooth = np.zeros((SIDE, SIDE), np.int8)
        smooth[30, STAR.start + SHIFT[frame] : STAR.stop + SHIFT[frame]] = STEP * star
        if frame == OWN:
            smooth[30, TRAIL.start + SHIFT[OWN] : TRAIL.stop + SHIFT[OWN]] += STEP * trail
        images.append(packed(smooth))
    return tuple(images)


def _line(*, turned: bool = False) -> np.ndarray:
    ends = [30.0, float(TRAIL.start + SHIFT[OWN]), 30.0, float(TRAIL.stop - 1 + SHIFT[OWN])]
    return np.array([ends[1], ends[0], ends[3], ends[2]] if turned else ends)


@pytest.mark.parametrize("star", [2, 3])
def test_pixels_that_other_frames_show_lit_are_told_apart(star: int) -> None:
    """Four frames with 2 steps, 1.1 sigma, of a star are 2.2 sigma together, with 3 steps 3.4 sigma: only these are lit."""
    found = standing(_frames(), _sky(star, 2), OWN, _line(), 5.0, np.empty(4))
    n, length = STAR.stop - STAR.start, TRAIL.stop - TRAIL.start
    lit = n if star * STEP / 16.0 * math.sqrt(N - 1) > 3.0 else 0
    assert found.pixels == lit
    assert found.lit == lit * (star + 2)
    assert found.static == pytest.approx(star * n / length * math.sqrt(length) / 5.0)
    assert found.rest == pytest.approx(0.0 if lit else found.static)


def test_rows_and_columns_change_places() -> None:
    images = tuple(packed(np.ascontiguousarray(_smooth(star=3).T)) for _ in range(N))
    frames = _frames()
    frames.transforms[:, 1, 2] = 0.0
    found = standing(frames, images, OWN, _line(turned=True), 5.0, np.empty(4))
    assert found.pixels == STAR.stop - STAR.start


def _smooth(star: int) -> np.ndarray:
    smooth = np.zeros((SIDE, SIDE), np.int8)
    smooth[30, STAR.start + SHIFT[OWN] : STAR.stop + SHIFT[OWN]] = STEP * star
    return smooth


def test_where_nothing_is_known_nothing_stands() -> None:
    """Outside the image, and where the other frames' pixels are unknown; an old frame has no pixels of its own."""
    images = list(_sky(3, 2))
    dark = packed(np.full((SIDE, SIDE), UNKNOWN, np.int8))
    blind = tuple(image if frame == OWN else dark for frame, image in enumerate(images))
    assert standing(_frames(), blind, OWN, _line(), 5.0, np.empty(4)) == (0.0, 0.0, 0, 0.0)
    away = np.array([-9.0, 5.0, -9.0, 25.0])
    assert standing(_frames(), tuple(images), OWN, away, 5.0, np.empty(4)) == (0.0, 0.0, 0, 0.0)
    old = standing(_frames(n_old=1), tuple(images), 0, _line(), 5.0, np.empty(4))
    assert old.pixels == 0
    assert old.static > 0.0
