"""Catalogued satellites: element sets of a file (TLE, 3LE, OMM) propagated by SGP4 into GCRS axes."""

import csv
import gzip
import json
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import erfa
import numpy as np
from astropy.time import Time
from numpy.typing import NDArray
from sgp4 import omm
from sgp4.api import SGP4_ERRORS, WGS72, Satrec, SatrecArray

from sboc_e2e.icd import tai
from sboc_e2e.icd.element_sets import element_sets
from sboc_e2e.icd.errors import UserError
from simulator.platform import earth, earth_orientation
from simulator.scene.objects import Identity, OrbitingObject

Array = NDArray[np.float64]

SIZES_BY_NAME: Final = (
    (" DEB ", 0.14),
    (" R/B ", 4.0),
    ("STARLINK", 2.2),
    ("IRIDIUM", 2.5),
    ("ONEWEB", 1.2),
    ("FLOCK", 0.2),
    ("LEMUR", 0.2),
)
"""Diameters (m) by a part of the name, the first that fits. Fragments and rocket bodies: medians of the radii that NASA's CARA
tools list (2026-06-01; n = 12,278 and 8 of the catalogue of 2022-01). Constellations, which that list leaves blank: spheres
with the face of the body without panels (2.8 x 1.4 m, 3.1 x 1.5 m, 1.0 x 1.3 m, 3U; makers' dimensions, from memory)."""


@dataclass(frozen=True, kw_only=True)
class SatelliteOptions:
    """Satellites of a file of element sets; every one that crosses the field during the run is an object of it."""

    file: str = field(default="", metadata={"doc": "TLE, 3LE or OMM (csv, json, xml) file, may be gzipped; empty for none"})
    names: tuple[str, ...] = field(default=(), metadata={"doc": "only satellites of these names or numbers; empty for all"})
    size_m: float = field(
        default=1.0, metadata={"doc": "diameter if neither the name nor a file gives it", "min": 1e-3, "max": 1000.0}
    )
    sizes_file: str = field(
        default="",
        metadata={"doc": "CSV file, may be gzipped, of catalogue numbers (ObjectID) and radii in m (HBR); empty for none"},
    )
    sizes_by_name: bool = field(
        default=True,
        metadata={
            "doc": "names tell the diameters that no file gives: fragments, rocket bodies, constellations; off: all are alike"
        },
    )
    albedo: float = field(default=0.175, metadata={"doc": "Bond albedo, the same for all", "min": 0.001, "max": 1.0})
    farthest_km: float = field(default=50000.0, metadata={"doc": "satellites beyond are left out", "min": 1.0, "max": 1e6})


@dataclass(frozen=True, kw_only=True, eq=False)
class Satellite:
    """An element set, its name, and its diameter where one is known."""

    name: str
    record: Satrec
    size_m: float | None = None


def read_satellites(path: str | Path, names: Iterable[str] = ()) -> list[Satellite]:
    """Element sets of a file; those of the given names or catalogue numbers, or all. SGP4 may refuse them later (`propagate`).

    UserError for a missing or damaged file, a malformed set (with its line) and a name that is not there.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"satellite file {path}: no such file")
    text = _text_of(path, f"satellite file {path}")
    kind = path.with_suffix("").suffix if path.suffix == ".gz" else path.suffix
    found = _read_omm(path, text, kind) if kind in (".csv", ".json", ".xml") else _read_lines(path, text)
    wanted = set(names)
    if wanted:
        found = [s for s in found if s.name in wanted or str(s.record.satnum) in wanted]
        missing = wanted - {s.name for s in found} - {str(s.record.satnum) for s in found}
        if missing:
            raise UserError(f"satellite file {path}: no element set named {', '.join(sorted(missing))}")
    if not found:
        raise UserError(f"satellite file {path}: holds no element set")
    return found


def _text_of(path: Path, named: str) -> str:
    """Text of a file, which may be gzipped. UserError, which begins with how the file is named, for one that cannot be read."""
    try:
        raw = path.read_bytes()
        return (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode("utf-8", errors="replace")
    except (OSError, EOFError, zlib.error) as error:
        raise UserError(f"{named}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def with_sizes(satellites: list[Satellite], path: str | Path) -> list[Satellite]:
    """Satellites with the diameters of a file, twice its radii; those that it does not know, or only as 0, keep none.

    UserError for a missing or damaged file, one without the columns ObjectID and HBR, and a row that holds no numbers.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"objects.satellites.sizes_file: {path}: no such file")
    reader = csv.DictReader(StringIO(_text_of(path, f"objects.satellites.sizes_file: {path}")))
    if not {"ObjectID", "HBR"} <= set(reader.fieldnames or ()):
        raise UserError(f"objects.satellites.sizes_file: {path}: columns ObjectID and HBR are needed")
    try:
        diameters = {int(row["ObjectID"]): 2.0 * float(row["HBR"]) for row in reader if row["HBR"]}
    except ValueError as error:
        raise UserError(
            f"objects.satellites.sizes_file: {path}, line {reader.line_num}: not a number and a radius in m"
        ) from error
    return [replace(s, size_m=diameters.get(int(s.record.satnum)) or None) for s in satellites]


