"""Boxes of velocities by name: objects drawn from their orbits move inside them, as finite differences of their places show."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from onboard.track.boxes import GM_M3_S2, named_box
from onboard.track.joint_and_stack import JointAndStackTracker
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import AttitudeEstimate, FrameHeader, ObserverState

FOCAL_PX, SIDE = 44_444.4, 4096
OBSERVER_M, OBSERVER_M_S = 7078e3, 7504.0


def state(
    a: float, e: float, i: float, rng: np.random.Generator, radius_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place and velocity on a random orbit of a size, shape and inclination (rad), at a radius."""
    p = a * (1.0 - e**2)
    anomaly = rng.choice([-1.0, 1.0]) * math.acos(np.clip((p / radius_m - 1.0) / e, -1, 1)) if e > 0 else rng.uniform(0.0, 6.28)
    perigee, node = rng.uniform(0.0, 2.0 * np.pi, 2)
    x, y = np.cos(anomaly), np.sin(anomaly)
    place, way = radius_m * np.array([x, y, 0.0]), math.sqrt(GM_M3_S2 / p) * np.array([-y, e + x, 0.0])
    turn = about_z(node) @ about_x(i) @ about_z(perigee)
    return turn @ place, turn @ way


def about_z(angle: float) -> NDArray[np.float64]:
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def about_x(angle: float) -> NDArray[np.float64]:
    return np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])


def looking_at(sight: NDArray[np.float64], place: NDArray[np.float64], way: NDArray[np.float64]) -> FrameHeader:
    """A frame of a camera with a given line of sight, its columns level."""
    x = np.cross([0.0, 0.0, 1.0], sight)
    x /= np.linalg.norm(x)
    return FrameHeader(
        frame=0, t_start_tai_ns=10**18, exposure_ns=200_000_000, line_time_ns=0, rows=SIDE, cols=SIDE,
        attitude=AttitudeEstimate(
            quaternion=Rotation.from_matrix(np.stack([x, np.cross(sight, x), sight])).as_quat(),
            rate_rad_s=np.zeros(3), covariance_rad2=1e-10 * np.eye(3),
        ),
        observer=ObserverState(
            tai_ns=10**18, position_m=place, velocity_m_s=way, sigma_position_m=10.0, sigma_velocity_m_s=0.1
        ),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "a", "e", "inclination_deg", "radius_m"),
    [
        ("geo", 42.164e6, 0.0, (0.0, 15.0), (42.164e6, 42.164e6)),
        ("meo", 26.56e6, 0.0, (54.5, 64.5), (26.56e6, 26.56e6)),
        ("molniya", 26.56e6, 0.72, (62.5, 64.5), (39e6, 44.5e6)),
    ],
)
def test_objects_of_a_kind_move_inside_its_box(
    kind: str, a: float, e: float, inclination_deg: tuple[float, float], radius_m: tuple[float, float]
) -> None:
    """Forty objects seen from a dawn-dusk orbit, within 2 deg of the line of sight; motion by places 1 s apart."""
    rng, inside, n = np.random.default_rng(12), 0, 0
    while n < 40:
        place, way = state(a, e, math.radians(rng.uniform(*inclination_deg)), rng, rng.uniform(*radius_m))
        turn = about_z(rng.uniform(0, 6.28)) @ about_x(math.radians(98.2)) @ about_z(rng.uniform(0, 6.28))
        here, going = turn @ np.array([OBSERVER_M, 0.0, 0.0]), turn @ np.array([0.0, OBSERVER_M_S, 0.0])
        seen = [(place + s * way - here - s * going) for s in (-0.5, 0.5)]
        seen = [s / np.linalg.norm(s) for s in seen]
        middle = (seen[0] + seen[1]) / np.linalg.norm(seen[0] + seen[1])
        if middle @ here < 0.3 * OBSERVER_M:  # what looks away from the Earth
            continue
        sight = middle + rng.normal(0.0, 0.012, 3)
        sight /= np.linalg.norm(sight)
        header = looking_at(sight, here, going)
        x = np.cross([0.0, 0.0, 1.0], sight)
        x /= np.linalg.norm(x)
        axes = np.stack([np.cross(sight, x), x])
        pixels = [FOCAL_PX * (axes @ s) / (sight @ s) for s in seen]
        if np.abs(pixels).max() > 0.5 * SIDE:
            continue
        moved = pixels[1] - pixels[0]
        box = named_box(kind, header, FOCAL_PX)
        n += 1
        if box is not None:
            off = np.abs(moved - [box.row_px_s, box.col_px_s])
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
