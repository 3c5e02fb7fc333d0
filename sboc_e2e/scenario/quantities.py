"""Quantity strings of scenarios ("0.2 s") and the unit suffixes of option fields (`exposure_s`).

The key of a TOML value is the field's name without its unit suffix; the value is a string with any unit of the same
dimension. Fields without a suffix are dimensionless and take bare numbers.
"""

import math
import re
import warnings
from functools import lru_cache
from typing import Final

from astropy import units

UNIT_SUFFIXES: Final[dict[str, str]] = {
    "ns": "ns", "us": "us", "ms": "ms", "s": "s", "h": "h", "day": "day", "days": "day", "yr": "yr", "hz": "Hz", "nm": "nm",
    "um": "um", "mm": "mm", "cm": "cm", "m": "m", "km": "km", "m2": "m2", "cm2": "cm2", "au": "AU", "m_s": "m / s",
    "km_s": "km / s", "km_day": "km / day", "m_s2": "m / s2", "rad": "rad", "deg": "deg", "arcmin": "arcmin",
    "arcsec": "arcsec", "mas": "mas", "hour_angle": "hourangle", "deg_s": "deg / s", "rad_s": "rad / s",
    "arcsec_s": "arcsec / s", "mas_yr": "mas / yr", "arcsec_px": "arcsec / pix", "deg_s2": "deg / s2", "deg_yr": "deg / yr",
    "arcsec_s2": "arcsec / s2", "rad2": "rad2", "deg2": "deg2", "per_deg2": "1 / deg2", "px": "pix", "px_s": "pix / s",
    "px_s2": "pix / s2", "mag_s": "mag / s", "mv": "MV", "px2": "pix2", "um_px": "um / pix", "e": "electron",
    "e_s": "electron / s", "e_px": "electron / pix", "e_px_s": "electron / (pix s)", "e_um": "electron / um",
    "e_adu": "electron / adu", "e_s_px": "electron / (pix s)", "adu": "adu", "adu_s": "adu / s", "adu_px": "adu / pix",
    "mag": "mag", "mag_arcsec2": "mag / arcsec2", "m2_s": "1 / (m2 s)", "per_cm2": "1 / cm2", "ff": "fF",
    "per_cm2_s": "1 / (cm2 s)", "cm2_s": "1 / (cm2 s)", "per_s": "1 / s", "g_cm2": "g / cm2", "ev": "eV", "kev": "keV",
    "mev": "MeV", "k": "K", "kg": "kg", "kg_m3": "kg / m3", "w_m2": "W / m2", "percent": "percent", "ppm": "1e-6",
    "m2_kg": "m2 / kg",
    "ppm_s": "1e-6 / s", "bytes": "byte", "bits": "bit", "bit_s": "bit / s", "mbit_s": "Mbit / s", "kbit_s": "kbit / s",
}  # fmt: skip
"""Unit suffix of a field's name (without the leading underscore) and its unit as astropy spells it."""

MAX_TEXT: Final = 80  # Characters of a value in an error's one line, and of a quantity: longer ones are no quantities.
MAX_EXAMPLE: Final = 20  # Characters of a number that a message repeats as an example; a double needs 17 digits at most.
_LONGEST_SUFFIX: Final = max(suffix.count("_") + 1 for suffix in UNIT_SUFFIXES)
_NUMBER: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*([^\d\s].*)?$")
_UNIT_TEXT: Final = re.compile(r"[A-Za-z0-9 */().^%_-]{1,40}$")
_LARGE_EXPONENT: Final = re.compile(r"\d{3,}")
_SPELLINGS: Final = ((re.compile(r"\be-"), "electron"), (re.compile(r"\bpx(?![a-zA-Z])"), "pix"), (re.compile(r"\bADU\b"), "adu"),
                     (re.compile(r"\barcsec(ond)?s\b"), "arcsec"), (re.compile(r"^%$"), "percent"),
                     (re.compile(r"^ppm"), "1e-6 "))  # fmt: skip


class QuantityError(ValueError):
    """A text that is not a quantity of the wanted dimension; the message says what was expected and what was given."""


