"""A star that other frames took out and a track's own frame did not is named; noise and stars that were taken out are not."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.track.removed_stars import by_row, left_in

PSF_SIGMA_PX = 0.85
LINE = np.array([[100.0, 50.0], [130.0, 90.0]])  # 50 px long, (0.6, 0.8) along
ON_IT = np.array([112.0, 66.0])
ACROSS = np.array([-0.8, 0.6])


def turned(angle: float, row_px: float, col_px: float) -> NDArray[np.float64]:
    """A transform that turns about the origin and shifts."""
    return np.array([[math.cos(angle), -math.sin(angle), row_px], [math.sin(angle), math.cos(angle), col_px]])


TRANSFORMS = np.stack([turned(0.02 * k, 7.3 * k, -4.1 * k) for k in (-2, -1, 0, 1, 2)])
OWN = 1


def lists(*of: tuple[int, NDArray[np.float64]]) -> list[NDArray[np.uint16]]:
    """Lists of what each frame took out: frame, and the star's place in the track's own frame."""
    back = np.vstack([TRANSFORMS[OWN], [0.0, 0.0, 1.0]])
    out: list[list[NDArray[np.float64]]] = [[] for _ in TRANSFORMS]
    for frame, place in of:
        out[frame].append(TRANSFORMS[frame] @ np.append(np.linalg.solve(back, np.append(place, 1.0))[:2], 1.0))
    return [by_row(np.rint(np.array(places).reshape(-1, 2)).astype(np.uint16)) for places in out]


def test_a_star_that_two_other_frames_took_out_lies_on_the_trail_where_it_is_in_its_own_frame() -> None:
    """Through a turned and shifted sky, to the pixel that a list's places are rounded to."""
    found = left_in(LINE, OWN, lists((0, ON_IT), (3, ON_IT)), TRANSFORMS, PSF_SIGMA_PX)
    assert len(found) == 2
    assert np.abs(found - ON_IT).max() < 0.8


@pytest.mark.parametrize(
    "of",
    [
        ((0, ON_IT),),  # noise that passed for a star once
        ((0, ON_IT), (3, ON_IT), (OWN, ON_IT)),  # its light is gone here as well
        ((0, ON_IT), (3, ON_IT + 10.0 * np.array([0.6, 0.8]))),  # two that are not one star
        ((0, ON_IT + 4.0 * ACROSS), (3, ON_IT + 4.0 * ACROSS)),  # beside the trail
        ((0, LINE[1] + 9.0 * np.array([0.6, 0.8])), (3, LINE[1] + 9.0 * np.array([0.6, 0.8]))),  # beyond its end
    ],
)
def test_what_is_no_such_star_is_not_named(of: tuple[tuple[int, NDArray[np.float64]], ...]) -> None:
    """One frame alone; taken out here too; two places; beside; beyond."""
    assert len(left_in(LINE, OWN, lists(*of), TRANSFORMS, PSF_SIGMA_PX)) == 0


def test_without_any_list_there_are_no_stars() -> None:
    """Noise without stars, or a detector that removes none."""
    assert left_in(LINE, OWN, lists(), TRANSFORMS, PSF_SIGMA_PX).shape == (0, 2)


def test_what_lies_on_a_trail_is_found_in_long_lists_as_by_looking_at_every_star() -> None:
    """30,000 stars a frame at one place on the sky but for 0.3 px; this frame took none of them out."""
    rng = np.random.default_rng(4)
    sky = rng.uniform(0.0, 1200.0, (30_000, 2))
    back = np.vstack([TRANSFORMS[OWN], [0.0, 0.0, 1.0]])
    centre = np.linalg.solve(back, np.column_stack([sky, np.ones(len(sky))]).T)[:2].T
    seen = [centre @ t[:, :2].T + t[:, 2] + rng.normal(0.0, 0.3, sky.shape) for t in TRANSFORMS]
    rounded = [np.rint(np.clip(places, 0.0, 60_000.0)) for places in seen]
    rounded[OWN] = np.zeros((0, 2))
    line = np.array([[300.0, 200.0], [900.0, 1000.0]])  # 1,000 px long
    found = left_in(line, OWN, [by_row(r.astype(np.uint16)) for r in rounded], TRANSFORMS, PSF_SIGMA_PX)
    along = (sky - line[0]) @ np.array([0.6, 0.8])
    across = np.abs((sky - line[0]) @ np.array([-0.8, 0.6]))
    inside = (along > 2.0) & (along < 998.0) & (across < 1.0)  # nearer than places err
    assert inside.sum() > 30
    nearest = np.hypot(*(sky[inside][:, None] - found).T).min(axis=0)
    assert nearest.max() < 2.0
    assert (np.abs((found - line[0]) @ np.array([-0.8, 0.6])) < 5.0).all()
