"""The joint bound of a track across its motion, against least squares on drawn trails."""

import numpy as np
import pytest

from tests.benchmarks.track_gain import joint_cross


def test_least_squares_over_pixels_of_all_frames_reaches_the_joint_bound() -> None:
    """Trails as fifty points each on one line: a line fitted to all of them errs by the bound, the trails' means by more."""
    rng = np.random.default_rng(1)
    x, cross = np.array([-1.9, -0.6, 0.6, 1.9]), np.array([0.3, 0.4, 0.3, 0.5])
    u = (np.arange(50) + 0.5) / 50 - 0.5
    places = (x[:, None] + u).ravel()
    sigma = np.repeat(cross * np.sqrt(50.0), 50)
    design = np.stack([np.ones_like(places), places], axis=1) / sigma[:, None]
    at = np.stack([np.ones_like(x), x], axis=1)
    fitted, own, line = [], [], []
    for _ in range(1500):
        noise = rng.normal(0.0, sigma)
        fitted.append(at @ np.linalg.lstsq(design, noise / sigma, rcond=None)[0])
        each = joint_cross(x, cross, noise.reshape(4, 50).mean(axis=1))
        own.append(each[0])
        line.append(each[1])
    bound = np.std(np.array(own), axis=0)
    assert np.std(np.array(fitted), axis=0) == pytest.approx(cross / bound, rel=0.05)
    assert (bound > 1.0).all()
    assert np.sqrt(np.mean(np.square(line))) == pytest.approx(1.0, abs=0.06)
