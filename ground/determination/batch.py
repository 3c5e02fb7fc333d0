"""Batch least squares for a state and force parameters: robust weights, parameters that are considered, a flag for manoeuvres."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ground.determination.forces import PARAMETERS, ForceModel
from ground.determination.impulses import Impulses
from ground.determination.least_squares import adjusted
from ground.determination.measurements import Measurements, Offset
from ground.determination.propagation import propagate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_SURPRISE: Final = 1e-6
"""Probability of the cost of one free orbit below which a manoeuvre is suspected: one of a million right orbits."""
_MOST_REJECTED: Final = 0.2
"""Share of measurements with next to no weight that no sensor's outliers make; then the orbit is wrong. Chosen."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How a fit treats its data.

    huber_sigma : residuals beyond it count with the weight of their inverse. reject_sigma : beyond it not at all.
    considered : parameters that are not estimated although one sigma of them is known: name and sigma; their doubt enters
    the covariance. prior : sigma of estimated parameters about their start, by name; none of a parameter means no prior.
    push_km2_s3 : power density along each axis of white accelerations that the forces leave out. The orbit then is one that they
    push; its state is that at the epoch of the fit.
    """

    huber_sigma: float = 3.0
    reject_sigma: float = 6.0
    considered: tuple[tuple[str, float], ...] = ()
    prior: tuple[tuple[str, float], ...] = ()
    push_km2_s3: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """A fitted orbit at `t0_tai_ns`: state (6,), its covariance with the estimated parameters (6 + k, 6 + k), and how it fits.

    residuals : whitened, (n,) of all measurements in the order given; weights : (n,) in [0, 1]. chi2_nu : of the weighted ones.
    surprise : probability that noise alone makes chi2 so large. manoeuvre : the data do not fit one free orbit: too many were
    rejected, or what is left does not look like their errors. converged : the last step was small.
    """

    t0_tai_ns: int
    state: Array
    forces: ForceModel
    parameters: tuple[str, ...]
    covariance: Array
    residuals: Array
    weights: Array
    chi2_nu: float
    surprise: float
    manoeuvre: bool
    converged: bool
    iterations: int = field(default=0)

    @property
    def rms(self) -> float:
        """Of whitened residuals that count."""
        used = self.weights > 0.0
        return float(np.sqrt(np.mean(self.residuals[used] ** 2))) if used.any() else float("nan")


def fit(
    state: Array,
    t0_tai_ns: int,
    data: Sequence[Measurements],
    forces: ForceModel,
    parameters: tuple[str, ...] = (),
    options: FitOptions | None = None,
) -> Solution:
    """The orbit that fits measurements best, from a start (6,) km, km/s near enough for Gauss-Newton with damping.

    parameters : force parameters to be estimated with the state, at most two of area over mass or five of the empirical ones.
    UserError for names that are unknown and for data that do not determine an orbit.
    """
    options = options or FitOptions()
    considered = tuple(name for name, _ in options.considered)
    for name in (*parameters, *considered):
        if name not in PARAMETERS:
            raise UserError(f'orbit determination: parameter "{name}" is not known; known: {", ".join(PARAMETERS)}')
    if set(parameters) & set(considered):
        raise UserError(f"orbit determination: {', '.join(set(parameters) & set(considered))}: estimated and considered at once")
    epochs = np.concatenate([d.t_tai_ns for d in data]) if data else np.empty(0, dtype=np.int64)
    if len(epochs) == 0:
        raise UserError("orbit determination: no measurements")
    n, own = len(epochs), 6 + len(parameters)
    ends = min(int(epochs.min()), t0_tai_ns), max(int(epochs.max()), t0_tai_ns)
    impulses = Impulses.within(*ends, options.push_km2_s3)
    unknowns = own + 3 * len(impulses.t_tai_ns)
    every = np.concatenate([epochs, impulses.t_tai_ns])

    def linear(x: Array) -> tuple[Array, Array]:
        """Residuals (m,) and partials (m, unknowns + considered) at a state, parameters and impulses."""
        model = forces.with_values(parameters, x[6:own])
        arc = propagate(x[:6], t0_tai_ns, every, model, parameters=(*parameters, *considered), partials=True)
        pushed = impulses.effects(t0_tai_ns, epochs, arc.partials[:n, :, :6], arc.partials[n:, :, :6])
        states = arc.states[:n] + pushed @ x[own:]
        turned = np.concatenate([arc.partials[:n, :, :own], pushed, arc.partials[:n, :, own:]], axis=2)
        residuals, partials, at = [], [], 0
        for kind in data:
            here = slice(at, at + len(kind.t_tai_ns))
            value, slope = kind.residuals(states[here])
            slope = slope @ turned[here]
            if isinstance(kind, Offset):
                value, slope = kind.eliminated(value, slope)
            residuals.append(value.reshape(-1))
            partials.append(slope.reshape(-1, turned.shape[2]))
            at = here.stop
        return np.concatenate(residuals), np.vstack(partials)

    sigma = dict(options.prior)
    start = [forces.value_of(name) for name in parameters]
    spread = np.repeat(impulses.sigma_km_s, 3)
    best = adjusted(
        linear,
        np.concatenate([np.asarray(state, dtype=float), start, np.zeros(len(spread))]),
        np.array([np.inf] * 6 + [sigma.get(name, np.inf) for name in parameters] + spread.tolist()),
        huber_sigma=options.huber_sigma,
        reject_sigma=options.reject_sigma,
    )
    covariance, weights = best.covariance, best.weights
    if considered:
        doubt = np.diag([s**2 for _, s in options.considered])
        gain = covariance @ (best.partials[:, :unknowns] * weights[:, None]).T @ best.partials[:, unknowns:]
        covariance = covariance + gain @ doubt @ gain.T
    used = weights > 0.0
    # an impulse is an unknown and, by its spread, a measurement of it
    nu = max(int(used.sum()) - own, 1)
    total = float((np.minimum(np.abs(best.residuals[used]), options.huber_sigma) ** 2).sum())
    total += float(((best.unknowns[own:] / spread) ** 2).sum())
    surprise = float(chi2.sf(total, nu))
    return Solution(
        t0_tai_ns=t0_tai_ns,
        state=best.unknowns[:6],
        forces=forces.with_values(parameters, best.unknowns[6:own]),
        parameters=parameters,
        covariance=covariance[:own, :own],
        residuals=best.residuals,
        weights=weights,
        chi2_nu=total / nu,
        surprise=surprise,
        manoeuvre=bool(surprise < _SURPRISE or (~used).mean() > _MOST_REJECTED),
        converged=best.converged,
        iterations=best.iterations,
    )
