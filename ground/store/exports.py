"""Orbits of the store as messages that others read: OPM and OEM (CCSDS 502.0-B-2), OMM for SGP4, and parquet tables."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import erfa
import numpy as np
from sgp4.api import Satrec

from ground.determination.forces import propagator
from ground.determination.propagation import instant, propagate
from ground.orbit.dynamics import MU_KM3_S2
from ground.orbit.states import elements_of
from ground.products.ccsds_covariance import keyword_lines, triangle_lines, turned
from ground.products.epochs import utc_text
from ground.products.oem import metadata_lines, state_lines
from ground.sky.eme2000 import frame_bias
from ground.store.forces import carried, forces_of
from ground.store.store import ObjectStore, StoredOrbit
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

_OEM_STEP_S: Final = 300.0  # nineteen states in a low revolution, for the interpolation that the message asks for
_OEM_DEGREE: Final = 7  # of the interpolation, which needs one state more
_MEAN_STATES: Final = 97  # every 15 minutes of a day, and the middle is one of them
_LARGEST_MEAN_KM: Final = 50.0
"""SGP4 is good to some kilometres over a day; beyond this it describes another orbit. Chosen, not measured."""


def _head(kind: str, orbit: StoredOrbit, originator: str) -> list[str]:
    return [f"CCSDS_{kind}_VERS = 2.0", f"CREATION_DATE = {utc_text([orbit.made_tai_ns], 3)[0]}", f"ORIGINATOR = {originator}"]


def opm(orbit: StoredOrbit, name: str, originator: str) -> str:
    """The current state with osculating elements and covariance."""
    bias = frame_bias()
    state = np.concatenate([bias @ orbit.state[:3], bias @ orbit.state[3:]])
    a, e, i, node, perigee, anomaly = elements_of(state[None])[0]
    lines = [
        *_head("OPM", orbit, originator),
        f"COMMENT Fitted by {orbit.made_by}: {orbit.n_used} measurements, chi2/nu {orbit.chi2_nu:.3f}",
        f"OBJECT_NAME = {name}",
        "OBJECT_ID = UNKNOWN",
        "CENTER_NAME = EARTH",
        "REF_FRAME = EME2000",
        "TIME_SYSTEM = UTC",
        f"EPOCH = {utc_text([orbit.epoch_tai_ns])[0]}",
        *(f"{key} = {value:.6f}" for key, value in zip("XYZ", state[:3], strict=True)),
        *(f"{key}_DOT = {value:.9f}" for key, value in zip("XYZ", state[3:], strict=True)),
    ]
    if a > 0.0 and e < 1.0:
        angles = (("INCLINATION", i), ("RA_OF_ASC_NODE", node), ("ARG_OF_PERICENTER", perigee), ("MEAN_ANOMALY", anomaly))
        lines += [
            f"SEMI_MAJOR_AXIS = {a:.6f}",
            f"ECCENTRICITY = {e:.9f}",
            *(f"{key} = {np.degrees(value):.9f}" for key, value in angles),
            f"GM = {MU_KM3_S2:.4f}",
        ]
    return "\n".join([*lines, "COV_REF_FRAME = EME2000", *keyword_lines(turned(orbit.state_covariance, bias))]) + "\n"


def oem(orbit: StoredOrbit, name: str, originator: str, days: float) -> str:
    """States every five minutes from the epoch on, numerically propagated, with the covariance of the first and the last.

    Eight states at least, 35 minutes, which the interpolation needs.
    """
    _check_days(days)
    end_s = max(86400.0 * days, _OEM_DEGREE * _OEM_STEP_S)
    t = orbit.epoch_tai_ns + (np.arange(0.0, end_s + 1.0, _OEM_STEP_S) * 1e9).astype(np.int64)
    arc = propagate(orbit.state, orbit.epoch_tai_ns, t, forces_of(orbit))
    _, covariances = carried(orbit, t[[0, -1]])
    bias = frame_bias()
    states = np.hstack([arc.states[:, :3] @ bias.T, arc.states[:, 3:] @ bias.T])
    epochs = utc_text(t)
    covariance = []
    for k, propagated in zip((0, -1), covariances, strict=True):
        covariance += [f"EPOCH = {epochs[k]}", "COV_REF_FRAME = EME2000", *triangle_lines(turned(propagated, bias))]
    meta = metadata_lines(name, "UNKNOWN", epochs, degree=_OEM_DEGREE)
    rows = state_lines(epochs, states)
    head = [*_head("OEM", orbit, originator), ""]
    return "\n".join([*head, *meta, *rows, "", "COVARIANCE_START", *covariance, "COVARIANCE_STOP"]) + "\n"


def _check_days(days: float) -> None:
    if not 0.0 < days <= 30.0:
        raise UserError(f"OEM: days: expected more than 0 and at most 30, got {days:g}")


def mean_elements(orbit: StoredOrbit) -> tuple[Satrec, float]:
    """Elements for SGP4 fitted to a day of the orbit, and the largest distance from it, km. UserError where none fit."""
    satkit = propagator()
    t = orbit.epoch_tai_ns + (np.linspace(-43200.0, 43200.0, _MEAN_STATES) * 1e9).astype(np.int64)
    states = propagate(orbit.state, orbit.epoch_tai_ns, t, forces_of(orbit)).states
    times = [instant(int(epoch)) for epoch in t]
    try:
        tle, _ = satkit.TLE.fit_from_states([1e3 * state for state in states], times, times[_MEAN_STATES // 2])
        tle.satnum = 0
        lines = tle.to_2line()
    except (RuntimeError, ValueError) as error:
        raise UserError(f"OMM: no mean elements fit this orbit: {str(error).splitlines()[0][:100]}") from error
    place, _ = satkit.sgp4(tle, times)
    turned_place = np.array([satkit.frametransform.qteme2gcrf(when) * row for when, row in zip(times, place, strict=True)])
    away = float(np.linalg.norm(1e-3 * turned_place - states[:, :3], axis=1).max())
    if not away <= _LARGEST_MEAN_KM:
        raise UserError(f"OMM: mean elements miss the orbit by {away:.0f} km; SGP4 does not describe it")
    return Satrec.twoline2rv(*lines[-2:]), away


def omm(orbit: StoredOrbit, name: str, originator: str) -> str:
    """Mean elements for SGP4 at the epoch."""
    mean, away = mean_elements(orbit)
    day_s = 86400.0 / (2.0 * np.pi)
    epoch_ns = tai.from_jd_parts(*_tai_of_utc(mean.jdsatepoch, mean.jdsatepochF))
    values = (
        ("MEAN_MOTION", mean.no_kozai / 60.0 * day_s, 8),
        ("ECCENTRICITY", mean.ecco, 7),
        ("INCLINATION", np.degrees(mean.inclo), 4),
        ("RA_OF_ASC_NODE", np.degrees(mean.nodeo), 4),
        ("ARG_OF_PERICENTER", np.degrees(mean.argpo), 4),
        ("MEAN_ANOMALY", np.degrees(mean.mo), 4),
    )
    lines = [
        *_head("OMM", orbit, originator),
        f"COMMENT Fitted to a day of the numerical orbit, which it misses by {away:.2f} km at most",
        f"OBJECT_NAME = {name}",
        "OBJECT_ID = UNKNOWN",
        "CENTER_NAME = EARTH",
        "REF_FRAME = TEME",
        "TIME_SYSTEM = UTC",
        "MEAN_ELEMENT_THEORY = SGP4",
        f"EPOCH = {utc_text([epoch_ns])[0]}",
        *(f"{key} = {value:.{digits}f}" for key, value, digits in values),
        "EPHEMERIS_TYPE = 0",
        "CLASSIFICATION_TYPE = U",
        "NORAD_CAT_ID = 0",
        "ELEMENT_SET_NO = 0",
        "REV_AT_EPOCH = 0",
        f"BSTAR = {mean.bstar:.8e}",
        "MEAN_MOTION_DOT = 0",
        "MEAN_MOTION_DDOT = 0",
    ]
    return "\n".join(lines) + "\n"


def _tai_of_utc(day: float, fraction: float) -> tuple[float, float]:
    one, two = erfa.utctai(day, fraction)
    return float(one), float(two)


def parquet_tables(store: ObjectStore, folder: Path) -> list[Path]:
    """Objects with their current orbits, and associations, as parquet files. UserError without pyarrow."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise UserError('parquet needs pyarrow: pip install "sboc-e2e[gaia]"') from error
    names = {row["object_id"]: row for row in store.objects()}
    orbits = store.orbits()
    table: dict[str, list[Any]] = {
        "object_id": [o.object_id for o in orbits],
        "name": [names[o.object_id]["name"] for o in orbits],
        "status": [names[o.object_id]["status"] for o in orbits],
        "epoch_tai_ns": [o.epoch_tai_ns for o in orbits],
        "state": [o.state.tolist() for o in orbits],
        "covariance": [o.state_covariance.reshape(-1).tolist() for o in orbits],
        "chi2_nu": [o.chi2_nu for o in orbits],
        "n_used": [o.n_used for o in orbits],
    }
    links = store.associations()
    fields = ("tracklet_id", "object_id", "probability", "state", "decided_by", "decided_tai_ns")
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, content in (("objects", table), ("associations", {f: [getattr(a, f) for a in links] for f in fields})):
        path = folder / f"{name}.parquet"
        pq.write_table(pa.table(content), path)
        written.append(path)
    return written


def messages(store: ObjectStore, kind: str, originator: str, days: float) -> tuple[dict[str, str], list[str]]:
    """A message for each active object with an orbit, by file name; and a line for each that has none, with the reason."""
    if kind == "oem":
        _check_days(days)
    names = {row["object_id"]: row["name"] for row in store.objects() if row["status"] == "active"}
    chosen: Sequence[StoredOrbit] = [o for o in store.orbits() if o.object_id in names]
    out, left_out = {}, []
    for orbit in chosen:
        name = names[orbit.object_id]
        try:
            if kind == "oem":
                text = oem(orbit, name, originator, days)
            else:
                text = {"opm": opm, "omm": omm}[kind](orbit, name, originator)
        except UserError as error:
            left_out.append(f"{name}: {error}")
            continue
        out[f"{orbit.object_id:06d}.{kind}"] = text
    return out, left_out
