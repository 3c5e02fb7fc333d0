"""Rates of a turning camera from the attitudes of its frames, against attitudes that scipy turns."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ground.sky.turning import Attitude, rates_of

ARCSEC = np.pi / 648000.0
POINTING = Rotation.from_euler("zyx", [131.5, -17.9, 40.0], degrees=True)


def attitudes(rate_rad_s: np.ndarray, noise_arcsec_s: float, *, cadence_s: float = 2.0, told: bool = True) -> list[Attitude]:
    """Twenty frames of a body that turns at a constant rate about axes of its own; attitudes good to 0.01 arcsec."""
    rng = np.random.default_rng(8)
    out = []
    for k in range(20):
        body = (
            POINTING * Rotation.from_rotvec(rate_rad_s * cadence_s * k) * Rotation.from_rotvec(rng.normal(0.0, 0.01 * ARCSEC, 3))
        )
        out.append(
            Attitude(
                tai_ns=2_179_000_000 * 10**9 + round(k * cadence_s * 1e9),
                matrix=body.inv().as_matrix(),
                sigma_rad=np.full(3, 0.01 * ARCSEC),
                told_rad_s=rate_rad_s + rng.normal(0.0, noise_arcsec_s * ARCSEC, 3) if told else np.zeros(3),
                solved=True,
                measured=told,
            )
        )
    return out


@pytest.mark.parametrize("told", [True, False])
def test_attitudes_tell_the_rate_better_than_telemetry(told: bool) -> None:
    """0.5 arcsec/s of noise in telemetry, or none at all: rates right to 0.02 arcsec/s, as their errors say."""
    rate = np.array([1e-3, -3e-4, 5e-4])
    found = rates_of(attitudes(rate, 0.5, told=told))
    error = np.array([f.rate_rad_s - rate for f in found]) / ARCSEC
    sigma = np.array([f.sigma_rad_s for f in found]) / ARCSEC
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.abs(error[:, :2] / sigma[:, None]).max() < 5.0


def test_one_frame_has_the_rate_that_it_was_told() -> None:
    """Nothing stands beside it; nor is a frame without stars given a rate by others."""
    rate = np.array([1e-3, 0.0, 0.0])
    frames = attitudes(rate, 0.5)
    (alone,) = rates_of(frames[:1])
    np.testing.assert_array_equal(alone.rate_rad_s, frames[0].told_rad_s)
    dark = [f._replace(solved=False) for f in frames]
    for one, frame in zip(rates_of(dark), dark, strict=True):
        np.testing.assert_array_equal(one.rate_rad_s, frame.told_rad_s)


def test_a_manoeuvre_between_frames_is_left_to_telemetry() -> None:
    """A body that starts to turn in mid-run: frames beside the start keep what they were told to within its noise."""
    slow, fast = np.zeros(3), np.array([0.0, 2e-3, 0.0])
    before, after = attitudes(slow, 0.1)[:10], attitudes(fast, 0.1)
    shift = before[-1].tai_ns - after[0].tai_ns
    moved = [a._replace(tai_ns=a.tai_ns + shift) for a in after[:10]]
    turn = moved[0].matrix.T @ before[-1].matrix
    frames = [*before, *(a._replace(matrix=a.matrix @ turn) for a in moved[1:])]
    found = rates_of(frames)
    worst = max(np.abs(f.rate_rad_s - frame.told_rad_s).max() for f, frame in zip(found, frames, strict=True))
    assert worst < 2.0 * ARCSEC


@pytest.mark.parametrize(("cadence_s", "exposure_s"), [(2.0, 1.0), (0.25, 0.2)])
def test_a_shaking_camera_has_rates_with_their_errors(cadence_s: float, exposure_s: float) -> None:
    """An attitude that walks at random between frames and within them: slopes of exposures are off by what is said, to 15 %.

    The slope is that of a line laid through the attitudes of an exposure, as a trail's line is.
    """
    rng = np.random.default_rng(4)
    step_s, walk = 0.005, 0.3 * ARCSEC**2
    in_exposure, between = round(exposure_s / step_s), round(cadence_s / step_s)
    offs, sigmas = [], []
    for _ in range(20):
        path = np.cumsum(rng.normal(0.0, np.sqrt(walk * step_s), (24 * between, 3)), axis=0)
        seen = path.reshape(24, between, 3)[:, :in_exposure]
        t_s = (np.arange(in_exposure) - 0.5 * (in_exposure - 1)) * step_s
        slope = np.einsum("t,ktj->kj", t_s, seen) / np.sum(t_s**2)
        mean_rate = (seen[:, -1] - seen[:, 0]) / exposure_s
        frames = [
            Attitude(
                tai_ns=2_179_000_000 * 10**9 + round(k * cadence_s * 1e9),
                matrix=(POINTING * Rotation.from_rotvec(seen[k].mean(axis=0))).inv().as_matrix(),
                sigma_rad=np.full(3, 1e-4 * ARCSEC),
                told_rad_s=mean_rate[k] + rng.normal(0.0, 0.5 * ARCSEC, 3),
                solved=True,
                measured=True,
                exposure_s=exposure_s,
            )
            for k in range(24)
        ]
        found = rates_of(frames)[1:-1]
        offs.append(np.array([f.rate_rad_s for f in found])[:, :2] - slope[1:-1, :2])
        sigmas.append(np.array([f.sigma_rad_s for f in found]))
    pulls = np.array(offs) / np.array(sigmas)[..., None]
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1.0, abs=0.15)