def size_by_name(name: str) -> float | None:
    """Diameter by the type of object that its name tells; None for other names."""
    return next((size for part, size in SIZES_BY_NAME if part in f" {name.upper()} "), None)


def size_of(satellite: Satellite, options: SatelliteOptions) -> float:
    """Diameter of a satellite: that of the file, of its name's type, or the one for all others."""
    return satellite.size_m or (size_by_name(satellite.name) if options.sizes_by_name else None) or options.size_m


def _read_lines(path: Path, text: str) -> list[Satellite]:
    sets = element_sets(text, f"satellite file {path}")
    return [Satellite(name=name, record=Satrec.twoline2rv(*lines, WGS72)) for name, *lines in sets]


def _read_omm(path: Path, text: str, kind: str) -> list[Satellite]:
    found = []
    try:
        for number, fields in enumerate(_omm_messages(text, kind)):
            record = Satrec()
            omm.initialize(record, fields)
            found.append(Satellite(name=fields.get("OBJECT_NAME", f"set {number}"), record=record))
    except (KeyError, ValueError, TypeError, ElementTree.ParseError) as error:
        raise UserError(f"satellite file {path}: element set {len(found) + 1} cannot be read ({error})") from error
    return found


def _omm_messages(text: str, kind: str) -> Iterable[dict[str, str]]:
    """Fields of each message of an OMM file; those of JSON may be numbers or texts."""
    if kind == ".csv":
        return omm.parse_csv(text.splitlines())
    if kind == ".xml":
        return omm.parse_xml(StringIO(text))
    listed = json.loads(text)
    messages = listed if isinstance(listed, list) else [listed]
    return [{str(name): str(value) for name, value in dict(one).items()} for one in messages]


def gcrs_from_teme(tai_ns: int) -> Array:
    """(3, 3) from SGP4's true equator, mean equinox to GCRS axes (Vallado et al. 2006, AIAA 2006-6753, appendix C).

    TEME turns to the Earth-fixed frame by GMST82; from there IAU 2006/2000A leads to the GCRS.
    """
    now = earth_orientation.at(tai_ns)
    spin = erfa.rz(erfa.gmst82(*now.ut1), np.eye(3))
    polar = erfa.pom00(now.x_rad, now.y_rad, 0.0)
    return np.asarray(earth.itrs_from_gcrs(tai_ns).T @ polar @ spin)


def utc_parts(tai_ns: int) -> tuple[float, float]:
    """Julian date (UTC) for SGP4."""
    utc = Time(*tai.to_jd_parts(tai_ns), format="jd", scale="tai").utc
    return float(utc.jd1), float(utc.jd2)


def propagate(satellites: list[Satellite], epoch_tai_ns: int, time_s: Array) -> tuple[Array, Array, NDArray[np.uint8]]:
    """Positions and velocities (m, n, 3), GCRS km and km/s, and SGP4's error codes (m, n), at times after an epoch."""
    jd, fraction = utc_parts(epoch_tai_ns)
    error, position, velocity = SatrecArray([s.record for s in satellites]).sgp4(
        np.full(len(time_s), jd), fraction + np.asarray(time_s) / earth.DAY_S
    )
    turn = gcrs_from_teme(epoch_tai_ns + round(float(np.mean(time_s)) * 1e9))
    return position @ turn.T, velocity @ turn.T, error


def satellite_object(satellite: Satellite, options: SatelliteOptions, epoch_tai_ns: int) -> OrbitingObject:
    """A satellite as an object of the run; UserError, by name, where SGP4 gives up during it."""
    jd, fraction = utc_parts(epoch_tai_ns)
    turn = gcrs_from_teme(epoch_tai_ns)

    def positions_km(time_s: Array) -> Array:
        time_s = np.atleast_1d(time_s)
        error, position, _ = satellite.record.sgp4_array(np.full(len(time_s), jd), fraction + time_s / earth.DAY_S)
        if error.any():
            code = int(error[error > 0][0])
            raise UserError(f"satellite {satellite.name!r}: refused by SGP4 ({SGP4_ERRORS.get(code, code)})")
        return np.asarray(position @ turn.T)

    record = satellite.record
    return OrbitingObject(
        identity=Identity(
            name=satellite.name,
            kind="tle",
            size_m=size_of(satellite, options),
            albedo=options.albedo,
            a_km=float((earth.MU_KM3_S2 / (record.no_kozai / 60.0) ** 2) ** (1.0 / 3.0)),
            e=float(record.ecco),
            i_deg=float(np.degrees(record.inclo)),
        ),
        positions_km=positions_km,
    )
