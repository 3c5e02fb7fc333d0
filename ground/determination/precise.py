"""Precise orbits as published, SP3 (also .Z) and CPF, and laser ranges as normal points (CRD): read, and turned to GCRS axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.determination.batch import Solution, fit
from ground.determination.forces import ForceModel
from ground.determination.measurements import Positions
from ground.determination.propagation import itrs_to_gcrs, propagate
from ground.orbit.dynamics import LIGHT_KM_S
from ground.orbit.ephemerides import GPS_BEHIND_TAI_NS
from ground.orbit.reference import PreciseOrbit
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_MJD_OF_ZERO: Final = 36204
"""Modified Julian date of the zero of TAI ns."""
_EMPIRICAL: Final = ("sun", "panel", "third", "third_cos", "third_sin")
_LARGEST_RMS_KM: Final = 0.05
"""Days of GNSS orbits fit to 0.14 m (docs/objects.md): more than 50 m is a manoeuvre or a wrong frame."""
_MOST_REJECTED: Final = 0.02
"""Share of epochs that may be bad ones, five of a day's 288: more in a row are another orbit. Chosen."""
_BEFORE_START_S: Final = 21_600.0
"""How long before the start of a pass (CRD, h4) a record may be, such as of weather; others are up to 18 h after it. Chosen."""
_SIGMA_KM: Final = 1e-4
"""Of a place along each axis in a fit: the forces that are left out, not the ephemeris' own errors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ephemeris:
    """Places (n, 3) km in Earth-fixed axes (ITRS) at epochs (n,) TAI ns of an object."""

    name: str
    t_tai_ns: NDArray[np.int64]
    itrs_km: Array

    def positions(self, sigma_km: float) -> Positions:
        """As measurements in GCRS axes."""
        turned = np.einsum("nij,nj->ni", itrs_to_gcrs(self.t_tai_ns), self.itrs_km)
        return Positions(t_tai_ns=self.t_tai_ns, position_km=turned, sigma_km=np.full(len(turned), sigma_km))


def uncompressed(raw: bytes, where: str) -> bytes:
    """Bytes of a file, after undoing Unix `compress` (LZW, codes of 9 to 16 bits) where it was compressed."""
    if not raw.startswith(b"\x1f\x9d"):
        return raw
    longest, block = raw[2] & 0x1F, bool(raw[2] & 0x80)
    if not 9 <= longest <= 16:
        raise UserError(f"{where}: compressed with codes of {longest} bits; 9 to 16 are known")
    table: list[bytes] = [bytes([k]) for k in range(256)] + ([b""] if block else [])
    first_free = len(table)
    out: list[bytes] = []
    width, at, group, before = 9, 24, 0, b""
    while at + width <= 8 * len(raw):
        start = at >> 3
        code = (int.from_bytes(raw[start : start + 4], "little") >> (at & 7)) & ((1 << width) - 1)
        at += width
        group += 1
        if block and code == 256:
            # codes come in groups of eight; the rest of a group is padding when the width changes
            at += width * (-group % 8)
            del table[first_free:]
            width, group, before = 9, 0, b""
            continue
        if code < len(table):
            entry = table[code]
        elif code == len(table) and before:
            entry = before + before[:1]
        else:
            raise UserError(f"{where}: broken compressed data")
        out.append(entry)
        if before and len(table) < 1 << longest:
            table.append(before + entry[:1])
        before = entry
        if len(table) == (1 << width) and width < longest:
            at += width * (-group % 8)
            width, group = width + 1, 0
    return b"".join(out)


def read_sp3(raw: bytes, where: str) -> dict[str, Ephemeris]:
    """Objects of an SP3 file (a, c or d), by their names; epochs without a place are left out. UserError for other files."""
    lines = uncompressed(raw, where).decode("ascii", errors="replace").splitlines()
    if not lines or lines[0][:1] != "#" or lines[0][1:2] not in "acd":
        raise UserError(f"{where}: not an SP3 file of version a, c or d")
    system = next((line[9:12] for line in lines if line.startswith("%c")), "")
    if lines[0][1] == "a" and system in ("", "ccc"):
        # version a is in GPS time, and has placeholders where later versions name the system
        system = "GPS"
    behind = {"GPS": GPS_BEHIND_TAI_NS, "GAL": GPS_BEHIND_TAI_NS, "TAI": 0}
    if system not in behind:
        raise UserError(f'{where}: time system "{system}" is not read; expected {", ".join(behind)}')
    epochs: list[int] = []
    found: dict[str, list[tuple[int, list[float]]]] = {}
    for number, line in enumerate(lines, start=1):
        try:
            if line.startswith("*"):
                year, month, day, hour, minute = (int(word) for word in line[1:].split()[:5])
                second = float(line[1:].split()[5])
                whole = _day_ns(year, month, day) + (hour * 3600 + minute * 60) * tai.NS_PER_S
                epochs.append(whole + round(second * 1e9) + behind[system])
            elif line.startswith("P") and epochs:
                place = [float(line[k : k + 14]) for k in (4, 18, 32)]
                if any(place):
                    # version a writes "  1", later versions "G01"
                    name = (line[1].replace(" ", "G") + line[2:4].replace(" ", "0")) if lines[0][1] == "a" else line[1:4]
                    found.setdefault(name, []).append((epochs[-1], place))
        except (ValueError, IndexError) as error:
            raise UserError(f"{where}, line {number}: expected an epoch or a place, got '{line[:40]}'") from error
    return _ephemerides(found, where)


def read_cpf(text: str, where: str) -> Ephemeris:
    """The object of a prediction of the ILRS (CPF 1 or 2, true body-fixed). UserError for other frames and formats."""
    lines = text.splitlines()
    if not lines or not lines[0].upper().startswith("H1 CPF"):
        raise UserError(f"{where}: not a CPF file: the first line is not H1 CPF")
    name = next((word for word in lines[0].split()[8:] if not word.isdigit()), "object")
    rows: list[tuple[int, list[float]]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        try:
            if words and words[0].upper() == "H2" and int(words[19]) != 0:
                raise UserError(f"{where}, line {number}: reference frame {words[19]}; 0 (geocentric true body-fixed) is read")
            if words and words[0] == "10" and words[1] == "0":
                seconds = float(words[3])
                utc_ns = (int(words[2]) - _MJD_OF_ZERO) * tai.NS_PER_DAY + round(seconds * 1e9)
                rows.append((_from_utc(utc_ns), [1e-3 * float(words[k]) for k in (5, 6, 7)]))
        except (ValueError, IndexError) as error:
            raise UserError(f"{where}, line {number}: expected a record of CPF, got '{line[:40]}'") from error
    return _ephemerides({name: rows}, where)[name]


def _ephemerides(found: dict[str, list[tuple[int, list[float]]]], where: str) -> dict[str, Ephemeris]:
    if not any(found.values()):
        raise UserError(f"{where}: no places")
    out = {}
    for name, rows in found.items():
        t = np.array([epoch for epoch, _ in rows], dtype=np.int64)
        place = np.array([row for _, row in rows])
        if (np.diff(t) <= 0).any() or not np.isfinite(place).all() or float(np.linalg.norm(place, axis=1).min()) < 6000.0:
            raise UserError(f"{where}: {name}: epochs do not rise, or places inside the Earth")
        out[name] = Ephemeris(name=name, t_tai_ns=t, itrs_km=place)
    return out


def _day_ns(year: int, month: int, day: int) -> int:
    return (date(year, month, day).toordinal() - date(1958, 1, 1).toordinal()) * tai.NS_PER_DAY


def _from_utc(utc_ns: int) -> int:
    """TAI ns of UTC counted as days of 86,400 s since 1958."""
    day, rest = divmod(utc_ns, tai.NS_PER_DAY)
    return tai.from_jd_parts(*(float(part) for part in erfa.utctai(tai.EPOCH_JD + day, rest / tai.NS_PER_DAY)))


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalPoints:
    """Laser normal points (n,): epochs at the object (TAI ns), half of the light's way km, stations, weather, wavelength.

    station : CDP pad number. pressure_hpa, temperature_k, humidity_percent : at the station, of the nearest record.
    """

    t_tai_ns: NDArray[np.int64]
    range_km: Array
    station: NDArray[np.int64]
    wavelength_um: Array
    pressure_hpa: Array
    temperature_k: Array
    humidity_percent: Array


def _check_ranges(words: Sequence[str], where: str) -> None:
    """UserError unless a pass (h4) has two-way ranges as measured: the model holds the air and the mirror's place."""
    for field, name in ((15, "the troposphere's delay"), (16, "the centre of mass")):
        if words[field] != "0":
            raise UserError(f"{where}: ranges without a correction for {name} are read (0), got {words[field]}")
    if words[20] != "2":
        raise UserError(f"{where}: two-way ranges are read (type 2), got type {words[20]}")


