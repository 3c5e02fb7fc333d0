"""Coarse orbits beside Orekit's Gooding and Gauss on the same tracklets: optional, needs the extra `orekit` and Java 11 or newer.

Orekit works in its GCRF with epochs of its own here, so that it needs none of its data files. Each method gets three directions,
at the ends and in the middle of the arc, from a quadratic through all directions of the tracklet (better than any three of them),
and the observer's true positions there; Gooding starts from the true ranges times 1.3. Light time is left to the epochs.
"""

import importlib.util
import json
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.orbit import RangeScan
from sboc_e2e.icd.products import Tracklet
from tests.benchmarks.bench_orbit import median, share
from tests.orbit.encounters import LIGHT_KM_S, MU, PIXEL_ARCSEC, T0_NS, draw_encounters, observed, sun_and_observer, trajectory

ABSENT = "Orekit is not installed: pip install sboc-e2e[orekit], and Java 11 or newer"
START_OFF = 1.3
TRIVIAL = 0.1
"""Ranges below this part of the truth are the observer's own orbit found again."""

Vectors = NDArray[np.float64]
Method = Callable[[Vectors, Vectors, Vectors, float], float]
"""Epochs (3,) s, directions (3, 3), observer (3, 3) km and a range (km) to start from -> range at the middle (km) or NaN."""


def orekit() -> dict[str, Method] | None:
    """Gooding's and Gauss' method, None when they are not installed."""
    if importlib.util.find_spec("orekit_jpype") is None:
        return None
    import orekit_jpype

    try:
        orekit_jpype.initVM()
    except Exception as error:  # noqa: BLE001  whatever a Java machine that is absent or too old raises
        sys.stderr.write(f"{ABSENT} ({error})\n")
        return None
    from jpype import JException
    from org.hipparchus.geometry.euclidean.threed import Vector3D
    from org.orekit.estimation.iod import IodGauss, IodGooding
    from org.orekit.frames import FramesFactory
    from org.orekit.time import AbsoluteDate

    frame, epoch = FramesFactory.getGCRF(), AbsoluteDate.ARBITRARY_EPOCH

    def vectors(rows: Vectors, scale: float = 1.0) -> list[Any]:
        return [Vector3D(*(float(scale * x) for x in row)) for row in rows]

    def range_km(estimate: Callable[[], Any], observer: Vectors) -> float:
        try:
            orbit = estimate()
        except JException:
            return math.nan
        if orbit is None:  # Gauss' polynomial has no positive root
            return math.nan
        found = orbit.getPosition()
        return float(np.linalg.norm(np.array([found.getX(), found.getY(), found.getZ()]) / 1e3 - observer))

    def gooding(t_s: Vectors, directions: Vectors, observer: Vectors, start_km: float) -> float:
        dates, seen, places = [epoch.shiftedBy(float(t)) for t in t_s], vectors(directions), vectors(observer, 1e3)
        sights = [item for pair in zip(seen, dates, strict=True) for item in pair]
        return range_km(
            lambda: IodGooding(MU * 1e9).estimate(frame, *places, *sights, 1e3 * start_km, 1e3 * start_km), observer[1]
        )

    def gauss(t_s: Vectors, directions: Vectors, observer: Vectors, start_km: float) -> float:
        dates, seen, places = [epoch.shiftedBy(float(t)) for t in t_s], vectors(directions), vectors(observer, 1e3)
        rows = [item for row in zip(places, dates, seen, strict=True) for item in row]
        return range_km(lambda: IodGauss(MU * 1e9).estimate(frame, *rows), observer[1])

    return {"gooding": gooding, "gauss": gauss}


def three_directions(tracklet: Tracklet) -> tuple[Vectors, Vectors]:
    """Epochs (s after T0) and unit vectors (3, 3) at both ends and the middle of the arc: a quadratic through all directions."""
    t_s = (tracklet.t_tai_ns - T0_NS) * 1e-9
    ra, dec = np.radians(tracklet.ra_deg), np.radians(tracklet.dec_deg)
    unit = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    epochs = np.array([t_s[0], 0.5 * (t_s[0] + t_s[-1]), t_s[-1]])
    fitted = np.polynomial.polynomial.polyval(epochs - epochs[1], np.polynomial.polynomial.polyfit(t_s - epochs[1], unit, 2)).T
    return epochs, fitted / np.linalg.norm(fitted, axis=1, keepdims=True)


def figures(found: Sequence[float], truth: Sequence[float]) -> dict[str, Any]:
    """Errors of the range; a method that finds none counts as infinitely wrong."""
    ratio = np.array(found) / np.array(truth)
    error = np.where(np.isfinite(ratio), np.abs(ratio - 1.0), 10.0)
    n = len(error)
    return {
        "range_error_median": median(error, np.random.default_rng(0)),
        "within_10_percent": share(int((error < 0.1).sum()), n),
        "within_30_percent": share(int((error < 0.3).sum()), n),
        "trivial_root_rate": share(int((ratio < TRIVIAL).sum()), n),
        "no_orbit": share(int((~np.isfinite(ratio)).sum()), n),
    }


def side_by_side(methods: dict[str, Method], n: int, seed: int, **how: Any) -> dict[str, Any]:
    """Ours and the peers' ranges of n encounters (arguments of `draw_encounters`; error_px of `observed`)."""
    rng = np.random.default_rng(seed)
    _, observer = sun_and_observer()
    error_px = how.pop("error_px", None)
    step = RangeScan(breakup_share_small=0.0, breakup_share_large=0.0, albedo_sigma_ln=0.0)
    truth: list[float] = []
    found: dict[str, list[float]] = {name: [] for name in ("posterior_median", *methods)}
    for one in draw_encounters(n, rng, pool=max(200_000, 1000 * n), **how):
        tracklet, headers = observed(one, rng, error_px=error_px)
        truth.append(one.range_km)
        found["posterior_median"].append(float(step.estimate(tracklet, headers).range_km[1]))
        epochs, directions = three_directions(tracklet)
        places = trajectory(observer, epochs)[:, :3]
        for name, method in methods.items():
            # light left a range over c earlier, from all three nearly the same
            found[name].append(method(epochs - one.range_km / LIGHT_KM_S, directions, places, START_OFF * one.range_km))
    return {name: figures(ranges, truth) for name, ranges in found.items()}


def main(quick: bool = True) -> dict[str, Any]:
    """Figures of ours and of the peers, or the reason why there are none."""
    methods = orekit()
    if methods is None:
        return {"orekit": {"value": None, "n": 0, "reason": ABSENT}}
    n = 100 if quick else 300
    return {
        "volume_1_arcsec": side_by_side(methods, n, 21, population="volume", error_px=1.0 / PIXEL_ARCSEC),
        "catalogue_passes": side_by_side(methods, n, 21, population="catalogue", passes=True),
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(quick="--full" not in sys.argv), indent=1) + "\n")
