"""One row for each orbit estimate, see `orbits_table`."""

import json

import numpy as np
from astropy.table import Table

from ground.products.epochs import utc_text
from ground.products.tables.columns import Spec, table_of, texts
from ground.records import GroundProducts
from sboc_e2e.icd.products import OrbitEstimate


def orbits_table(products: GroundProducts) -> Table:
    """One row for each orbit estimate: 5 %, 50 % and 95 % points of the posterior, and its modes as JSON."""
    orbits = products.orbits
    columns: list[Spec] = [
        ("tracklet_id", [o.tracklet_id for o in orbits], None, "tracklet"),
        ("t_ref_utc", texts(utc_text([o.t_ref_tai_ns for o in orbits])), None, "reference epoch"),
        ("t_ref_tai_ns", [o.t_ref_tai_ns for o in orbits], "ns", "reference epoch"),
    ]
    for name, suffix, unit, text in (
        ("range", "_km", "km", "distance"),
        ("altitude", "_km", "km", "height over a sphere of 6378.137 km"),
        ("a", "_km", "km", "semi-major axis"),
        ("e", "", None, "eccentricity"),
        ("i", "_deg", "deg", "inclination"),
        ("size", "_m", "m", "diameter of a Lambert sphere of the albedo in prior, with its scatter"),
    ):
        values = np.array([getattr(o, name + suffix) for o in orbits]).reshape(-1, 3)
        columns += [
            (f"{name}{point}{suffix}", values[:, k], unit, f"{text}, {share} of the posterior")
            for k, (point, share) in enumerate((("_low", "5 %"), ("", "median"), ("_high", "95 %")))
        ]
    for name, text in (
        ("node", "right ascension of the ascending node"),
        ("perigee", "argument of perigee"),
        ("mean_anomaly", "mean anomaly"),
        ("latitude_argument", "angle from the ascending node"),
    ):
        values = np.array([getattr(o, f"{name}_deg") for o in orbits]).reshape(-1, 3)
        columns += [
            (f"{name}{point}_deg", values[:, k], "deg", f"{text}, {share} of the posterior, no jump at 360 beside the median")
            for k, (point, share) in enumerate((("_low", "5 %"), ("", "median"), ("_high", "95 %")))
        ]
    columns += [
        (
            "modes",
            texts([json.dumps(np.round(o.modes, 6).tolist()) for o in orbits]),
            None,
            "[range_km, weight, a_km, e, i_deg] of each mode",
        ),
        ("prior", texts([o.prior for o in orbits]), None, "what was assumed"),
        ("converged", np.array([o.converged for o in orbits], dtype=bool), None, "whether the arc says anything"),
        (
            "gaussian",
            np.array([o.state is not None and o.state.gaussian for o in orbits], dtype=bool),
            None,
            "whether a mean and a covariance describe the posterior of the state (then the OPM has them)",
        ),
        ("state", texts([_state_words(o) for o in orbits]), None, "how Gaussian the state is, or why there is none"),
    ]
    return table_of(columns, "orbits")


def _state_words(orbit: OrbitEstimate) -> str:
    """Figures of the test of a state, or what is lacking for one."""
    if orbit.state is not None:
        return orbit.state.shape
    return f"none: {orbit.lacks}" if orbit.lacks else "none: the orbit step gives no state"
