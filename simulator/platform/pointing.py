"""Where the camera looks: the commanded attitude as a function of time, for each pointing law."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulator.platform import earth
from simulator.platform.observer import Observer
from simulator.platform.rotation import matrix_of_axes, matrix_of_boresight, small_rotation

Array = NDArray[np.float64]

LAWS = ("anti_sun", "inertial", "nadir", "sidereal", "object")


@dataclass(frozen=True, kw_only=True)
class PointingOptions:
    """Pointing law. `anti_sun`, `inertial` and `sidereal` hold a direction of the sky (its apparent one); `nadir` turns
    with the orbit; `object` follows the target named in `target`."""

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
