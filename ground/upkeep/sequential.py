"""An orbit renewed by new tracklets alone: a Kalman step from its covariance, without its earlier tracklets."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ground.determination.propagation import propagate
from ground.store.store import StoredOrbit
from ground.upkeep.sightings import KnownOrbit, Sighting
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

SURPRISE: Final = 1e-6
"""Probability of the innovations below which robust weights must look at the directions one by one."""
MOST_CURVED: Final = 0.1
"""Sigmas by which the linear step may miss the way that starts where the step puts the orbit's own epoch. Chosen."""


def renewed(known: KnownOrbit, seen: Sequence[Sighting], made_by: str, now_tai_ns: int) -> StoredOrbit | None:
    """The orbit at the last tracklet's middle; None where the step is too surprising or too long to be linear.

    None also where a tracklet is older than the orbit: what the forces left out in between is part of the orbit's own error, and
    only the fit of all tracklets can tell the two apart. Predicted numbers and covariance meet the whitened directions of one
    tracklet after the other, each with the noise of what forces leave out up to its middle (Tapley, Schutz & Born 2004, section
    4.7, in Joseph's form). All partials are of the orbit as it was, and within a tracklet no noise is added.
    """
    if min(s.t_tai_ns for s in seen) < known.orbit.epoch_tai_ns:
        return None
    size, total = len(known.covariance), 0.0
    step, covariance = np.zeros(size), known.covariance
    numbers, noise = np.eye(size), np.zeros((size, size))
    in_order = sorted(seen, key=lambda s: s.t_tai_ns)
    for one in in_order:
        onward = one.numbers @ np.linalg.inv(numbers)
        prior = onward @ covariance @ onward.T + one.noise - onward @ noise @ onward.T
        numbers, noise, step = one.numbers, one.noise, onward @ step
        slope = one.slope @ np.linalg.inv(numbers)
        value = one.residual + slope @ step
        innovation = slope @ prior @ slope.T + np.eye(len(value))
        gain = np.linalg.solve(innovation, slope @ prior).T
        total += float(value @ np.linalg.solve(innovation, value))
        step = step - gain @ value
        rest = np.eye(size) - gain @ slope
        covariance = rest @ prior @ rest.T + gain @ gain.T
        covariance = 0.5 * (covariance + covariance.T)
    last, n = in_order[-1], sum(len(s.residual) for s in seen)
    parameters = {name: x + float(d) for (name, x), d in zip(known.orbit.parameters.items(), step[6:], strict=True)}
    if chi2.sf(total, n) < SURPRISE or not _is_linear(known, last, step, covariance, parameters):
        return None
    return replace(
        known.orbit,
        epoch_tai_ns=last.t_tai_ns,
        state=last.state + step[:6],
        covariance=covariance,
        made_tai_ns=now_tai_ns,
        made_by=made_by,
        parameters=parameters,
        chi2_nu=total / n,
        n_used=known.orbit.n_used + n,
    )


def _is_linear(known: KnownOrbit, last: Sighting, step: Array, covariance: Array, parameters: Mapping[str, float]) -> bool:
    """Whether the orbit's epoch, moved by the step, leads to the last tracklet's epoch moved by the step.

    A small step in place may come with a large one in velocity: 10 m/s bend a geostationary way by 4 km within a day. Steps
    whose square is small beside the best known direction of place are not followed.
    """
    first = np.linalg.solve(last.numbers, step)
    radius, speed = (float(np.linalg.norm(last.state[part])) for part in (slice(3), slice(3, 6)))
    turned = max(
        float(np.linalg.norm(s[part])) / size for s in (first, step) for part, size in ((slice(3), radius), (slice(3, 6), speed))
    )
    phase_rad = speed / radius * abs(last.t_tai_ns - known.orbit.epoch_tai_ns) * 1e-9
    sharpest_km = float(np.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[0]), 0.0)))
    if radius * turned**2 * (1.0 + 3.0 * phase_rad) < MOST_CURVED * sharpest_km:
        return True
    forces = known.forces.with_values(tuple(parameters), list(parameters.values()))
    at = np.array([last.t_tai_ns], dtype=np.int64)
    try:
        there = propagate(known.orbit.state + first[:6], known.orbit.epoch_tai_ns, at, forces).states[0]
    except UserError:
        # the moved orbit meets the Earth: the batch fit of all tracklets decides
        return False
    scale = np.sqrt(np.diag(covariance)[:6])
    off = (there - last.state - step[:6]) / scale
    return bool(off @ np.linalg.solve(covariance[:6, :6] / np.outer(scale, scale), off) <= MOST_CURVED**2)
