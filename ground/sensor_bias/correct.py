"""Calibrations on file, and their removal from observations."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ground.sensor_bias.estimate import SensorBias, Track
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.errors import UserError

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
    """The session whose middle is nearest to an epoch. UserError without any."""
    if not sessions:
        raise UserError("calibration: no session")
    return min(sessions, key=lambda s: abs((s.first_tai_ns + s.last_tai_ns) // 2 - t_tai_ns))


def corrected(track: Track, bias: SensorBias) -> Track:
    """A track with epochs and directions corrected for the bias."""
    east = np.cross([0.0, 0.0, 1.0], track.direction)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(track.direction, east)
    direction = track.direction - ARCSEC_RAD * (bias.east_arcsec * east + bias.north_arcsec * north)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Track(t_tai_ns=track.t_tai_ns - round(bias.time_s * 1e9), direction=direction)
