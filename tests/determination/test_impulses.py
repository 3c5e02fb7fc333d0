"""Fits of orbits that unknown accelerations push: the errors that they state over ten days, with and without process noise."""

import numpy as np
import pytest

from ground.determination.batch import FitOptions, fit
from ground.determination.forces import LEAKS, ForceModel
from ground.determination.impulses import Impulses
from ground.determination.measurements import Directions, Positions, retarded
from ground.determination.propagation import propagate
from sboc_e2e.icd import tai

pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

T0 = 1_800_000_000 * tai.NS_PER_S
FORCES = ForceModel(gravity_degree=4, tides=False, relativity=False)
START = np.array([42_164.0, 0.0, 0.0, 0.0, 3.07, 0.15])
DAYS, PIECE_S = 10, 7200
PUSH_M_S2 = 2e-8
PUSH_KM2_S3 = (1e-3 * PUSH_M_S2) ** 2 * PIECE_S
"""Power density of accelerations that are constant for two hours and independent of each other."""
ARCSEC = np.radians(1.0 / 3600.0)


def pushed(rng: np.random.Generator, t_s: np.ndarray) -> np.ndarray:
    """States (n, 6) at rising times (n,) of an orbit with a new random acceleration every two hours."""
    state, out = START, []
    for piece in range(DAYS * 86_400 // PIECE_S):
        mine = t_s[(t_s >= piece * PIECE_S) & (t_s < (piece + 1) * PIECE_S)]
        first = T0 + piece * PIECE_S * tai.NS_PER_S
        t = first + np.round(np.append(mine - piece * PIECE_S, PIECE_S) * 1e9).astype(np.int64)
        arc = propagate(state, first, t, FORCES.with_values(LEAKS, PUSH_M_S2 * rng.standard_normal(3)))
        out.append(arc.states[:-1])
        state = arc.states[-1]
    return np.vstack(out)


def seen(rng: np.random.Generator, t_s: np.ndarray, states: np.ndarray) -> Directions:
    """Directions of 0.5 arcsec from a low circular orbit."""
    angle = 1.06e-3 * t_s
    observer = 7078.0 * np.column_stack([np.cos(angle), np.zeros(len(t_s)), np.sin(angle)])
    line, rho, _ = retarded(states, observer)
    unit = line / rho[:, None]
    first = np.cross(unit, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(unit, first)], axis=1)
    shown = unit + np.einsum("nij,ni->nj", axes, 0.5 * ARCSEC * rng.standard_normal((len(t_s), 2)))
    return Directions(
        t_tai_ns=T0 + np.round(t_s * 1e9).astype(np.int64), observer_km=observer,
        direction=shown / np.linalg.norm(shown, axis=1, keepdims=True), axes=axes,
        covariance_rad2=np.tile((0.5 * ARCSEC) ** 2 * np.eye(2), (len(t_s), 1, 1)),
    )  # fmt: skip


@pytest.mark.slow
def test_an_arc_of_ten_days_with_accelerations_states_its_error() -> None:
    # two sightings of three minutes a day
    t_s = np.array([43_200.0 * k + 60.0 * j for k in range(1, 2 * DAYS) for j in range(4)])
    nees: dict[float, list[float]] = {0.0: [], PUSH_KM2_S3: []}
    for draw in range(24):
        rng = np.random.default_rng([draw, 5])
        states = pushed(rng, t_s)
        data = seen(rng, t_s, states)
        for push, found in nees.items():
            choice = FitOptions(push_km2_s3=push, huber_sigma=1e3, reject_sigma=1e4)
            solution = fit(states[-1], int(data.t_tai_ns[-1]), [data], FORCES, (), choice)
            away = solution.state - states[-1]
            found.append(float(away @ np.linalg.solve(solution.covariance, away)) / 6.0)
            if push:
                assert solution.converged
                assert not solution.manoeuvre
    # 24 draws of six: one sigma of the mean is 0.12
    assert np.mean(nees[PUSH_KM2_S3]) == pytest.approx(1.0, abs=0.36)
    assert np.mean(nees[0.0]) > 10.0


def test_impulses_act_after_their_epoch_and_hold_the_state_of_the_fit() -> None:
    """Effects by the transition matrices against an orbit that is really pushed, forward and backward."""
    last = T0 + 2 * tai.NS_PER_DAY
    impulses = Impulses.within(T0, last, 1e-18)
    assert len(impulses.t_tai_ns) == 8
    assert impulses.sigma_km_s == pytest.approx(np.full(8, np.sqrt(1e-18 * 21_600.0)))
    t = np.array([T0, last], dtype=np.int64)
    push = np.array([0.0, 0.0, 0.0, 1e-6, 2e-6, -1e-6])
    for t0, other, sign in ((T0, 1, 1.0), (last, 0, -1.0)):
        arc = propagate(START, t0, np.concatenate([t, impulses.t_tai_ns]), FORCES, partials=True)
        effects = impulses.effects(t0, t, arc.partials[:2], arc.partials[2:])
        for k in (0, 5):
            at = int(impulses.t_tai_ns[k])
            before = propagate(START, t0, np.array([at]), FORCES).states[0]
            after = propagate(before + sign * push, at, t, FORCES).states[other]
            expected = after - arc.states[other]
            assert effects[other][:, 3 * k : 3 * k + 3] @ push[3:] == pytest.approx(expected, rel=2e-3, abs=1e-6)
            assert not effects[1 - other].any()


def test_without_accelerations_nothing_is_added() -> None:
    assert len(Impulses.within(T0, T0 + tai.NS_PER_DAY, 0.0).t_tai_ns) == 0
    t = T0 + np.arange(12, dtype=np.int64) * 3600 * tai.NS_PER_S
    data = Positions(t_tai_ns=t, position_km=propagate(START, T0, t, FORCES).states[:, :3], sigma_km=np.full(12, 1e-3))
    plain, doubted = (fit(START + 1e-3, T0, [data], FORCES, (), FitOptions(push_km2_s3=push)) for push in (0.0, 1e-18))
    assert plain.covariance.shape == doubted.covariance.shape == (6, 6)
    assert (np.diag(doubted.covariance) > np.diag(plain.covariance)).all()
