"""Orbit figures: coverage of 90 % intervals, errors of range, altitude and inclination, trivial roots, cost; Gauss as a peer.

Encounters come from tests/orbit/encounters.py: Kessler's spatial density, the size law and a S/N limit, an adaptive integrator.
"""

import json
import math
import time
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import beta

from ground.orbit import RangeScan
from sboc_e2e.icd.products import OrbitEstimate, Tracklet
from tests.orbit.encounters import MU, PIXEL_ARCSEC, T0_NS, draw_encounters, observed, sun_and_observer, trajectory

SIZE_EDGES_M = (0.0, 0.003, 0.01, 0.1, 100.0)


def share(k: int, n: int) -> dict[str, Any]:
    """A proportion with its 90 % Clopper-Pearson interval."""
    low = 0.0 if k == 0 else float(beta.ppf(0.05, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(0.95, k + 1, n - k))
    return {"value": k / n, "n": n, "interval": [low, high]}


def median(values: NDArray[np.float64], rng: np.random.Generator) -> dict[str, Any]:
    """A median with its 90 % bootstrap interval."""
    draws = np.median(rng.choice(values, (1000, len(values))), axis=1)
    return {"value": float(np.median(values)), "n": len(values), "interval": np.percentile(draws, [5.0, 95.0]).tolist()}


def gauss_range_km(tracklet: Tracklet, observer: NDArray[np.float64]) -> float:
    """Range at the middle epoch by Gauss' method (Curtis 2014, algorithm 5.5, without the iterative refinement); NaN if no root.

    observer : state (6,) km, km/s at T0. Of several positive roots the one nearest to a LEO distance is taken.
    """
    pick = [0, len(tracklet.t_tai_ns) // 2, len(tracklet.t_tai_ns) - 1]
    t = (tracklet.t_tai_ns[pick] - T0_NS) * 1e-9
    ra, dec = np.radians(tracklet.ra_deg[pick]), np.radians(tracklet.dec_deg[pick])
    q = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    r = trajectory(observer, t)[:, :3]
    tau1, tau3 = t[0] - t[1], t[2] - t[1]
    tau = tau3 - tau1
    p = np.cross(q[[1, 0, 0]], q[[2, 2, 1]])
    d0 = float(q[0] @ p[0])
    d = r @ p.T
    a = (-d[0, 1] * tau3 / tau + d[1, 1] + d[2, 1] * tau1 / tau) / d0
    b = (d[0, 1] * (tau3**2 - tau**2) * tau3 / tau + d[2, 1] * (tau**2 - tau1**2) * tau1 / tau) / 6.0 / d0
    e = float(r[1] @ q[1])
    r2 = float(r[1] @ r[1])
    roots = np.roots([1.0, 0, -(a * a + 2 * a * e + r2), 0, 0, -2 * MU * b * (a + e), 0, 0, -(MU**2) * b * b])
    real = roots[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 6400.0)].real
    ranges = a + MU * b / real**3
    ranges = ranges[ranges > 0.0]
    return float(ranges[np.argmin(np.abs(np.log(ranges / 1000.0)))]) if len(ranges) else math.nan


def bayes_bound(estimates: list[OrbitEstimate]) -> float:
    """Smallest median of |range / true range - 1| that any estimator can expect if the posteriors are right.

    An estimator r is within t of the truth with the posterior's probability of (r / (1 + t), r / (1 - t)); the best one
    maximises it for each tracklet, and its median error is the t at which the mean of these maxima is one half.
    """
    curves = []
    for estimate in estimates:
        x, mass = np.log(estimate.range_grid_km), estimate.range_posterior * estimate.range_grid_km
        steps = 0.5 * (mass[1:] + mass[:-1]) * np.diff(x)
        curves.append((x, np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()))

    def excess(t: float) -> float:
        width = math.log((1.0 + t) / (1.0 - t))
        best = [float((np.interp(x + width, x, c) - c).max()) for x, c in curves]
        return float(np.mean(best)) - 0.5

    return float(brentq(excess, 1e-5, 0.9, xtol=1e-5)) if excess(1e-5) < 0.0 else 0.0


def stated_errors(estimate: OrbitEstimate) -> NDArray[np.float64]:
    """|posterior median / true range - 1| (200,) of truths drawn from the posterior: spread like those found if it is right."""
    x, mass = np.log(estimate.range_grid_km), estimate.range_posterior * estimate.range_grid_km
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (mass[1:] + mass[:-1]) * np.diff(x))])
    truths = np.exp(np.interp((np.arange(200) + 0.5) / 200.0, cumulative / cumulative[-1], x))
    return np.abs(estimate.range_km[1] / truths - 1.0)


