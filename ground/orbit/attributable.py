"""The directions of a tracklet condensed into a quadratic form, which gives the chi-square of any orbit's curve.

Four numbers are free: direction and rate at the reference epoch. Every orbit can meet them. The rest of the data, the curvature,
constrains range and range rate (Milani et al. 2004, Icarus 170, 152: the attributable).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.link.row_errors import common_errors_arcsec2
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.icd.products import Tracklet

_LONG_ARC_S = 60.0  # from here on the curve has seven nodes, not five: longer arcs bend more. Chosen, not measured


class CurveForm(NamedTuple):
    """What the data demand of a curve's plane coordinates s = (x_1..x_k, y_1..y_k) at epochs node_s (k,) after the reference.

    chi2 = constant - 2 linear.s + s.quadratic.s once the four free numbers are fitted; correction of the rate for a model is
    rate_offset - rate_matrix s (2, 2k).
    """

    node_s: NDArray[np.float64]
    constant: float
    linear: NDArray[np.float64]
    quadratic: NDArray[np.float64]
    rate_offset: NDArray[np.float64]
    rate_matrix: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Attributable:
    """Direction and rate at `t_ref_tai_ns`, and the data's demands on the curve between the nodes.

    axes : (3, 3) rows e1, e2 (tangent plane) and the direction itself. rate_rad_s : (2,) along e1, e2 of the nominal motion.
    rate_covariance : (2, 2) of the form's correction of the rate, rad^2/s^2. In the same way the direction at the reference epoch
    is place_offset - place_matrix s in the tangent plane; covariance (4, 4) of direction and rate together.
    """

    t_ref_tai_ns: int
    axes: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]
    form: CurveForm
    rate_covariance: NDArray[np.float64]
    place_offset: NDArray[np.float64]
    place_matrix: NDArray[np.float64]
    covariance: NDArray[np.float64]


def attributable_of(tracklet: Tracklet, sigma_floor_arcsec: float) -> Attributable | None:
    """The quadratic form of a tracklet; None without two directions at different epochs."""
    good = np.isfinite(tracklet.ra_deg) & np.isfinite(tracklet.dec_deg)
    t_ns = tracklet.t_tai_ns[good]
    if len(t_ns) < 2 or t_ns.max() == t_ns.min():
        return None
    along = _sigma_rad(tracklet.sigma_along_arcsec[good], sigma_floor_arcsec)
    cross = _sigma_rad(tracklet.sigma_cross_arcsec[good], sigma_floor_arcsec)
    unit = unit_vectors(np.radians(tracklet.ra_deg[good]), np.radians(tracklet.dec_deg[good]))
    t_ref_ns = int(t_ns.min()) + int(t_ns.max() - t_ns.min()) // 2
    t_s = np.asarray((t_ns - t_ref_ns) * 1e-9, dtype=np.float64)

    axes = _axes(unit.mean(axis=0))
    nominal = np.zeros(2)
    # the cubic of a near object's passage would go into the rate, and with the speed of its approach into the curvature
    n_epochs = len(np.unique(t_ns))
    n_terms = min(4 if n_epochs >= 6 else 3, n_epochs)
    for _ in range(2):
        plane = unit @ axes[:2].T / (unit @ axes[2])[:, None]
        terms = np.vander(t_s, n_terms, increasing=True)
        coefficients, *_ = np.linalg.lstsq(terms, plane, rcond=None)
        nominal = coefficients[1]
        axes = _axes(axes[2] + coefficients[0] @ axes[:2])
    plane = unit @ axes[:2].T / (unit @ axes[2])[:, None]

    node_s = _chebyshev_nodes(t_s, 5 if np.ptp(t_s) < _LONG_ARC_S else 7)
    interpolation = _lagrange(t_s, node_s)
    along, cross = _widened(plane, t_s, nominal, along, cross)
    weight = _weights(nominal, along, cross, [c[np.ix_(good, good)] * ARCSEC_RAD**2 for c in common_errors_arcsec2(tracklet)])
    m, k = len(t_s), len(node_s)
    design = np.zeros((2 * m, 4))
    design[:m, 0] = design[m:, 1] = 1.0
    design[:m, 2] = design[m:, 3] = t_s
    model = np.zeros((2 * m, 2 * k))
    model[:m, :k] = model[m:, k:] = interpolation
    data = np.concatenate([plane[:, 0], plane[:, 1]])
    covariance = np.asarray(np.linalg.inv(design.T @ weight @ design), dtype=np.float64)
    solve = covariance @ design.T @ weight
    projected = weight - weight @ design @ solve
    projected = 0.5 * (projected + projected.T)
    return Attributable(
        t_ref_tai_ns=t_ref_ns,
        axes=axes,
        rate_rad_s=nominal,
        form=CurveForm(
            node_s=node_s,
            constant=float(data @ projected @ data),
            linear=model.T @ projected @ data,
            quadratic=np.ascontiguousarray(model.T @ projected @ model),
            rate_offset=(solve @ data)[2:],
            rate_matrix=np.ascontiguousarray((solve @ model)[2:]),
        ),
        rate_covariance=covariance[2:, 2:],
        place_offset=(solve @ data)[:2],
        place_matrix=(solve @ model)[:2],
        covariance=covariance,
    )


def _sigma_rad(sigma_arcsec: NDArray[np.float64], floor_arcsec: float) -> NDArray[np.float64]:
    """One sigma with the floor added in quadrature; an unknown sigma counts as three arcsec."""
    known = np.where(np.isfinite(sigma_arcsec) & (sigma_arcsec > 0.0), sigma_arcsec, 3.0)
    return np.asarray(np.hypot(known, floor_arcsec) * ARCSEC_RAD)


def _widened(
    plane: NDArray[np.float64],
    t_s: NDArray[np.float64],
    rate: NDArray[np.float64],
    along: NDArray[np.float64],
    cross: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors (m,), (m,) widened where a smooth passage shows that they are too small: single ends, then all.

    The passage is a straight line at a speed that changes with the range, ``x (1 + kappa t) = x0 + v t``, and a differential
    acceleration of up to 1e-5 rad/s^2. Ends are change points and have tails: weights of a Student distribution (nu = 4).
    """
    m = len(t_s)
    free = 2 * m - 5
    if free < 3:
        return along, cross
    speed = float(np.hypot(*rate))
    heading = rate / speed if speed > 0.0 else np.array([1.0, 0.0])
    frame = np.array([heading, [-heading[1], heading[0]]])
    placed = plane @ frame.T
    sigma = np.column_stack([along, cross])
    zero, one = np.zeros(m), np.ones(m)
    design = np.stack(
        [
            np.column_stack([one, zero, t_s, zero, -t_s * placed[:, 0], 0.5 * t_s**2, zero]),
            np.column_stack([zero, one, zero, t_s, -t_s * placed[:, 1], zero, 0.5 * t_s**2]),
        ],
        axis=1,
    )
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1e-5, 1e-5])
    prior = np.diag([0.0, 0.0, 0.0, 0.0, 0.25, 1.0, 1.0])
    weight = np.ones_like(sigma)
    pull = np.zeros_like(sigma)
    for _ in range(6):
        rows = (design * scale * (np.sqrt(weight) / sigma)[:, :, None]).reshape(-1, 7)
        data = (placed * np.sqrt(weight) / sigma).ravel()
        solution = np.linalg.lstsq(np.vstack([rows, np.sqrt(prior)]), np.concatenate([data, np.zeros(7)]), rcond=None)[0]
        pull = (placed - design @ (scale * solution)) / sigma
        weight = 5.0 / (4.0 + pull**2)
    weight = np.minimum(weight, 1.0)
    excess = max(1.0, float((weight * pull**2).sum()) / free)
    sigma = sigma * np.sqrt(excess / weight)
    return sigma[:, 0], sigma[:, 1]


