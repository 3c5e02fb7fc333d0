"""Where the camera looks: the commanded attitude as a function of time, for each pointing law."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform import earth
from simulator.platform.observer import Observer
from simulator.platform.rotation import matrix_of_axes, matrix_of_boresight, small_rotation

Array = NDArray[np.float64]

LAWS = ("anti_sun", "inertial", "nadir", "sidereal", "object", "schedule")


@dataclass(frozen=True, kw_only=True)
class VisitOptions:
    """A field of a schedule: the camera rests on it from one time after the epoch to another."""

    start_s: float = field(default=0.0, metadata={"doc": "the camera has come to rest", "min": 0.0, "max": 1e9})
    end_s: float = field(default=0.0, metadata={"doc": "the camera leaves for the next field", "min": 0.0, "max": 1e9})
    ra_deg: float = field(default=0.0, metadata={"doc": "right ascension of the field", "min": -360.0, "max": 360.0})
    dec_deg: float = field(default=0.0, metadata={"doc": "declination of the field", "min": -90.0, "max": 90.0})

    @property
    def direction(self) -> Array:
        """Unit vector (3,), GCRS axes."""
        ra, dec = np.radians(self.ra_deg), np.radians(self.dec_deg)
        return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


@dataclass(frozen=True, kw_only=True)
class PointingOptions:
    """Pointing law. `anti_sun`, `inertial` and `sidereal` hold a direction of the sky (its apparent one); `nadir` turns
    with the orbit; `object` follows the target named in `target`; `schedule` goes through `visits`."""

    law: str = field(default="anti_sun", metadata={"doc": "pointing law", "choices": LAWS})
    ra_deg: float = field(default=0.0, metadata={"doc": "right ascension (inertial, sidereal)", "min": -360.0, "max": 360.0})
    dec_deg: float = field(default=0.0, metadata={"doc": "declination (inertial, sidereal)", "min": -90.0, "max": 90.0})
    roll_deg: float = field(
        default=0.0,
        metadata={
            "doc": "turn about the boresight; at 0 rows grow to the south, columns to the west, at 180 deg to north and east",
            "min": -360.0,
            "max": 360.0,
        },
    )
    tilt_deg: float = field(
        default=180.0,
        metadata={
            "doc": "nadir law: angle of the boresight from nadir; 180 deg looks to the zenith",
            "min": -180.0,
            "max": 180.0,
        },
    )
    azimuth_deg: float = field(
        default=90.0,
        metadata={
            "doc": "nadir law: where the tilt goes, from flight direction (0) to orbit normal (90 deg)",
            "min": -360.0,
            "max": 360.0,
        },
    )
    roll_rate_deg_s: float = field(default=0.0, metadata={"doc": "steady roll about the boresight", "min": -360.0, "max": 360.0})
    target: str = field(default="", metadata={"doc": "name of the object that the law `object` follows"})
    visits: tuple[VisitOptions, ...] = field(default=(), metadata={"doc": "fields of the law `schedule`, by time"})

    def __post_init__(self) -> None:
        if self.law == "schedule" and not self.visits:
            raise UserError("pointing.visits: the law `schedule` needs one visit or more")
        for k, visit in enumerate(self.visits):
            if visit.end_s < visit.start_s or (k > 0 and visit.start_s < self.visits[k - 1].end_s):
                raise UserError(f"pointing.visits: visit {k} starts at {visit.start_s:g} s before what precedes it has ended")


Attitude = Callable[[int], Array]
"""TAI nanoseconds to the (3, 3) matrix that takes GCRS vectors to the camera frame."""


def commanded_attitude(
    options: PointingOptions,
    observer: Observer,
    epoch_tai_ns: int,
    target_direction: Callable[[int], Array] | None = None,
) -> Attitude:
    """The law as a function of time. `target_direction` gives the apparent direction of the followed object.

    Anti-Sun pointing takes the direction opposite to the Sun as seen from the Earth's centre at the epoch of the run (the
    parallax is 10 arcsec; the Sun moves 0.04 arcsec a second, which the law follows).
    """
    roll = np.radians(options.roll_deg)

    def base(tai_ns: int) -> Array:
        if options.law == "anti_sun":
            return matrix_of_boresight(-earth.sun_position_km(tai_ns), roll)
        if options.law == "schedule":
            return matrix_of_boresight(scheduled_direction(options.visits, (tai_ns - epoch_tai_ns) * 1e-9), roll)
        if options.law in ("inertial", "sidereal"):
            ra, dec = np.radians(options.ra_deg), np.radians(options.dec_deg)
            return matrix_of_boresight(np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]), roll)
        if options.law == "nadir":
            position, velocity = observer.state(tai_ns)
            down = -position / np.linalg.norm(position)
            normal = np.cross(position, velocity)
            normal = normal / np.linalg.norm(normal)
            forward = np.cross(normal, -down)
            tilt = np.radians(options.tilt_deg)
            azimuth = np.radians(options.azimuth_deg)
            sideways = np.cos(azimuth) * forward + np.sin(azimuth) * normal
            frame = matrix_of_axes(
                np.cos(tilt) * down + np.sin(tilt) * sideways, np.cos(azimuth) * normal - np.sin(azimuth) * forward
            )
            return np.asarray(small_rotation(np.array([0.0, 0.0, roll])) @ frame)
        if target_direction is None:
            raise ValueError("the law `object` needs a target")
        return matrix_of_boresight(target_direction(tai_ns), roll)

    if options.roll_rate_deg_s == 0.0:
        return base
    rate = np.radians(options.roll_rate_deg_s)

    def rolling(tai_ns: int) -> Array:
        turn = np.array([0.0, 0.0, rate * (tai_ns - epoch_tai_ns) * 1e-9])
        return np.asarray(small_rotation(turn) @ base(tai_ns))

    return rolling


def scheduled_direction(visits: tuple[VisitOptions, ...], time_s: float) -> Array:
    """Boresight (3,) of a schedule: at rest in a visit, in between along a great circle with the rate of a raised cosine."""
    following = next((k for k, visit in enumerate(visits) if time_s <= visit.end_s), len(visits) - 1)
    there = visits[following]
    if following == 0 or time_s >= there.start_s:
        return there.direction
    left = visits[following - 1]
    share = (time_s - left.end_s) / (there.start_s - left.end_s)
    share = 0.5 - 0.5 * np.cos(np.pi * share)
    angle = float(np.arccos(np.clip(left.direction @ there.direction, -1.0, 1.0)))
    if angle < 1e-9:
        return there.direction
    weights = np.sin(np.array([1.0 - share, share]) * angle) / np.sin(angle)
    return np.asarray(weights[0] * left.direction + weights[1] * there.direction)
