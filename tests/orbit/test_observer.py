"""The smoothed orbit of the observer against an integrator of its own: steady and fresh errors, outliers, gaps, sites."""

import erfa
import numpy as np
import pytest
from numpy.typing import NDArray

from ground.orbit.observer import ObserverOrbit, observer_orbit
from sboc_e2e.icd import tai
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from tests.orbit.encounters import T0_NS, sun_and_observer, trajectory

SIGMA = np.array([10.0] * 3 + [0.05] * 3)
"""Of a fix, m and m/s."""


def orbiting(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """States (n, 6) km, km/s of a Sun-synchronous orbit with J2."""
    return trajectory(sun_and_observer()[1], t_s)


def on_the_ground(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """A point at 38 deg north that turns with the Earth (ERFA, precession-nutation of 2006, no polar motion)."""
    fixed = np.array([5000.0, -580.0, 3920.0])
    out = []
    for t in t_s:
        day, fraction = tai.to_jd_parts(T0_NS + round(t * 1e9))
        rotation = erfa.c2t06a(*erfa.taitt(day, fraction), *erfa.taiutc(day, fraction), 0.0, 0.0)
        spin = np.array([0.0, 0.0, 7.292115e-5])
        out.append(np.concatenate([rotation.T @ fixed, rotation.T @ np.cross(spin, fixed)]))
    return np.array(out)


def headers_of(states_km: NDArray[np.float64], t_s: NDArray[np.float64], error: NDArray[np.float64]) -> list[FrameHeader]:
    """Headers with fixes (n, 6) that err by `error` (n, 6) m, m/s."""
    made = []
    for k, (t, state) in enumerate(zip(t_s, 1e3 * states_km + error, strict=True)):
        t_ns = T0_NS + round(t * 1e9)
        fix = ObserverState(
            tai_ns=t_ns, position_m=state[:3], velocity_m_s=state[3:], sigma_position_m=SIGMA[0], sigma_velocity_m_s=SIGMA[3]
        )
        made.append(
            FrameHeader(
                frame=k, t_start_tai_ns=t_ns, exposure_ns=200_000_000, line_time_ns=10_000, rows=64, cols=64, observer=fix
            )
        )
    return made


def errors(n: int, steady: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Errors of fixes (n, 6) m, m/s of which a share of the variance is common to all."""
    return SIGMA * (np.sqrt(steady) * rng.standard_normal(6) + np.sqrt(1.0 - steady) * rng.standard_normal((n, 6)))


def found(headers: list[FrameHeader]) -> ObserverOrbit:
    orbit = observer_orbit(headers)
    assert orbit is not None
    return orbit


@pytest.mark.parametrize("n", [1, 24, 300])
@pytest.mark.slow
def test_covariance_is_honest_whatever_fixes_have_in_common(n: int) -> None:
    """60 runs with 70 % of the variance common: NEES of the state in mid-run within four standard deviations of one."""
    rng = np.random.default_rng(4)
    t_s = 0.25 * np.arange(n)
    truth = orbiting(t_s)
    nees = []
    for _ in range(60):
        orbit = found(headers_of(truth, t_s, errors(n, 0.7, rng)))
        at = np.array([T0_NS + round(t_s[n // 2] * 1e9)])
        off = orbit.states(at)[0] - truth[n // 2]
        nees.append(off @ np.linalg.solve(orbit.covariances(at)[0], off) / 6.0)
    assert np.mean(nees) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 6.0 / 60.0))


def test_positions_and_velocities_belong_together() -> None:
    """300 fixes of 10 m: differences of positions over a second are the quoted velocities to 1 mm/s; of the fixes, 20 m/s."""
    rng = np.random.default_rng(1)
    t_s = 0.25 * np.arange(300)
    headers = headers_of(orbiting(t_s), t_s, errors(300, 0.0, rng))
    t_ns = np.array([h.t_start_tai_ns for h in headers])
    orbit = found(headers)
    half_s = 500_000_000
    implied = orbit.states(t_ns + half_s)[:, :3] - orbit.states(t_ns - half_s)[:, :3]
    assert np.sqrt(((implied - orbit.states(t_ns)[:, 3:]) ** 2).sum(axis=1).mean()) < 2e-6
    fixes = np.array([h.observer.position_m for h in headers if h.observer is not None])
    assert np.linalg.norm((fixes[4:] - fixes[:-4]) - 1e3 * orbit.states(t_ns)[2:-2, 3:], axis=1).mean() > 10.0


def test_outliers_and_gaps() -> None:
    """Fixes that are kilometres off are left out and counted; between fixes 300 s apart the orbit is still good to its sigma."""
    rng = np.random.default_rng(2)
    t_s = np.concatenate([0.25 * np.arange(24), 300.0 + 0.25 * np.arange(24)])
    error = errors(48, 0.7, rng)
    error[[0, 10, 11, 30]] += rng.normal(0.0, 1e4, (4, 6))
    orbit = found(headers_of(orbiting(t_s), t_s, error))
    (arc,) = orbit.arcs
    assert arc.n_rejected == 4
    middle = np.array([150.0])
    at = T0_NS + np.round(middle * 1e9).astype(np.int64)
    off = (orbit.states(at) - orbiting(middle))[0]
    sigma = np.sqrt(np.diag(orbit.covariances(at)[0]))
    assert (np.abs(off) < 4.0 * sigma).all()
    assert (np.abs(off[:3]) < 0.1).all()


def test_arcs_end_where_nothing_is_known() -> None:
    """Hours between fixes make two arcs; in between, and a minute from any fix, there is no state; no fix, no orbit."""
    rng = np.random.default_rng(3)
    t_s = np.concatenate([np.arange(4.0), 7200.0 + np.arange(4.0)])
    headers = headers_of(orbiting(t_s), t_s, errors(8, 0.7, rng))
    orbit = found(headers)
    assert len(orbit.arcs) == 2
    states = orbit.states(T0_NS + np.array([1, 62, 3600, 7201]) * 1_000_000_000)
    assert np.isfinite(states).all(axis=1).tolist() == [True, True, False, True]
    assert observer_orbit([]) is None


@pytest.mark.parametrize("n", [1, 8])
def test_a_site_turns_with_the_earth(n: int) -> None:
    """From one fix or eight: its velocity to 5 mm/s, its path a minute on to the error of the fixes, not 9.8 m/s2 below it."""
    rng = np.random.default_rng(5)
    t_s = 5.0 * np.arange(n)
    orbit = found(headers_of(on_the_ground(t_s), t_s, errors(n, 0.7, rng)))
    assert orbit.arcs[0].kind == "site"
    later = np.array([t_s[-1] + 55.0])
    at = T0_NS + np.round(later * 1e9).astype(np.int64)
    off = 1e3 * (orbit.states(at) - on_the_ground(later))[0]
    assert (np.abs(off[:3]) < 40.0).all()
    assert (np.abs(off[3:]) < 5e-3).all()
