"""Boxes of velocities by name: objects drawn from their orbits move inside them, as finite differences of their places show."""

import numpy as np
import pytest

from onboard.track.boxes import named_box
from onboard.track.joint_and_stack import JointAndStackTracker
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import FrameHeader
from tests.benchmarks.orbits_in_view import DRAWN, Observer

FOCAL_PX, SIDE = 44_444.4, 4096


@pytest.mark.parametrize("kind", DRAWN)
def test_objects_of_a_kind_move_inside_its_box(kind: str) -> None:
    """Forty objects, each in the field of a camera of its own on a dawn-dusk orbit, which looks away from the Sun."""
    rng, inside, n = np.random.default_rng(12), 0, 0
    while n < 40:
        observer = Observer.towards_the_night(rng)
        drawn = observer.object_in_view(DRAWN[kind], 0.5 * SIDE, FOCAL_PX, rng)
        if drawn is None:
            continue
        n += 1
        box = named_box(kind, observer.header(SIDE), FOCAL_PX)
        if box is not None:
            off = np.abs(observer.rate_px_s(*drawn, FOCAL_PX) - [box.row_px_s, box.col_px_s])
            inside += bool((off <= np.array([box.half_row_px_s, box.half_col_px_s]) + 0.02).all())
    assert inside >= 38


def test_a_frame_without_attitude_has_no_box() -> None:
    bare = FrameHeader(frame=0, t_start_tai_ns=10**18, exposure_ns=1, line_time_ns=0, rows=64, cols=64)
    assert named_box("geo", bare, FOCAL_PX) is None


@pytest.mark.parametrize(
    ("options", "message"), [({"box": "leo"}, "allowed are given, geo, meo"), ({"box": "blind"}, "stack_frames")]
)
def test_boxes_that_cannot_be_are_refused(options: dict[str, str], message: str) -> None:
    with pytest.raises(UserError, match=message):
        JointAndStackTracker(**options)  # type: ignore[arg-type]
