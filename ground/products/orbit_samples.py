"""The posteriors of orbits as weighted states, one table of a run in pieces: what anybody may propagate and associate."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from astropy.table import Column, Table

from ground.orbit.observer import observer_orbit
from ground.orbit.states import elements_of
from ground.sky.eme2000 import frame_bias
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import OrbitEstimate
from sboc_e2e.icd.version import CONTRACT_VERSION

_ORBITS_AT_ONCE: Final = 64  # of 256 samples each: 16,384 rows in memory at once


def orbit_samples_tables(orbits: Sequence[OrbitEstimate], headers: Sequence[FrameHeader]) -> Iterator[Table]:
    """Rows of every tracklet with a state, in the order of the orbits; one empty piece when there is none."""
    held = [orbit for orbit in orbits if orbit.state is not None]
    for low in range(0, max(len(held), 1), _ORBITS_AT_ONCE):
        yield _piece(held[low : low + _ORBITS_AT_ONCE], headers)


def _piece(orbits: Sequence[OrbitEstimate], headers: Sequence[FrameHeader]) -> Table:
    bias = frame_bias()
    path = observer_orbit(headers)
    tracklet, epoch, weight = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    states, ranges = [np.zeros((0, 6))], [np.zeros(0)]
    for orbit in orbits:
        state = orbit.state
        if state is None:
            continue
        n = len(state.sample_weight)
        tracklet.append(np.full(n, orbit.tracklet_id))
        epoch.append(np.full(n, state.t_tai_ns))
        weight.append(state.sample_weight)
        states.append(np.hstack([state.sample_state[:, :3] @ bias.T, state.sample_state[:, 3:] @ bias.T]))
        seen_from = np.full(6, np.nan) if path is None else path.states(np.array([state.t_tai_ns]))[0]
        ranges.append(np.linalg.norm(state.sample_state[:, :3] - seen_from[:3], axis=1))
    all_states = np.vstack(states)
    element = elements_of(all_states)
    columns = [
        ("tracklet_id", np.concatenate(tracklet), None, "tracklet"),
        ("t_tai_ns", np.concatenate(epoch), "ns", "epoch of the state (TAI since 1958)"),
        ("weight", np.concatenate(weight), None, "probability of the sample; the weights of a tracklet sum to one"),
        *((f"{axis}_km", all_states[:, k], "km", "geocentric position, EME2000") for k, axis in enumerate("xyz")),
        *((f"v{axis}_km_s", all_states[:, 3 + k], "km / s", "geocentric velocity, EME2000") for k, axis in enumerate("xyz")),
        ("range_km", np.concatenate(ranges), "km", "distance from the observer at the epoch"),
        ("a_km", element[:, 0], "km", "osculating semi-major axis"),
        ("e", element[:, 1], None, "osculating eccentricity"),
        *(
            (f"{name}_deg", np.degrees(element[:, k]), "deg", f"osculating {text}, EME2000")
            for k, name, text in (
                (2, "i", "inclination"),
                (3, "node", "right ascension of the ascending node"),
                (4, "perigee", "argument of perigee"),
                (5, "mean_anomaly", "mean anomaly"),
            )
        ),
    ]
    made = [Column(values, name=name, unit=unit, description=text) for name, values, unit, text in columns]
    return Table(made, meta={"table": "orbit_samples", "contract_version": CONTRACT_VERSION})
