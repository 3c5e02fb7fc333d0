"""The camera's shake within exposures in the ends of trails: its size, and how rows of a frame share it."""

import numpy as np
import pytest

from ground.link.row_errors import common_errors
from ground.link.shake import Sway, shake_factor


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.6])
def test_trails_tell_the_size_of_the_shake(factor: float) -> None:
    """Ten runs of ten tracklets of twelve frames, an end in fifty on a star: right to 7 % on the mean."""
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        sways = []
        for _ in range(10):
            sigma, shake = np.full(12, rng.uniform(0.02, 0.3)), np.full(12, 0.15)
            off = rng.normal(0.0, np.hypot(sigma, factor * shake))
            off[rng.random(12) < 0.02] += 3.0
            sways.append(Sway(off, sigma, shake))
        found.append(shake_factor(sways))
    assert np.mean(found) == pytest.approx(factor, rel=0.07)


def test_without_a_trail_the_attitudes_are_believed() -> None:
    """A run without bright trails, or without any."""
    nothing = Sway(np.zeros(0), np.zeros(0), np.zeros(0))
    assert shake_factor([]) == pytest.approx(1.0, abs=1e-9)
    assert shake_factor([nothing]) == pytest.approx(1.0, abs=1e-9)


def test_rows_of_a_frame_share_pointing_and_turning() -> None:
    """Across the motion, against 400,000 draws: pointing moves both ends alike, turning apart, other frames not at all."""
    rng = np.random.default_rng(5)
    pointing, turning, frame = np.full(3, 0.2), np.array([-0.3, 0.3, -0.3]), np.array([4, 4, 5])
    shift, turn = rng.standard_normal((2, 400_000, 6))
    drawn = pointing * shift[:, frame] + turning * turn[:, frame]
    _, across = common_errors(np.zeros((3, 3)), np.full(3, -1), pointing, turning, frame, np.array([0, 2, 0]), np.zeros((3, 3)))
    np.testing.assert_allclose(across, np.cov(drawn.T), atol=1e-3)
