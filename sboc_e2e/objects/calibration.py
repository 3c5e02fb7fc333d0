"""Observations of objects with precise orbits, from published messages, to a calibration file of the sensor."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.determination.precise import Ephemeris, orbit_of
from ground.determination.propagation import itrs_to_gcrs
from ground.orbit.reference import PreciseOrbit
from ground.sensor_bias.correct import calibration_text
from ground.sensor_bias.estimate import Place, SensorBias, Track, estimate, sessions_of
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.catalogue import ephemerides_of
from sboc_e2e.objects.places import known_place
from sboc_e2e.score.published.tdm_reader import read_tdm

Array = NDArray[np.float64]

_NEAR_COSINE: Final = 0.99
"""Eight degrees: a navigation satellite moves three between epochs of a table."""


def calibrate(
    messages: Sequence[Path], place: Place, orbit_files: Sequence[Path], *, shares_clock: bool, gap_h: float, out: Path
) -> tuple[list[SensorBias], list[str]]:
    """Estimate each session's bias and write them; also why objects were left out that no free orbit fits.

    UserError where no session has enough known objects, and for directions at epochs for which no place is given.
    """
    tracks = []
    for path in messages:
        if not path.is_file():
            raise UserError(f"{path}: no such file")
        for segment in read_tdm(path):
            if len(segment.angle_tai_ns) > 1:
                known_place(place, segment.angle_tai_ns, path)
                tracks.append(Track(t_tai_ns=segment.angle_tai_ns, direction=segment.direction))
    every = [e for path in orbit_files for e in ephemerides_of(path).values()]
    orbits: list[PreciseOrbit] = []
    left_out = []
    for ephemeris in every:
        if _may_be_seen(ephemeris, tracks, place):
            try:
                orbits.append(orbit_of(ephemeris))
            except UserError as error:
                left_out.append(str(error))
    found, reasons = [], []
    for session in sessions_of(tracks, 3600.0 * gap_h):
        try:
            found.append(estimate(session, place, orbits, shares_clock=shares_clock))
        except UserError as error:
            reasons.append(str(error))
    if not found:
        reason = reasons[0] if reasons else "calibration: the messages hold no tracks of two or more directions"
        raise UserError("; left out: ".join([reason, *left_out[:3]]))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(calibration_text(out.stem, found), encoding="utf-8")
    return found, left_out


def _may_be_seen(ephemeris: Ephemeris, tracks: Sequence[Track], place: Place) -> bool:
    """Whether any track is within some degrees of where the object was at the nearest epoch of its table."""
    for track in tracks:
        middle = len(track.t_tai_ns) // 2
        t = track.t_tai_ns[middle : middle + 1]
        k = int(np.argmin(np.abs(ephemeris.t_tai_ns - t[0])))
        line = (itrs_to_gcrs(ephemeris.t_tai_ns[k : k + 1]) @ ephemeris.itrs_km[k])[0] - place(t)[0]
        if float(line @ track.direction[middle]) > _NEAR_COSINE * float(np.linalg.norm(line)):
            return True
    return False


def session_line(bias: SensorBias) -> str:
    """One session for a terminal, with 90 % intervals."""
    time, east, north = bias.half_widths(0.9)
    return (
        f"{bias.n_tracks} tracks of {len(bias.objects)} objects, {bias.n_used} directions: time {1e3 * bias.time_s:+.2f} "
        f"+- {1e3 * time:.2f} ms, east {bias.east_arcsec:+.3f} +- {east:.3f}, north {bias.north_arcsec:+.3f} +- {north:.3f} "
        f"arcsec, noise {bias.noise_along_arcsec:.2f} along, {bias.noise_cross_arcsec:.2f} across"
    )
