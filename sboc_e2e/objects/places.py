"""Where a sensor was: a site on the ground, or a published ephemeris."""

from pathlib import Path
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import KroghInterpolator

from ground.determination.propagation import itrs_to_gcrs
from ground.sensor_bias.estimate import Place
from ground.sky.orientation_data import refuse_outside_orientation
from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.published.oem_reader import Ephemeris, read_oem

Array = NDArray[np.float64]

_USUAL_DEGREE: Final = 7
"""Of Hermite interpolation where a message names none: 6 mm at steps of five minutes of an orbit at 700 km."""
_LARGEST_DEGREE: Final = 27
"""Polynomials of higher degree lose digits between evenly spaced states."""


def place_of_site(text: str) -> Place:
    """A site from "latitude,longitude,height" (deg, deg, m; WGS84).

    Its places raise UserError for epochs that the installed Earth-orientation data do not cover.
    """
    try:
        latitude, longitude, height_m = (float(part) for part in text.split(","))
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and abs(height_m) < 10_000.0):
            raise ValueError(text)
    except ValueError as error:
        raise UserError(f'--site: expected LATITUDE,LONGITUDE,HEIGHT in deg, deg, m, got "{text[:40]}"') from error
    fixed = 1e-3 * np.asarray(erfa.gd2gc(1, np.radians(longitude), np.radians(latitude), height_m))

    def place(t: NDArray[np.int64]) -> Array:
        refuse_outside_orientation(t, "--site")
        return np.asarray(itrs_to_gcrs(t) @ fixed)

    return place


def place_of_ephemeris(path: Path) -> Place:
    """A moving sensor from its published ephemeris (OEM), interpolated as the message says; NaN outside its segments.

    UserError for other centres than the Earth, and for segments without two or more states of rising epochs.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    segments = read_oem(path)
    for number, segment in enumerate(segments, start=1):
        where = f"{path}, segment {number}"
        if segment.centre.upper() != "EARTH":
            raise UserError(f"{where}: expected CENTER_NAME = EARTH, got '{segment.centre}'")
        if len(segment.t_tai_ns) < 2 or (np.diff(segment.t_tai_ns) <= 0).any():
            raise UserError(f"{where}: expected two or more states, one at each epoch, got {len(segment.t_tai_ns)}")
        _nodes_of(segment, where)

    def place(t: NDArray[np.int64]) -> Array:
        out = np.full((len(t), 3), np.nan)
        for segment in segments:
            inside = (t >= segment.t_tai_ns[0]) & (t <= segment.t_tai_ns[-1])
            if inside.any():
                out[inside] = _interpolated(segment, t[inside])
        return out

    return place


def known_place(place: Place, t_tai_ns: NDArray[np.int64], path: Path) -> Array:
    """Where the sensor was, (n, 3) km, at epochs (n,) of directions of a message. UserError where nothing tells it."""
    here = place(t_tai_ns)
    if not np.isfinite(here).all():
        raise UserError(f"{path}: directions at epochs for which the observer's place is not given")
    return here


def _nodes_of(segment: Ephemeris, where: str = "") -> tuple[int, bool]:
    """Number of states that a polynomial goes through, and whether it has their velocities too."""
    method = segment.interpolation.upper()
    if method not in ("", "HERMITE", "LAGRANGE", "LINEAR"):
        raise UserError(f"{where}: INTERPOLATION of HERMITE, LAGRANGE or LINEAR is read, not '{segment.interpolation}'")
    degree = 1 if method == "LINEAR" else segment.degree or _USUAL_DEGREE
    if not 1 <= degree <= _LARGEST_DEGREE:
        raise UserError(f"{where}: expected INTERPOLATION_DEGREE from 1 to {_LARGEST_DEGREE}, got {degree}")
    with_velocity = method in ("", "HERMITE")
    wanted = max(2, (degree + 1) // 2) if with_velocity else degree + 1
    return min(wanted, len(segment.t_tai_ns)), with_velocity


def _interpolated(segment: Ephemeris, t: NDArray[np.int64]) -> Array:
    """Places (n, 3) km at epochs within a segment, each by the states that lie about it."""
    nodes, with_velocity = _nodes_of(segment)
    after = np.searchsorted(segment.t_tai_ns, t, side="right")
    first = np.clip(after - nodes // 2, 0, len(segment.t_tai_ns) - nodes)
    if nodes % 2:
        # an odd number of states has its middle one nearest to the epoch
        nearer = np.clip(after, 1, len(segment.t_tai_ns) - 1)
        before_ns, behind_ns = t - segment.t_tai_ns[nearer - 1], segment.t_tai_ns[nearer] - t
        first = np.clip(np.where(before_ns <= behind_ns, nearer - 1, nearer) - nodes // 2, 0, len(segment.t_tai_ns) - nodes)
    out = np.empty((len(t), 3))
    for start in np.unique(first):
        these = np.flatnonzero(first == start)
        part = slice(int(start), int(start) + nodes)
        epochs = segment.t_tai_ns[part]
        # in steps about the middle: powers of seconds of a day would cost digits
        step_s = max(1e-9 * float(epochs[-1] - epochs[0]) / max(nodes - 1, 1), 1e-9)
        x = 1e-9 * (epochs - epochs[nodes // 2]) / step_s
        y, states = x, segment.state[part, :3]
        if with_velocity:
            y = np.repeat(x, 2)
            states = np.stack([segment.state[part, :3], segment.state[part, 3:] * step_s], axis=1).reshape(-1, 3)
        out[these] = KroghInterpolator(y, states)(1e-9 * (t[these] - epochs[nodes // 2]) / step_s)
    return out
