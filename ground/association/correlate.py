"""New tracklets against orbits that are known: which object each is of, with probabilities, doubt kept.

The likelihood of an object is the Gaussian of the arc's own six numbers about the orbit's prediction, both covariances in it;
what competes is every other object and something unknown, which has a density of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sgp4.api import Satrec

from ground.association.arc import ArcOrbit, coordinates_of
from ground.association.clusters import Orbit, doubt_of
from ground.determination.forces import ForceModel
from ground.determination.propagation import propagate
from ground.orbit.reference import teme_to_gcrs, utc_jd
from sboc_e2e.icd import tai

Array = NDArray[np.float64]

GATE: Final = 35.0
"""Chi2 of six degrees of freedom: one right pair in 200,000 is beyond it."""
_UNKNOWN: Final = 1e4
"""Unknown objects per unit of the six coordinates: a thousand over the whole sky, 40,000 km, 4 km/s and 40 arcsec/s."""
_ELEMENTS_KM: Final = np.array([1.0, 3.0, 1.0])
_ELEMENTS_KM_PER_DAY: Final = np.array([0.3, 3.0, 0.3])
"""One sigma of published mean elements, radial, along, across: an assumption for high orbits, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Predicted:
    """What known orbits say at arcs' epochs: states (n, 6), covariances (n, 6, 6); NaN where an orbit has no state."""

    states: Array
    covariances: Array


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """An object (its place in the list of orbits) for a tracklet: chi2 and probability among all, the unknown one included."""

    known: int
    chi2: float
    probability: float


def predicted(orbit: Orbit, forces: ForceModel, t_tai_ns: NDArray[np.int64]) -> Predicted:
    """Predictions of a numerical orbit."""
    arc = propagate(orbit.state, orbit.t0_tai_ns, t_tai_ns, forces, partials=True)
    covariance = arc.partials @ orbit.covariance @ arc.partials.transpose(0, 2, 1)
    return Predicted(states=arc.states, covariances=covariance)


def predicted_by_elements(satellite: Satrec, t_tai_ns: NDArray[np.int64]) -> Predicted:
    """Predictions of mean elements by SGP4, with the errors that such elements have."""
    one, two = utc_jd(t_tai_ns)
    n = len(t_tai_ns)
    states, covariances = np.full((n, 6), np.nan), np.zeros((n, 6, 6))
    error, place, speed = satellite.sgp4_array(np.asarray(one), np.asarray(two))
    for k in np.flatnonzero(error == 0):
        turn = teme_to_gcrs(int(t_tai_ns[k]))
        states[k] = np.concatenate([turn @ place[k], turn @ speed[k]])
        days = abs((one[k] - satellite.jdsatepoch) + (two[k] - satellite.jdsatepochF))
        sigma = _ELEMENTS_KM + days * _ELEMENTS_KM_PER_DAY
        r, v = states[k, :3], states[k, 3:]
        radial, normal = r / np.linalg.norm(r), np.cross(r, v)
        normal /= np.linalg.norm(normal)
        axes = np.column_stack([radial, np.cross(normal, radial), normal])
        rate = float(np.linalg.norm(v) / np.linalg.norm(r))
        covariances[k, :3, :3] = axes @ np.diag(sigma**2) @ axes.T
        # along the track an error of place is one of time: the speed errs by the rate times that, along the radius
        covariances[k, 3:, 3:] = axes @ np.diag((rate * sigma[[1, 0, 2]]) ** 2) @ axes.T
    return Predicted(states=states, covariances=covariances)


def candidates_of(arc: ArcOrbit, states: Array, covariances: Array, age_days: Array, *, gate: float = GATE) -> list[Candidate]:
    """Objects that an arc may belong to, the likeliest first; empty where none is within the gate.

    states (n, 6) and covariances (n, 6, 6) of all objects at the arc's epoch; age_days (n,) since their data.
    """
    found: list[tuple[int, float, float]] = []
    line = states[:, :3] - arc.observer_km
    with np.errstate(invalid="ignore"):
        facing = np.flatnonzero(line @ arc.axes[2] > 0.9 * np.linalg.norm(line, axis=1))
    for k in facing:
        q, slope = coordinates_of(states[k], arc.observer_km, arc.observer_km_s, arc.axes)
        total = slope @ covariances[k] @ slope.T + doubt_of(arc, float(age_days[k])) + arc.covariance
        scale = np.sqrt(np.diag(total))
        left = (q - arc.mean) / scale
        white = np.linalg.cholesky(total / np.outer(scale, scale))
        chi2 = float((np.linalg.solve(white, left) ** 2).sum())
        if chi2 < gate:
            log_size = float(np.log(np.diag(white)).sum() + np.log(scale).sum() + 3.0 * np.log(2.0 * np.pi))
            found.append((int(k), chi2, -0.5 * chi2 - log_size))
    if not found:
        return []
    logs = np.array([item[2] for item in found] + [np.log(_UNKNOWN)])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    out = [Candidate(known=k, chi2=c, probability=float(w)) for (k, c, _), w in zip(found, weight[:-1], strict=True)]
    return sorted(out, key=lambda c: -c.probability)


def correlate(
    arcs: Sequence[ArcOrbit], orbits: Sequence[tuple[Orbit, ForceModel]], *, gate: float = GATE
) -> list[list[Candidate]]:
    """Candidates of each arc among numerical orbits: one propagation for each orbit."""
    t = _epochs(arcs)
    if not len(t):
        return []
    age = np.array([[abs(int(k) - orbit.t0_tai_ns) / tai.NS_PER_DAY for orbit, _ in orbits] for k in t])
    return _weighed(arcs, [predicted(orbit, forces, t) for orbit, forces in orbits], age, gate)


def correlate_elements(arcs: Sequence[ArcOrbit], known: Sequence[Satrec], *, gate: float = GATE) -> list[list[Candidate]]:
    """Candidates of each arc among mean elements."""
    t = _epochs(arcs)
    return _weighed(arcs, [predicted_by_elements(satellite, t) for satellite in known], np.zeros((len(t), len(known))), gate)


def _epochs(arcs: Sequence[ArcOrbit]) -> NDArray[np.int64]:
    return np.array([a.t_tai_ns for a in arcs], dtype=np.int64)


def _weighed(arcs: Sequence[ArcOrbit], every: Sequence[Predicted], age_days: Array, gate: float) -> list[list[Candidate]]:
    out = []
    for k, arc in enumerate(arcs):
        states = np.array([p.states[k] for p in every]).reshape(-1, 6)
        covariances = np.array([p.covariances[k] for p in every]).reshape(-1, 6, 6)
        out.append(candidates_of(arc, states, covariances, age_days[k], gate=gate))
    return out