def _axes(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows: two unit vectors across the direction, and the direction."""
    w = direction / np.linalg.norm(direction)
    helper = np.array([0.0, 0.0, 1.0]) if abs(w[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u = np.cross(helper, w)
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(w, u), w])


def _chebyshev_nodes(t_s: NDArray[np.float64], k: int) -> NDArray[np.float64]:
    """Extrema of the Chebyshev polynomial over the arc, rising, the ends included."""
    middle, half = 0.5 * (t_s.max() + t_s.min()), 0.5 * (t_s.max() - t_s.min())
    return np.asarray(middle - half * np.cos(np.pi * np.arange(k) / (k - 1)))


def _lagrange(t_s: NDArray[np.float64], node_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (m, k) that interpolates values at the nodes to the epochs."""
    out = np.ones((len(t_s), len(node_s)))
    for j, node in enumerate(node_s):
        for i, other in enumerate(node_s):
            if i != j:
                out[:, j] *= (t_s - other) / (node - other)
    return out


def _weights(
    rate: NDArray[np.float64], along: NDArray[np.float64], cross: NDArray[np.float64], common: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Inverse covariance (2m, 2m) of all x, then all y; along and cross refer to the direction of motion.

    common : (m, m) parts of the errors along and across that rows share, in rad^2; what is left of a row's own is at least a
    thousandth of its variance.
    """
    speed = float(np.hypot(*rate))
    cos, sin = rate / speed if speed > 0.0 else (1.0, 0.0)
    own = [np.maximum(s**2 - np.diag(c), 1e-3 * s**2) for s, c in zip((along, cross), common, strict=True)]
    a, b = (np.linalg.inv(np.diag(variance) + c) for variance, c in zip(own, common, strict=True))
    mixed = cos * sin * (a - b)
    return np.block([[cos**2 * a + sin**2 * b, mixed], [mixed, sin**2 * a + cos**2 * b]])
