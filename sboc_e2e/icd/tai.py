"""TAI as integer nanoseconds since 1958-01-01T00:00:00 TAI, the epoch of the CCSDS unsegmented time code."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

EPOCH_JD: Final = 2436204.5
"""Julian date (TAI) of the zero of `*_tai_ns`."""

NS_PER_S: Final = 1_000_000_000  # Nanoseconds in a second: times of the contract are integers of them.
NS_PER_DAY: Final = 86_400 * NS_PER_S


def to_jd_parts(tai_ns: int) -> tuple[float, float]:
    """Julian date (TAI) as whole days and a fraction, for ``astropy.time.Time(*parts, format="jd", scale="tai")``.

    The fraction of a day resolves 1e-11 s, so nothing of the integer nanoseconds is lost that a double can hold.
    """
    days, rest_ns = divmod(int(tai_ns), NS_PER_DAY)
    return EPOCH_JD + days, rest_ns / NS_PER_DAY


def jd_parts_of(tai_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`to_jd_parts` of instants (n,): whole days (n,) and fractions (n,)."""
    days, rest_ns = np.divmod(np.asarray(tai_ns, dtype=np.int64), NS_PER_DAY)
    return EPOCH_JD + days, rest_ns / NS_PER_DAY


def from_jd_parts(jd1: float, jd2: float) -> int:
    """Nanoseconds since 1958 of a two-part Julian date (TAI), rounded to the nanosecond."""
    days = round(jd1 - EPOCH_JD)
    rest_days = (jd1 - EPOCH_JD - days) + jd2
    return days * NS_PER_DAY + round(rest_days * NS_PER_DAY)
