"""The published ephemeris of the camera against its true motion, and its velocities against its own positions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from sboc_e2e.score.figures import CONFIDENCE, Figure, absent, bootstrap, exact, figure
from sboc_e2e.score.published.oem_reader import Ephemeris
from sboc_e2e.score.published.true_motion import TrueObserver

Array = NDArray[np.float64]

_FEW = "fewer than three states"


def observer_figures(ephemerides: Sequence[Ephemeris], truth: TrueObserver | None) -> dict[str, Any]:
    """Section `products.observer`. truth : None where it gives no states."""
    n = sum(len(e.t_tai_ns) for e in ephemerides)
    steps = np.concatenate([np.zeros((0, 3)), *(_implied_minus_quoted(e) for e in ephemerides)])
    if truth is None:
        why = "the truth gives no states of the camera (position_m and velocity_m_s of truth/frames.ecsv)"
    else:
        why = "no published state lies within the truth's time"
    at_nodes = np.concatenate([np.zeros((0, 6)), *(_errors_at_nodes(e, truth) for e in ephemerides)])
    between = np.concatenate([np.zeros((0, 6)), *(_errors_between(e, truth) for e in ephemerides)])

    def length_rms(errors: Array, reason: str) -> Figure:
        known = errors[np.isfinite(errors).all(axis=1)]
        return bootstrap(known, _length_rms, _FEW if len(known) else reason)

    return {
        "n_states": exact(n, n),
        "position_rms_m": length_rms(at_nodes[:, :3], why),
        "velocity_rms_m_s": length_rms(at_nodes[:, 3:], why),
        "interpolated_position_rms_m": length_rms(between[:, :3], why),
        "interpolated_velocity_rms_m_s": length_rms(between[:, 3:], why),
        "implied_minus_quoted_rms_m_s": length_rms(steps, "fewer than two states"),
        "nees": _nees(ephemerides, at_nodes, why),
    }


def _length_rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors * vectors, axis=1))))


def _errors_at_nodes(e: Ephemeris, truth: TrueObserver | None) -> Array:
    """Published minus true states (n, 6), m and m/s; NaN where the truth does not reach."""
    return np.full((len(e.t_tai_ns), 6), np.nan) if truth is None else e.state * 1e3 - truth.at(e.t_tai_ns)


def _errors_between(e: Ephemeris, truth: TrueObserver | None) -> Array:
    """The same halfway between the states, by the cubic Hermite polynomial that the message asks for."""
    if truth is None or len(e.t_tai_ns) < 2:
        return np.zeros((0, 6))
    half_ns = np.diff(e.t_tai_ns) // 2
    t_ns = e.t_tai_ns[:-1] + half_ns
    origin = int(e.t_tai_ns[0])
    motion = CubicHermiteSpline((e.t_tai_ns - origin) * 1e-9, e.state[:, :3], e.state[:, 3:])
    t_s = (t_ns - origin) * 1e-9
    return np.concatenate([motion(t_s), motion(t_s, 1)], axis=1) * 1e3 - truth.at(t_ns)


def _implied_minus_quoted(e: Ephemeris) -> Array:
    """Mean velocity between states by their positions minus that by their velocities (n - 1, 3), m/s.

    The mean of the velocities is that of the cubic spline through them.
    """
    if len(e.t_tai_ns) < 2:
        return np.zeros((0, 3))
    t_s = (e.t_tai_ns - int(e.t_tai_ns[0])) * 1e-9
    step_s = np.diff(t_s)[:, None]
    way = CubicSpline(t_s, e.state[:, 3:], bc_type="not-a-knot" if len(t_s) > 3 else "natural").antiderivative()
    return (np.diff(e.state[:, :3], axis=0) - np.diff(way(t_s), axis=0)) / step_s * 1e3


def _nees(ephemerides: Sequence[Ephemeris], errors: Array, why: str) -> Figure:
    """Mean of e' C^-1 e / 6 over the states; 1 where the covariances are right.

    States of a fitted orbit share its errors, so that a run shows six numbers, however many states there are: the interval is
    that of one chi-square with six degrees of freedom.
    """
    covariance = np.concatenate([np.zeros((0, 6, 6)), *(e.covariance for e in ephemerides)])
    stated = np.isfinite(covariance).all(axis=(1, 2))
    if not stated.any():
        return absent("no covariance is published", len(covariance))
    known = stated & np.isfinite(errors).all(axis=1)
    if not known.any():
        return absent(why)
    scaled = covariance[known] * 1e6  # km2, km2/s and km2/s2 to metres
    try:
        value = float(np.mean(np.sum(errors[known] * np.linalg.solve(scaled, errors[known][:, :, None])[:, :, 0], axis=1))) / 6.0
    except np.linalg.LinAlgError:
        return absent("a published covariance is singular", int(known.sum()))
    tail = (1 - CONFIDENCE) / 2
    return figure(value, 6, 6.0 * value / stats.chi2.ppf(1 - tail, 6), 6.0 * value / stats.chi2.ppf(tail, 6))
