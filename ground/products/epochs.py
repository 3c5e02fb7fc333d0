"""Integer TAI to text in UTC."""

from collections.abc import Sequence

import numpy as np
from astropy.time import Time
from numpy.typing import NDArray

from sboc_e2e.icd.tai import to_jd_parts


def utc_text(tai_ns: Sequence[int] | NDArray[np.int64], digits: int = 6) -> list[str]:
    """ISO-8601 UTC (no zone letter, as CCSDS writes it), rounded to `digits` decimals of a second."""
    if len(tai_ns) == 0:
        return []
    parts = np.array([to_jd_parts(int(t)) for t in tai_ns])
    return [str(text) for text in Time(parts[:, 0], parts[:, 1], format="jd", scale="tai", precision=digits).utc.isot]


def utc_mjd(tai_ns: int) -> float:
    """Modified Julian date, UTC."""
    return float(Time(*to_jd_parts(tai_ns), format="jd", scale="tai").utc.mjd)
