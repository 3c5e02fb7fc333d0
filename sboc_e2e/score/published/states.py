"""Published orbit states against the true ones: errors, covariances, samples."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from sboc_e2e.score.figures import Figure, bootstrap_by_owner, exact, proportion
from sboc_e2e.score.published.gravity import GM_KM3_S2
from sboc_e2e.score.published.opm_reader import PublishedState
from sboc_e2e.score.published.samples_reader import StateSamples
from sboc_e2e.score.published.true_motion import TrueObserver
from sboc_e2e.score.published.true_states import TrueOrbits

Array = NDArray[np.float64]

_WITHIN_90: Final = float(stats.chi2.ppf(0.9, 6))
_MEDIAN_CHI2: Final = float(stats.chi2.ppf(0.5, 6))


def state_figures(
    states: Sequence[PublishedState],
    samples: Sequence[StateSamples],
    n_tracklets: int,
    owner: Mapping[int, int],
    orbits: TrueOrbits,
    observer: TrueObserver | None,
) -> dict[str, Any]:
    """Section `products.states`. owner : tracklet -> object, -1 for none. n_tracklets : rows of tracklets.ecsv."""
    single: dict[str, list[float]] = {name: [] for name in ("owner", "position", "velocity", "chi2")}
    n_wrong = 0
    for state in states:
        number = owner.get(state.tracklet_id, -1)
        true = orbits.state(number, state.t_tai_ns)
        if true is None:
            continue
        error = state.state - true
        chi2 = np.nan
        if state.covariance is not None:
            chi2 = _chi2(error, state.covariance)
            n_wrong += not np.isfinite(chi2)
        for name, value in zip(single, (number, _length(error[:3]), _length(error[3:]), chi2), strict=True):
            single[name].append(float(value))
    cloud: dict[str, list[float]] = {name: [] for name in ("owner", "position", "velocity", "range", "energy")}
    for sample in samples:
        number = owner.get(sample.tracklet_id, -1)
        true = orbits.state(number, sample.t_tai_ns)
        if true is None or observer is None:
            continue
        error = sample.weight @ sample.state - true
        place = observer.at(np.array([sample.t_tai_ns]))[0, :3] * 1e-3
        away = np.linalg.norm(sample.state[:, :3] - place, axis=1)
        distance = _inside_90(away, sample.weight, _length(true[:3] - place))
        energy = _inside_90(_energy(sample.state), sample.weight, float(_energy(true[None])[0]))
        for name, value in zip(cloud, (number, _length(error[:3]), _length(error[3:]), distance, energy), strict=True):
            cloud[name].append(float(value))
    if not states and not samples:
        none = "no orbit state was published (products/*.opm, a table of samples)"
    elif not orbits:
        none = "the truth gives no states of objects (range_km of truth/streaks.ecsv, a_km of truth/objects.ecsv, the camera's)"
    else:
        none = "no state of a true object was published"
    no_state = none if not states or none.startswith("the truth") else "no state of a true object was published"
    no_cloud = none if samples or none.startswith("the truth") else "no samples were published"
    covered = np.array([c for c in single["chi2"] if np.isfinite(c)])
    published = {s.tracklet_id for s in states if s.covariance is not None}
    sampled = {s.tracklet_id for s in samples}

    def median(rows: dict[str, list[float]], name: str, reason: str) -> Figure:
        return _over(rows, name, lambda v: float(np.median(v)), reason)

    def share(rows: dict[str, list[float]], name: str, reason: str) -> Figure:
        known = [v for v in rows[name] if np.isfinite(v)]
        return proportion(int(sum(known)), len(known), reason)

    no_covariance = "no covariance of a true object was published" if single["owner"] else no_state
    return {
        "n_states": exact(len(states), len(states)),
        "n_sampled": exact(len(sampled), len(sampled)),
        "covariance_share": proportion(len(published), max(n_tracklets, len(published)), "no tracklet was published"),
        "samples_share": proportion(len(sampled), max(n_tracklets, len(sampled)), "no tracklet was published"),
        "position_error_median_km": median(single, "position", no_state),
        "velocity_error_median_km_s": median(single, "velocity", no_state),
        "nees": _over(single, "chi2", lambda v: float(np.mean(v)) / 6.0, no_covariance),
        "nees_median": _over(single, "chi2", lambda v: float(np.median(v)) / _MEDIAN_CHI2, no_covariance),
        "coverage_90": proportion(int((covered <= _WITHIN_90).sum()), len(covered), no_covariance),
        "n_not_positive": exact(n_wrong, len(single["owner"])),
        "samples_position_error_median_km": median(cloud, "position", no_cloud),
        "samples_velocity_error_median_km_s": median(cloud, "velocity", no_cloud),
        "samples_range_coverage_90": share(cloud, "range", no_cloud),
        "samples_energy_coverage_90": share(cloud, "energy", no_cloud),
    }


def _over(rows: dict[str, list[float]], name: str, statistic: Any, reason: str) -> Figure:
    values, whose = np.array(rows[name], dtype=np.float64), np.array(rows["owner"], dtype=np.float64)
    known = np.isfinite(values)
    return bootstrap_by_owner(values[known], whose[known], statistic, "too few to measure" if known.any() else reason)


def _chi2(error: Array, covariance: Array) -> float:
    """e' C^-1 e; NaN where the matrix is no covariance. Scaled first: km2 and km2/s2 differ by a million."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not (sigma > 0.0).all():
        return float("nan")
    try:
        lower = np.linalg.cholesky(covariance / np.outer(sigma, sigma))
    except np.linalg.LinAlgError:
        return float("nan")
    return float(np.sum(np.linalg.solve(lower, error / sigma) ** 2))


def _length(vector: Array) -> float:
    return float(np.linalg.norm(vector))


def _energy(state: Array) -> Array:
    """Energy of orbits by mass (n,), km2/s2, of states (n, 6)."""
    return np.asarray(0.5 * np.sum(state[:, 3:] ** 2, axis=1) - GM_KM3_S2 / np.linalg.norm(state[:, :3], axis=1))


def _inside_90(values: Array, weight: Array, true: float) -> float:
    """1.0 where the true value lies between the 5 % and the 95 % point of weighted samples, 0.0 elsewhere."""
    if not np.isfinite(true):
        return float("nan")
    below = float(weight[values < true].sum()) + 0.5 * float(weight[values == true].sum())
    return float(0.05 <= below <= 0.95)
