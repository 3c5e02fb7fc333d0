"""The bend that gravity gives a passage, against the second difference of directions between two Kepler orbits."""

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.orbit.dynamics import propagate
from ground.sky.gravity import SPEEDS_M_S, bend_by_gravity
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.frame import ObserverState

Array = NDArray[np.float64]
STEP_S = 2.0


def observer(place_km: Array, velocity_km_s: Array) -> ObserverState:
    """A camera there."""
    return ObserverState(
        tai_ns=0, position_m=1e3 * place_km, velocity_m_s=1e3 * velocity_km_s, sigma_position_m=1.0, sigma_velocity_m_s=0.01
    )


def passage(rng: np.random.Generator) -> tuple[ObserverState, Array, Array, float, float]:
    """Camera, line of sight, a direction across the motion, rate (arcsec/s) and bend (arcsec/s^2) of an object of any range."""
    camera = np.array([7078.0, 0.0, 0.0, 0.0, 7.504, 0.0])
    sight = rng.normal(size=3)
    sight /= np.linalg.norm(sight)
    way = np.cross(sight, rng.normal(size=3))
    way /= np.linalg.norm(way)
    speed = 1e-3 * float(np.exp(rng.uniform(*np.log(SPEEDS_M_S[[0, -1]]))))
    distance = float(np.exp(rng.uniform(np.log(60.0), np.log(3000.0))))
    moved = np.concatenate([distance * sight, speed * way + rng.normal(0.0, 1.0) * sight])
    times = np.array([-STEP_S, 0.0, STEP_S])
    seen = propagate(camera + moved, times)[:, :3] - propagate(camera, times)[:, :3]
    side = np.cross(sight, way)
    across = seen @ side / (seen @ sight) / ARCSEC_RAD
    bend = float(across[0] - 2.0 * across[1] + across[2]) / STEP_S**2
    return observer(camera[:3], camera[3:]), sight, side, speed / distance / ARCSEC_RAD, bend


def test_bends_are_within_the_error_that_is_stated() -> None:
    """400 passages of speeds and ranges at random: few beyond two sigma, none beyond 4; far less than no model leaves."""
    rng = np.random.default_rng(1)
    pulls, bends = [], []
    for _ in range(400):
        camera, sight, side, rate, bend = passage(rng)
        found = bend_by_gravity(camera, sight, side, rate)
        assert found is not None
        pulls.append((bend - found.mean) / found.sigma)
        bends.append([bend, bend - found.mean])
    assert float(np.mean(np.abs(pulls) > 2.0)) < 0.1
    assert float(np.max(np.abs(pulls))) < 4.0
    assert float(np.std(pulls)) == pytest.approx(1.0, abs=0.35)
    assert np.std(np.array(bends)[:, 1]) < 0.5 * np.std(np.array(bends)[:, 0])


def test_a_camera_on_the_ground_or_without_a_place_tells_nothing() -> None:
    """A telescope at rest is not in free fall."""
    sight, side = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    assert bend_by_gravity(None, sight, side, 100.0) is None
    still = observer(np.array([6378.0, 0.0, 0.0]), np.array([0.0, 0.46, 0.0]))
    assert bend_by_gravity(still, sight, side, 100.0) is None
