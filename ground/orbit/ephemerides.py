"""Orbit Ephemeris Messages (CCSDS 502.0-B-2, KVN) into precise orbits, and the tracklets that belong to them."""

from collections.abc import Sequence
from datetime import datetime
from typing import Final

import erfa
import numpy as np

from ground.orbit.bias import Bias, estimate_bias
from ground.orbit.observer import observer_orbit
from ground.orbit.reference import PreciseOrbit, seen_from
from ground.sky.eme2000 import frame_bias
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import Tracklet

_FRAMES: Final = ("EME2000", "GCRF", "ICRF")
_TIMES: Final = ("UTC", "TAI", "GPS")
GPS_BEHIND_TAI_NS: Final = 19_000_000_000
"""TAI - GPS, exact: TAI - UTC at the epoch of GPS time, 1980 January 6 (IS-GPS-200). Galileo's time is steered to it."""


def read_oem(text: str) -> tuple[PreciseOrbit, ...]:
    """Precise orbits of the segments of a message, EME2000 turned to GCRS axes by the ERFA frame bias.

    Errors: a `UserError` that names the line for other centres, frames and time systems, and for lines that are no states.
    """
    orbits: list[PreciseOrbit] = []
    meta: dict[str, str] = {}
    rows: list[tuple[int, list[float]]] = []
    skipping = described = False
    for number, line in enumerate([*text.splitlines(), "META_START"], start=1):
        word = line.split("=")[0].strip()
        if word == "META_START":
            if rows:
                orbits.append(_orbit(meta, rows))
            meta, rows, skipping, described = {}, [], False, False
        elif word in ("COVARIANCE_START", "COVARIANCE_STOP"):
            skipping = word == "COVARIANCE_START"
        elif "=" in line and not skipping:
            meta[word] = line.split("=", 1)[1].strip()
        elif word == "META_STOP":
            _check(meta, number)
            described = True
        elif word and not skipping and not word.startswith("COMMENT"):
            if not described:
                raise UserError(f"ephemeris message, line {number}: expected META_STOP before states, got '{line[:40]}'")
            rows.append(_row(line, meta["TIME_SYSTEM"], number))
    if not orbits:
        raise UserError("ephemeris message: expected at least one segment with states, got none")
    return tuple(orbits)


def _check(meta: dict[str, str], number: int) -> None:
    for key, allowed in (("CENTER_NAME", ("EARTH",)), ("REF_FRAME", _FRAMES), ("TIME_SYSTEM", _TIMES)):
        if meta.get(key, "").upper() not in allowed:
            raise UserError(f"ephemeris, line {number}: expected {key} of {', '.join(allowed)}, got '{meta.get(key, '')}'")


def _row(line: str, system: str, number: int) -> tuple[int, list[float]]:
    """TAI epoch in ns and the state of one line."""
    try:
        epoch, *values = line.split()
        state = [float(value) for value in values[:6]]
        date, clock = epoch.rstrip("Z").split("T")
        day = datetime.strptime(date, "%Y-%m-%d" if date.count("-") == 2 else "%Y-%j")
        hour, minute, second = clock.split(":")
        if not float(second) < 61.0:
            raise ValueError("seconds beyond a minute")
        parts = erfa.dtf2d(system.upper(), day.year, day.month, day.day, int(hour), int(minute), float(second))
    except ValueError as error:
        raise UserError(f"ephemeris message, line {number}: expected an epoch and six numbers, got '{line[:40]}'") from error
    if len(state) < 6 or not np.isfinite(state).all():
        raise UserError(f"ephemeris message, line {number}: expected an epoch and six numbers, got '{line[:40]}'")
    if system.upper() == "UTC":
        parts = erfa.utctai(*parts)
    t_ns = tai.from_jd_parts(*(float(part) for part in parts))
    return t_ns + (GPS_BEHIND_TAI_NS if system.upper() == "GPS" else 0), state


def _orbit(meta: dict[str, str], rows: list[tuple[int, list[float]]]) -> PreciseOrbit:
    name = meta.get("OBJECT_NAME", "-")
    t_ns, states = np.array([t for t, _ in rows], dtype=np.int64), np.array([state for _, state in rows])
    if len(t_ns) < 2 or (np.diff(t_ns) <= 0).any():
        raise UserError(f"ephemeris message: expected two or more states of rising epochs for {name}")
    turn = frame_bias().T if meta["REF_FRAME"].upper() == "EME2000" else np.eye(3)
    position_km, velocity_km_s = states[:, :3] @ turn.T, states[:, 3:] @ turn.T
    return PreciseOrbit(name=name, t_tai_ns=t_ns, position_km=position_km, velocity_km_s=velocity_km_s)


def bias_of_run(
    tracklets: Sequence[Tracklet], headers: Sequence[FrameHeader], orbits: Sequence[PreciseOrbit], *, within_arcsec: float = 300.0
) -> Bias | None:
    """Bias of time tags and pointing from those tracklets that lie within this distance of a precise orbit all along.

    A tracklet near more than one orbit is ambiguous and is left out. So is one without sky positions or direction.
    """
    pairs = []
    for tracklet in tracklets:
        if not tracklet.direction_resolved or not np.isfinite(tracklet.ra_deg).all():
            continue
        near = [orbit for orbit in orbits if _distance_arcsec(tracklet, headers, orbit) < within_arcsec]
        if len(near) == 1:
            pairs.append((tracklet, near[0]))
    return estimate_bias(pairs, headers)


def _distance_arcsec(tracklet: Tracklet, headers: Sequence[FrameHeader], orbit: PreciseOrbit) -> float:
    """Largest distance of a tracklet's directions from those of the orbit; infinite outside its table."""
    t_ns = tracklet.t_tai_ns
    observer = observer_orbit(headers)
    if observer is None:
        return float("inf")
    computed, _ = seen_from(orbit.states, t_ns, observer.states(t_ns)[:, :3])
    seen = unit_vectors(np.radians(tracklet.ra_deg), np.radians(tracklet.dec_deg))
    distance = float(np.max(np.linalg.norm(seen - computed, axis=1))) / ARCSEC_RAD
    return distance if np.isfinite(distance) else float("inf")
