"""Files of known objects beside a run: element sets to match against, precise ephemerides to find biases with."""

import gzip
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from astropy.table import Table

from ground.options import GroundOptions
from ground.orbit.catalogue_match import KnownObjects, match_catalogue, read_elements
from ground.orbit.ephemerides import bias_of_run, read_oem
from ground.orbit.reference import PreciseOrbit
from ground.products.tables import known_table
from ground.records import GroundProducts
from sboc_e2e.icd.errors import UserError

_Content = TypeVar("_Content")


def known_objects(options: GroundOptions) -> KnownObjects | None:
    """Element sets of `known_objects_file`; None without one. Raises `UserError` for a file that is missing or holds none."""
    if not options.known_objects_file:
        return None
    known = _read(options.known_objects_file, "known_objects_file", read_elements)
    if not known.satellites:
        raise UserError(f"ground.known_objects_file: {options.known_objects_file}: expected two-line element sets, found none")
    return known


def precise_orbits(options: GroundOptions) -> tuple[PreciseOrbit, ...]:
    """Orbits of `precise_orbits_file`; none without one. Raises `UserError` for a file that is missing or no such message."""
    return _read(options.precise_orbits_file, "precise_orbits_file", read_oem) if options.precise_orbits_file else ()


def matches(result: GroundProducts, known: KnownObjects) -> Table:
    """Table of known and unknown tracklets."""
    return known_table(result, match_catalogue(result.tracklets, result.headers, known))


def bias(result: GroundProducts, orbits: tuple[PreciseOrbit, ...]) -> dict[str, Any]:
    """Bias of time tags and pointing with one-sigma errors, JSON-able; values of None when no tracklet belongs to an orbit."""
    names = ("time_s", "east_arcsec", "north_arcsec")
    found = bias_of_run(result.tracklets, result.headers, orbits)
    if found is None:
        return dict.fromkeys(names) | {"n_used": 0, "reason": "no tracklet of an object with a precise orbit"}
    sigma = np.sqrt(np.diag(found.covariance))
    values = {name: {"value": getattr(found, name), "sigma": float(s)} for name, s in zip(names, sigma, strict=True)}
    return values | {"n_used": found.n_used, "n_clipped": found.n_clipped, "chi2_nu": found.chi2_nu}


def _read(path: str, option: str, parse: Callable[[str], _Content]) -> _Content:
    """What a file holds, which may be gzipped; errors name the key and the file."""
    try:
        raw = Path(path).read_bytes()
        return parse((gzip.decompress(raw) if path.endswith(".gz") else raw).decode("utf-8"))
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UserError(f"ground.{option}: {path}: {reason}; give a readable file or an empty string for none") from error
    except UserError as error:
        raise UserError(f"ground.{option}: {path}: {error}") from error
