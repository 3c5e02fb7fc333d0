"""An orbit renewed by new tracklets alone: a Kalman step from its covariance, without its earlier tracklets."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ground.store.store import StoredOrbit
from ground.upkeep.sightings import KnownOrbit, Sighting

Array = NDArray[np.float64]

SURPRISE: Final = 1e-6
"""Probability of the innovations below which robust weights must look at the directions one by one."""
MOST_CURVED: Final = 0.1
"""Sigmas of place by which the way bends within the step."""


def renewed(known: KnownOrbit, seen: Sequence[Sighting], made_by: str, now_tai_ns: int) -> StoredOrbit | None:
    """The orbit at the last tracklet's middle; None where the step is too surprising or too long to be linear.

    Predicted numbers and covariance at that epoch, with the noise of what forces leave out, meet the whitened directions of all
    tracklets (Tapley, Schutz & Born 2004, section 4.7, in Joseph's form).
    """
    last = max(seen, key=lambda s: s.t_tai_ns)
    value = np.concatenate([s.residual for s in seen])
    slope = np.vstack([s.slope for s in seen]) @ np.linalg.inv(last.numbers)
    prior = last.numbers @ known.covariance @ last.numbers.T + last.noise
    innovation = slope @ prior @ slope.T + np.eye(len(value))
    gain = np.linalg.solve(innovation, slope @ prior).T
    total = float(value @ np.linalg.solve(innovation, value))
    step = -gain @ value
    rest = np.eye(len(prior)) - gain @ slope
    covariance = rest @ prior @ rest.T + gain @ gain.T
    covariance = 0.5 * (covariance + covariance.T)
    radius = float(np.linalg.norm(last.state[:3]))
    bend = float(step[:3] @ step[:3]) / (2.0 * radius**2) * last.state[:3]
    if chi2.sf(total, len(value)) < SURPRISE or bend @ np.linalg.solve(covariance[:3, :3], bend) > MOST_CURVED**2:
        return None
    parameters = {name: x + float(d) for (name, x), d in zip(known.orbit.parameters.items(), step[6:], strict=True)}
    return replace(
        known.orbit,
        epoch_tai_ns=last.t_tai_ns,
        state=last.state + step[:6],
        covariance=covariance,
        made_tai_ns=now_tai_ns,
        made_by=made_by,
        parameters=parameters,
        chi2_nu=total / len(value),
        n_used=known.orbit.n_used + len(value),
    )
