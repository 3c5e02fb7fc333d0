"""UT1 and polar motion from the installed IERS tables: series C04 up to its end, then Bulletin A with its predictions.

`astropy.utils.iers` is not used for two reasons. It takes 2 s and 80 MB in every process, and a run needs two days of the tables
only. It refuses predictions by today's date, so a run made now could not be repeated next month.
"""

from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Final

import astropy_iers_data
import erfa
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import tai

ARCSEC_RAD: Final = np.pi / 648000.0
MJD_ZERO: Final = 2400000.5  # Julian date of MJD 0, by definition

C04: Final = ((16, 10), (26, 12), (38, 12), (50, 12))  # as below, in a line of C04: its header has 4 i4, f10.2, 2 f12.6, f12.7
BULLETIN_A: Final = ((7, 8), (18, 9), (37, 9), (58, 10))
"""First byte and width of MJD, the pole's x and y (arcsec) and UT1 - UTC (s) in a line (eopc04 header, readme.finals2000A)."""


@dataclass(frozen=True, kw_only=True)
class DailyValues:
    """One value for each day at 0 h UTC, without gaps: MJD, pole (arcsec), UT1 - UTC (s), each (n,)."""

    mjd: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    ut1_utc: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Orientation:
    """UT1 as a two-part Julian date, and the pole (rad), at an instant."""

    ut1: tuple[float, float]
    x_rad: float
    y_rad: float


def _columns(lines: bytes, places: tuple[tuple[int, int], ...]) -> NDArray[np.float64]:
    """(days, 4) numbers of the lines of equal length, up to the first without UT1."""
    length = lines.index(b"\n") + 1
    offsets, widths = zip(*places, strict=True)
    layout = np.dtype({"names": list("txyu"), "formats": [f"S{w}" for w in widths], "offsets": list(offsets), "itemsize": length})
    rows = np.frombuffer(lines, dtype=layout)
    rows = rows[: int(np.count_nonzero(np.char.strip(rows["u"])))]
    return np.column_stack([rows[name].astype(np.float64) for name in "txyu"])


@cache
def daily_values() -> DailyValues:
    """The installed tables from the first day of Bulletin A (1973) to its last prediction."""
    rapid = _columns(Path(astropy_iers_data.IERS_A_FILE).read_bytes(), BULLETIN_A)
    final_text = Path(astropy_iers_data.IERS_B_FILE).read_bytes()
    final = _columns(final_text[final_text.rindex(b"#") :].partition(b"\n")[2], C04)
    table = np.vstack([final[final[:, 0] >= rapid[0, 0]], rapid[rapid[:, 0] > final[-1, 0]]])
    return DailyValues(mjd=table[:, 0], x=table[:, 1], y=table[:, 2], ut1_utc=table[:, 3])


@lru_cache(maxsize=512)
def at(tai_ns: int) -> Orientation:
    """Linear between the days, as UT1 - TAI, which leap seconds leave alone. Days outside the table are its edge's."""
    table = daily_values()
    tai1, tai2 = tai.to_jd_parts(tai_ns)
    utc1, utc2 = erfa.taiutc(tai1, tai2)
    day = float((utc1 - MJD_ZERO) + utc2)
    k = int(np.clip(np.searchsorted(table.mjd, day, side="right") - 1, 0, len(table.mjd) - 2))
    share = day - table.mjd[k]

    def between(values: NDArray[np.float64]) -> float:
        return float(values[0] + share * (values[1] - values[0]))

    pair = slice(k, k + 2)
    year, month, day_of_month, _ = erfa.jd2cal(MJD_ZERO, table.mjd[pair])
    ut1_tai_s = between(table.ut1_utc[pair] - erfa.dat(year, month, day_of_month, 0.0))
    return Orientation(
        ut1=(tai1, tai2 + ut1_tai_s / 86400.0),
        x_rad=between(table.x[pair]) * ARCSEC_RAD,
        y_rad=between(table.y[pair]) * ARCSEC_RAD,
    )
