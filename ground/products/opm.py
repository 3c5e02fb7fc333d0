"""CCSDS Orbit Parameter Message 2.0 (502.0-B-2), KVN: the state of one tracklet's object."""

import numpy as np

from ground.options import ProductOptions
from ground.orbit.dynamics import MU_KM3_S2
from ground.orbit.states import elements_of
from ground.products.ccsds_covariance import keyword_lines, turned
from ground.products.epochs import utc_text
from ground.products.kvn_comments import comment_lines
from ground.sky.eme2000 import frame_bias
from sboc_e2e.icd.products import OrbitEstimate

SAMPLES_NAME = "orbit_samples.ecsv"


def opm_text(estimate: OrbitEstimate, names: ProductOptions, created_tai_ns: int) -> str | None:
    """The message: mean and covariance where they describe the posterior, else its most central sample without a covariance.

    None for an estimate without a state. created_tai_ns : the epoch of the last frame, so that the same data give the same bytes.
    """
    state = estimate.state
    if state is None:
        return None
    bias = frame_bias()
    if state.gaussian:
        chosen = state.mean
        kind = ["State and covariance: mean and second moments of this tracklet's posterior, which is Gaussian by the test below"]
    else:
        chosen = _most_central(state.sample_state, state.mean, state.covariance)
        kind = [
            "The posterior is NOT Gaussian by the test below: no covariance is given",
            f"State: the most central of the samples in {SAMPLES_NAME}, one of many that fit as well; use the samples",
        ]
    place, velocity = bias @ chosen[:3], bias @ chosen[3:]
    a, e, i, node, perigee, anomaly = elements_of(np.concatenate([place, velocity])[None])[0]
    lines = [
        "CCSDS_OPM_VERS = 2.0",
        f"CREATION_DATE = {utc_text([created_tai_ns], 3)[0]}",
        f"ORIGINATOR = {names.originator}",
        f"COMMENT Orbit of tracklet {estimate.tracklet_id} from an arc of seconds: the prior carries the range",
        *comment_lines(f"Prior: {estimate.prior}"),
        *(line for text in kind for line in comment_lines(text)),
        *comment_lines(f"Test: {state.shape}"),
        "COMMENT The object was in this state at EPOCH: light time is removed; epochs are those of the on-board clock",
        "COMMENT Range {1:.4g} km, 90 % of the posterior in {0:.4g} to {2:.4g}".format(*estimate.range_km),
        f"OBJECT_NAME = UCT-{estimate.tracklet_id:06d}",
        "OBJECT_ID = UNKNOWN",
        "CENTER_NAME = EARTH",
        "REF_FRAME = EME2000",
        "TIME_SYSTEM = UTC",
        f"EPOCH = {utc_text([state.t_tai_ns])[0]}",
        *(f"{name} = {value:.6f}" for name, value in zip(("X", "Y", "Z"), place, strict=True)),
        *(f"{name} = {value:.9f}" for name, value in zip(("X_DOT", "Y_DOT", "Z_DOT"), velocity, strict=True)),
    ]
    if a > 0.0 and e < 1.0:
        lines += [
            "COMMENT Osculating elements of this state",
            f"SEMI_MAJOR_AXIS = {a:.6f}",
            f"ECCENTRICITY = {e:.9f}",
            *(
                f"{name} = {np.degrees(angle):.9f}"
                for name, angle in (("INCLINATION", i), ("RA_OF_ASC_NODE", node), ("ARG_OF_PERICENTER", perigee))
            ),
            f"MEAN_ANOMALY = {np.degrees(anomaly):.9f}",
            f"GM = {MU_KM3_S2:.4f}",
        ]
    if state.gaussian:
        lines += ["COV_REF_FRAME = EME2000", *keyword_lines(turned(state.covariance, bias))]
    return "\n".join(lines) + "\n"


def _most_central(samples: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The sample (6,) of those (n, 6) that is nearest to the mean in units of the covariance."""
    scale = np.sqrt(np.diag(covariance))
    value, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    away = ((samples - mean) / scale) @ axes / np.sqrt(np.maximum(value, 1e-14))
    return np.asarray(samples[int(np.argmin((away**2).sum(axis=1)))])
