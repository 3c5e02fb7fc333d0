"""Facts about a detection's surroundings become flags, and only when they are true."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.detect.line_integral.context import with_context
from onboard.detect.star_mask import mask_radii_px
from sboc_e2e.icd.flags import MaskBit, StarFlag, StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView, StarList
from tests.benchmarks.detection_frames import Scene, view_of

TRAIL = Detection(row0=50.0, col0=60.0, row1=50.0, col1=120.0, snr=12.0, flags=StreakFlag.EDGE0)


def view_with(row: float, col: float, flags: int = 0) -> DetectorView:
    """An empty frame with one listed star."""
    bare = view_of(Scene(image=np.zeros((192, 192), np.float32)))
    one = np.array([1.0])
    return replace(
        bare,
        stars=StarList(
            row=row * one, col=col * one, flux_e=one, snr=np.array([50.0], np.float32), flags=np.array([flags], np.uint8)
        ),
    )


def radii(view: DetectorView) -> NDArray[np.float64]:
    """Masks of the stars of a view."""
    return mask_radii_px(view.stars.snr, view.psf_sigma_px, 1.0)


@pytest.mark.parametrize(
    ("row", "col", "star", "static", "expected"),
    [
        (51.5, 90.0, StarFlag(0), True, StreakFlag.CROSSES_STAR),
        (51.5, 90.0, StarFlag(0), False, StreakFlag(0)),  # a piece of the trail itself
        (56.0, 90.0, StarFlag(0), True, StreakFlag(0)),
        (51.0, 140.0, StarFlag.SATURATED, True, StreakFlag.SPIKE_LIKE),
        (49.0, 30.0, StarFlag.SATURATED, True, StreakFlag.SPIKE_LIKE),
        (51.0, 140.0, StarFlag(0), True, StreakFlag(0)),
        (
            51.0,
            85.0,
            StarFlag.SATURATED,
            True,
            StreakFlag.SPIKE_LIKE | StreakFlag.CROSSES_STAR,
        ),  # two arms joined across the star
        (51.0, 65.0, StarFlag.SATURATED, True, StreakFlag.CROSSES_STAR),
        (58.0, 140.0, StarFlag.SATURATED, True, StreakFlag(0)),
        (50.0, 190.0, StarFlag.SATURATED, True, StreakFlag(0)),
    ],
)
def test_stars_under_and_beyond_a_trail(row: float, col: float, star: StarFlag, static: bool, expected: StreakFlag) -> None:
    found = with_context(TRAIL, view_with(row, col, star), np.array([static]), radii(view_with(row, col, star)))
    assert found == replace(TRAIL, flags=StreakFlag.EDGE0 | expected)


@pytest.mark.parametrize(("row", "flagged"), [(50, True), (53, False)])
def test_saturated_pixel_on_the_path(row: int, flagged: bool) -> None:
    view = view_with(150.0, 150.0)
    mask = np.zeros(view.mask.shape, np.uint8)
    mask[row, 100] = MaskBit.SATURATED
    found = with_context(TRAIL, replace(view, mask=mask), np.array([True]), radii(view_with(150.0, 150.0)))
    assert bool(found.flags & StreakFlag.SATURATED) == flagged


def test_star_like_detection_does_not_point_anywhere() -> None:
    point = replace(TRAIL, col1=60.0)
    found = with_context(point, view_with(50.0, 80.0, StarFlag.SATURATED), np.array([True]), radii(view_with(50.0, 80.0)))
    assert found.flags == StreakFlag.EDGE0