def split_name(name: str) -> tuple[str, str | None]:
    """TOML key and unit of an option field: ``"exposure_s" -> ("exposure", "s")``, ``"n_sigma" -> ("n_sigma", None)``."""
    words = name.split("_")
    for count in range(min(_LONGEST_SUFFIX, len(words) - 1), 0, -1):
        unit = UNIT_SUFFIXES.get("_".join(words[-count:]))
        if unit is not None:
            return "_".join(words[:-count]), unit
    return name, None


def display(unit: str) -> str:
    """A unit as people write it in scenarios."""
    short = unit.replace("electron", "e-").replace("pix", "px").replace("adu", "ADU").replace(" / ", "/").replace("percent", "%")
    return short.replace("1e-6", "ppm").removeprefix("1")


@lru_cache(maxsize=1024)
def _unit(text: str) -> units.UnitBase:
    """Parse a unit. Raises `QuantityError` for a text that is no unit."""
    spelled = "1" + text if text.startswith("/") else text.strip()
    for pattern, word in _SPELLINGS:
        spelled = pattern.sub(word, spelled)
    if not _UNIT_TEXT.match(spelled) or _LARGE_EXPONENT.search(spelled):
        raise QuantityError(f'unknown unit "{text[:MAX_TEXT]}"')
    try:
        with warnings.catch_warnings():
            # What the FITS standard discourages ("m/s/s") is a unit here, and not a line on the terminal.
            warnings.simplefilter("ignore", units.UnitsWarning)
            unit = units.Unit(spelled)
    except (ValueError, TypeError, OverflowError, ZeroDivisionError) as error:
        raise QuantityError(f'unknown unit "{text[:MAX_TEXT]}"') from error
    if not isinstance(unit, units.UnitBase):
        raise QuantityError(f'unknown unit "{text[:MAX_TEXT]}"')
    return unit


def parse(value: object, unit: str, limits: str = "") -> float:
    """The number of a quantity string in the wanted unit, for example ``parse("200 ms", "s") -> 0.2``.

    limits : what is allowed, in words, for the message.

    Raises `QuantityError` naming the expected unit for bare numbers, unknown units and other dimensions.
    """
    example = f'a quantity in {display(unit)}{f" ({limits})" if limits else ""}, such as "{_bare_number(value)} {display(unit)}"'
    if not isinstance(value, str):
        raise QuantityError(f"expected {example}, got {shown(value)}")
    match = _NUMBER.match(value) if len(value) <= MAX_TEXT else None
    if match is None:
        raise QuantityError(f"expected {example}, got {shown(value)}")
    number, given = float(match.group(1)), match.group(2)
    if given is None:
        raise QuantityError(f'expected {example}, got "{value}" without a unit')
    wanted = units.Unit(unit)
    got = _unit(given)
    if got == wanted:
        result = number
    else:
        try:
            result = float(got.to(wanted, number))
        except (units.UnitConversionError, units.UnitTypeError, OverflowError) as error:
            raise QuantityError(f'expected {example}, got "{value}" ({_dimension(got)})') from error
    if not math.isfinite(result):
        raise QuantityError(f"expected {example}, got {shown(value)}, which is not finite")
    return result


def write(value: float, unit: str) -> str:
    """The quantity string that parses back to exactly this number."""
    number = int(value) if isinstance(value, int) else float(value)
    return f"{number!r} {display(unit)}"


def _bare_number(value: object) -> str:
    """The number that was given without a unit, as an example of how to write it; otherwise 1."""
    text = str(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else ""
    match = _NUMBER.match(text) if len(text) <= MAX_EXAMPLE else None
    return text.strip() if match is not None and match.group(2) is None else "1"


def _dimension(unit: units.UnitBase) -> str:
    """The physical dimension of a unit in words."""
    name = str(unit.physical_type)
    return "another dimension" if name == "unknown" else name


def shown(value: object) -> str:
    """A value as an error message shows it: short and on one line."""
    text = repr(value)
    return text if len(text) <= MAX_TEXT else text[: MAX_TEXT - 3] + "..."