def population(
    n: int, seed: int, *, kind: str, step: RangeScan, error_px: float | None = None, passes: bool = False
) -> dict[str, Any]:
    """Figures of n encounters; error_px : of every end, both ways, instead of errors that go with the S/N."""
    rng = np.random.default_rng(seed)
    _, observer = sun_and_observer()
    encounters = draw_encounters(n, rng, population=kind, pool=max(400_000, 1000 * n), passes=passes)
    inside = dict.fromkeys(("range", "altitude", "a", "e", "i", "size"), 0)
    errors: dict[str, list[float]] = {name: [] for name in ("range", "mode", "altitude", "a", "i", "size", "gauss")}
    sizes, rates, trivial, spent = [], [], 0, 0.0
    estimates = []
    for one in encounters:
        tracklet, headers = observed(one, rng, error_px=error_px)
        start = time.process_time()
        got = step.estimate(tracklet, headers)
        spent += time.process_time() - start
        altitude = float(np.linalg.norm(one.state[:3])) - 6378.137
        truth = {"range": one.range_km, "altitude": altitude, "a": one.elements[0], "e": one.elements[1], "i": one.elements[2]}
        found = {
            "range": got.range_km,
            "altitude": got.altitude_km,
            "a": got.a_km,
            "e": got.e,
            "i": got.i_deg,
            "size": got.size_m,
        }
        if math.isfinite(one.mag):
            truth["size"] = one.size_m
        for name, value in truth.items():
            inside[name] += int(found[name][0] <= value <= found[name][2])
        errors["range"].append(abs(got.range_km[1] / one.range_km - 1.0))
        errors["mode"].append(abs(got.modes[0, 0] / one.range_km - 1.0))
        estimates.append(got)
        rates.append(one.rate_deg_s)
        errors["altitude"].append(abs(got.altitude_km[1] - altitude))
        errors["a"].append(abs(got.a_km[1] - one.elements[0]))
        errors["i"].append(abs(got.i_deg[1] - one.elements[2]))
        errors["size"].append(abs(got.size_m[1] / one.size_m - 1.0))
        gauss = gauss_range_km(tracklet, observer)
        errors["gauss"].append(abs(gauss / one.range_km - 1.0) if math.isfinite(gauss) else math.inf)
        trivial += int(got.range_km[1] < 0.1 * one.range_km)
        sizes.append(one.size_m)
    table = {name: np.array(values) for name, values in errors.items()}
    boot = np.random.default_rng(0)
    by_size = {}
    for low, high in pairwise(SIZE_EDGES_M):
        chosen = (np.array(sizes) >= low) & (np.array(sizes) < high)
        if chosen.sum() >= 10:
            by_size[f"{1e3 * low:g}-{1e3 * high:g} mm"] = median(table["range"][chosen], boot)
    return {
        "coverage_90": {name: share(count, n) for name, count in inside.items() if name != "size" or kind != "volume"},
        "range_error_median": median(table["range"], boot),
        "range_error_median_of_best_mode": median(table["mode"], boot),
        "range_error_median_stated": float(np.median([stated_errors(estimate) for estimate in estimates])),
        "range_error_median_bayes_bound": bayes_bound(estimates),
        "rate_median_deg_s": float(np.median(rates)),
        "range_error_median_by_size": by_size if kind != "volume" else {},
        "range_within_30_percent": share(int((table["range"] < 0.3).sum()), n),
        "altitude_error_median_km": median(table["altitude"], boot),
        "a_error_median_km": median(table["a"], boot),
        "inclination_error_median_deg": median(table["i"], boot),
        "trivial_root_rate": share(trivial, n),
        "gauss_range_within_30_percent": share(int((table["gauss"] < 0.3).sum()), n),
        "cpu_s_per_tracklet": spent / n,
    }


def main(quick: bool = True) -> dict[str, Any]:
    """Figures by population and prior: each population with its own prior, the natural one with the default (mixed) prior.

    "passes" counts each object once that passes through the field, as tracklets of a long run do; the others count objects in the
    field at an instant, most of which move with the camera at 0.02 deg/s and keep their range to themselves in 10 s.
    "volume" is the set-up of published Monte-Carlos: 1 arcsec errors, catalogued orbits uniform in volume to 3,000 km.
    """
    n = 150 if quick else 500
    start = time.process_time()
    population(1, 0, kind="catalogue", step=RangeScan())
    out: dict[str, Any] = {"cold_s": time.process_time() - start}
    own = RangeScan(breakup_share_small=0.0, breakup_share_large=0.0, albedo_sigma_ln=0.0)
    thrown = RangeScan(breakup_share_small=1.0, breakup_share_large=1.0, albedo_sigma_ln=0.0)
    out["volume_1_arcsec_own_prior"] = population(n, 1, kind="volume", step=own, error_px=1.0 / PIXEL_ARCSEC)
    out["catalogue_own_prior"] = population(n, 1, kind="catalogue", step=own)
    out["breakup_own_prior"] = population(n, 1, kind="breakup", step=thrown)
    out["catalogue_passes_own_prior"] = population(n, 1, kind="catalogue", step=own, passes=True)
    out["breakup_passes_own_prior"] = population(n, 1, kind="breakup", step=thrown, passes=True)
    out["natural_default_prior"] = population(n, 1, kind="natural", step=RangeScan(albedo_sigma_ln=0.0))
    return out


if __name__ == "__main__":
    import sys

    sys.stdout.write(json.dumps(main(quick="--full" not in sys.argv), indent=1) + "\n")
