"""Days that the installed Earth-orientation data cover.

Both readers of these data hold their first and last values outside them and say nothing that a program could hear: astropy takes
UT1 - UTC as it was, satkit takes none before 1973 and writes a note to the terminal.
"""

from functools import cache
from pathlib import Path
from typing import Final

import astropy_iers_data
import erfa
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

_MJD: Final = slice(7, 15)
"""Of a line of `finals2000A.all` (readme.finals2000A); the next one is of UT1 - UTC, blank beyond the predictions."""
_UT1_UTC: Final = slice(58, 68)


@cache
def covered_mjd() -> tuple[float, float]:
    """First and last day (MJD) with UT1: observed up to the tables' date, predicted for a year more."""
    lines = Path(astropy_iers_data.IERS_A_FILE).read_bytes().splitlines()
    days = [float(line[_MJD]) for line in lines if line[_UT1_UTC].strip()]
    return days[0], days[-1]


def refuse_outside_orientation(t_tai_ns: NDArray[np.int64], where: str) -> None:
    """UserError, which begins with `where`, unless UT1 is known at all epochs (n,)."""
    if not len(t_tai_ns):
        return
    first, last = covered_mjd()
    for t in (t_tai_ns.min(), t_tai_ns.max()):
        day, fraction = tai.to_jd_parts(int(t))
        mjd = day - erfa.DJM0 + fraction
        if not first <= mjd <= last:
            raise UserError(
                f"{where}: {_date(mjd)} lies outside the installed Earth-orientation data (package astropy-iers-data), "
                f"{_date(first)} to {_date(last)}"
            )


def _date(mjd: float) -> str:
    year, month, day, _ = erfa.jd2cal(erfa.DJM0, mjd)
    return f"{year:04d}-{month:02d}-{day:02d}"
