"""Calibrations on file, and their removal from observations."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.sensor_bias.estimate import SensorBias, Track
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_FORMAT = "sboc-sensor-calibration-2"


def calibration_text(sensor: str, sessions: Sequence[SensorBias]) -> str:
    """All sessions of a sensor as JSON, with 90 % half widths."""
    rows: list[dict[str, Any]] = []
    for bias in sessions:
        row = asdict(bias)
        row["covariance"] = bias.covariance.tolist()
        row["degrees"] = bias.degrees.tolist()
        row["half_width_90"] = [float(x) for x in bias.half_widths(0.9)]
        rows.append(row)
    return json.dumps({"format": _FORMAT, "sensor": sensor, "sessions": rows}, indent=1) + "\n"


def read_calibration(text: str, where: str) -> tuple[SensorBias, ...]:
    """Sessions of a file. UserError for anything else."""
    try:
        content = json.loads(text)
        if content["format"] != _FORMAT:
            raise UserError(f'{where}: format "{str(content["format"])[:40]}"; expected {_FORMAT}')
        rows = []
        for row in content["sessions"]:
            row = {k: v for k, v in row.items() if k != "half_width_90"}
            arrays = {name: np.array(row[name]) for name in ("covariance", "degrees")}
            rows.append(SensorBias(**{**row, **arrays, "objects": tuple(row["objects"])}))
        return tuple(rows)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{where}: no sensor calibration: {str(error)[:80]}") from error


def nearest(sessions: Sequence[SensorBias], t_tai_ns: int) -> SensorBias:
    """The session that holds an epoch, else the one whose nearer end is nearest. UserError without any."""
    if not sessions:
        raise UserError("calibration: no session")

    def away_ns(session: SensorBias) -> tuple[int, int]:
        outside = max(session.first_tai_ns - t_tai_ns, t_tai_ns - session.last_tai_ns, 0)
        return outside, abs((session.first_tai_ns + session.last_tai_ns) // 2 - t_tai_ns)

    return min(sessions, key=away_ns)


def corrected(track: Track, bias: SensorBias) -> Track:
    """A track with epochs and directions corrected for the bias."""
    east, north = _axes(track.direction)
    direction = track.direction - ARCSEC_RAD * (bias.east_arcsec * east + bias.north_arcsec * north)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Track(t_tai_ns=track.t_tai_ns - round(bias.time_s * 1e9), direction=direction)


def widened(errors: Array, track: Track, bias: SensorBias) -> Array:
    """Errors (n, 3) of a track's directions that hold what the correction leaves: sigma on two axes (arcsec), angle (rad).

    The first axis lies at the angle from north to east. What the correction leaves is common to all n directions: the
    covariance of the bias, and what the directions of a track of this sensor share. The store has no place for a common error.
    So n times its covariance is added to that of each direction: the mean direction then has its whole error, the rate too
    large a one. For a sensor that moves, the apparent motion stands for that of the object, whose range is not known yet.
    """
    n = len(track.direction)
    east, north = _axes(track.direction)
    seconds = (track.t_tai_ns - track.t_tai_ns[0]) * 1e-9
    rate = np.zeros(2)
    if n > 1:
        away = track.direction - track.direction[0]
        shown = np.stack([away @ north[n // 2], away @ east[n // 2]], axis=1) / ARCSEC_RAD
        rate = np.polyfit(seconds, shown, 1)[0]
    speed = float(np.linalg.norm(rate))
    heading = rate / speed if speed > 0.0 else np.array([1.0, 0.0])
    side = np.array([-heading[1], heading[0]])
    # in the order north, east; the biases in the order time, east, north
    design = np.column_stack([-rate, [0.0, 1.0], [1.0, 0.0]])
    spread = np.sqrt([_of_student(float(nu)) for nu in bias.degrees])
    common = design @ (bias.covariance * np.outer(spread, spread)) @ design.T
    of_a_mean = bias.n_tracks / bias.n_used
    for axis, shared, noise in (
        (heading, bias.common_along_arcsec, bias.noise_along_arcsec),
        (side, bias.common_cross_arcsec, bias.noise_cross_arcsec),
    ):
        # a smaller one may be the scatter of the means of few tracks: the estimate takes it so too
        if shared**2 > noise**2 * of_a_mean:
            common += _of_student(bias.n_tracks - 1.5) * shared**2 * np.outer(axis, axis)
    cos, sin = np.cos(errors[:, 2]), np.sin(errors[:, 2])
    turn = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=1)
    own = np.einsum("nki,nk,nkj->nij", turn, errors[:, :2] ** 2, turn)
    variance, axes = np.linalg.eigh(own + n * common)
    return np.column_stack([np.sqrt(variance[:, ::-1]), np.arctan2(axes[:, 1, 1], axes[:, 0, 1])])


def _of_student(freedom: float) -> float:
    """Variance of an error over its estimated variance, by the estimate's degrees of freedom: that of Student's t.

    It grows without bound towards two degrees; below four it stays at two.
    """
    return max(freedom, 4.0) / (max(freedom, 4.0) - 2.0)


def _axes(direction: Array) -> tuple[Array, Array]:
    """East and north (n, 3) at directions (n, 3)."""
    east = np.cross([0.0, 0.0, 1.0], direction)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    return east, np.cross(direction, east)