def read_normal_points(text: str, where: str) -> NormalPoints:
    """Two-way normal points of a CRD file as they were measured: epochs of transmission (event 2), no correction applied.

    UserError for other files.
    """
    rows: list[tuple[int, float, int, float, float]] = []
    weather: list[tuple[int, int, float, float, float]] = []
    station, day, start_s, wave = -1, -1, float("nan"), float("nan")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        kind = words[0].lower() if words else ""
        try:
            if kind == "h2":
                station = int(words[2])
            elif kind == "h4":
                day = _day_ns(int(words[2]), int(words[3]), int(words[4]))
                start_s = int(words[5]) * 3600.0 + int(words[6]) * 60.0 + float(words[7])
                _check_ranges(words, f"{where}, line {number}")
            elif kind == "c0":
                wave = 1e-3 * float(words[2])
            elif kind in ("11", "20"):
                if np.isnan(start_s):
                    raise UserError(f"{where}, line {number}: record {kind} before the start of a pass (h4)")
                second = float(words[1])
                # of each record by itself: records of weather and of ranges need not be in the order of their epochs
                days_after = -int((second - start_s + _BEFORE_START_S) // 86_400.0)
                utc = day + days_after * tai.NS_PER_DAY + round(second * 1e9)
                if kind == "20":
                    weather.append((station, _from_utc(utc), float(words[2]), float(words[3]), float(words[4])))
                else:
                    if np.isnan(wave):
                        raise UserError(f"{where}, line {number}: record 11 before the wavelength (c0)")
                    if words[4] != "2":
                        raise UserError(f"{where}, line {number}: epoch event {words[4]}; 2 (transmission) is read")
                    flight = float(words[2])
                    rows.append((_from_utc(utc) + round(0.5e9 * flight), 0.5 * LIGHT_KM_S * flight, station, wave, second))
        except (ValueError, IndexError) as error:
            raise UserError(f"{where}, line {number}: expected a record of CRD, got '{line[:40]}'") from error
    if not rows or not weather:
        raise UserError(f"{where}: no normal points (record 11) with weather (record 20)")
    nearest = [min((w for w in weather if w[0] == row[2]), key=lambda w: abs(w[1] - row[0]), default=None) for row in rows]
    if any(w is None for w in nearest):
        raise UserError(f"{where}: a station without weather (record 20)")
    return NormalPoints(
        t_tai_ns=np.array([row[0] for row in rows], dtype=np.int64),
        range_km=np.array([row[1] for row in rows]),
        station=np.array([row[2] for row in rows], dtype=np.int64),
        wavelength_um=np.array([row[3] for row in rows]),
        pressure_hpa=np.array([w[2] for w in nearest if w is not None]),
        temperature_k=np.array([w[3] for w in nearest if w is not None]),
        humidity_percent=np.array([w[4] for w in nearest if w is not None]),
    )


def fitted(ephemeris: Ephemeris, forces: ForceModel, parameters: tuple[str, ...] = _EMPIRICAL) -> Solution:
    """The orbit through an ephemeris, from its own first places. UserError where the places are no free orbit."""
    if len(ephemeris.t_tai_ns) < 12:
        raise UserError(f"{ephemeris.name}: {len(ephemeris.t_tai_ns)} places; 12 or more are expected")
    data = ephemeris.positions(_SIGMA_KM)
    t_s = 1e-9 * (data.t_tai_ns[:9] - data.t_tai_ns[0])
    slope = np.polynomial.polynomial.polyfit(t_s / t_s[-1], data.position_km[:9], 8)[1] / t_s[-1]
    start = np.concatenate([data.position_km[0], slope])
    return fit(start, int(data.t_tai_ns[0]), [data], forces, parameters, None)


def free_orbit(ephemeris: Ephemeris, forces: ForceModel) -> Solution:
    """The fitted orbit, if it is the whole ephemeris'. UserError where it misses places that are more than lone bad ones.

    A fit gives no weight to places after a manoeuvre, so all places are looked at here, whatever their weight.
    """
    solution = fitted(ephemeris, forces)
    away_km = _SIGMA_KM * np.linalg.norm(solution.residuals.reshape(-1, 3), axis=1)
    rms_km = float(np.sqrt(np.mean(away_km**2)))
    rejected = (solution.weights.reshape(-1, 3) == 0.0).any(axis=1)
    # not "<=": a rms that is no number is refused too
    if not (rms_km <= _LARGEST_RMS_KM and rejected.mean() <= _MOST_REJECTED) or solution.manoeuvre or not solution.converged:
        raise UserError(
            f"{ephemeris.name}: no free orbit fits the places: {1e3 * rms_km:.3g} m rms, "
            f"{rejected.sum()} of {len(rejected)} rejected{'' if solution.converged else ', not converged'}; "
            "a manoeuvre, or too large errors"
        )
    return solution


def orbit_of(ephemeris: Ephemeris, step_s: float = 60.0) -> PreciseOrbit:
    """States on a fine grid through an ephemeris: the fitted orbit. UserError where no free orbit fits (`free_orbit`)."""
    solution = free_orbit(ephemeris, ForceModel())
    first, last = int(ephemeris.t_tai_ns[0]), int(ephemeris.t_tai_ns[-1])
    grid = np.arange(first, last + 1, round(step_s * 1e9), dtype=np.int64)
    states = propagate(solution.state, solution.t0_tai_ns, grid, solution.forces).states
    return PreciseOrbit(name=ephemeris.name, t_tai_ns=grid, position_km=states[:, :3], velocity_km_s=states[:, 3:])
