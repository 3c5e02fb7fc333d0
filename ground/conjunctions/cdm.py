"""CCSDS Conjunction Data Message 1.0 (508.0-B-1), KVN: read into states with covariances, and written.

A message is a list of keywords in order, kept as text, so that what is read is written as it was. What is computed with is
checked: units, frames, covariances. States km and km/s; covariances in the message are RTN, m^2 and so on.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.conjunctions.encounter import StateEstimate, encounter_of, refuse_unless_positive
from ground.products.epochs import utc_text
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

FRAMES: Final = ("EME2000", "GCRF")
"""Inertial frames that are computed in; the standard's third one, ITRF, turns and is refused by name."""
_STATE: Final = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
_RTN: Final = ("R", "T", "N", "RDOT", "TDOT", "NDOT")
_UNITS: Final = dict.fromkeys(_STATE[:3], "km") | dict.fromkeys(_STATE[3:], "km/s")
_TRIANGLE: Final = [(i, j) for i in range(6) for j in range(i + 1)]
_COVARIANCE: Final = {f"C{_RTN[i]}_{_RTN[j]}": ("m**2" if i < 3 else "m**2/s" if j < 3 else "m**2/s**2") for i, j in _TRIANGLE}
_REQUIRED: Final = ("OBJECT_DESIGNATOR", "OBJECT_NAME", "REF_FRAME", *_STATE, *_COVARIANCE)
_HEADER: Final = ("CCSDS_CDM_VERS", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID", "TCA", "MISS_DISTANCE")
_VALUE: Final = re.compile(r"^(?P<value>.*?)\s*(?:\[(?P<unit>[^\]]*)\])?$")
_HARD_BODY: Final = re.compile(r"^\s*HBR\s*=\s*(?P<value>[-+0-9.eE]+)\s*\[m\]\s*$")
_LONGEST: Final = 1_000_000
"""A message with all covariances has some 10,000 characters: a file of another kind is refused before it is parsed."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A keyword with its value and unit as text; the keyword COMMENT holds a comment."""

    keyword: str
    value: str
    unit: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class ConjunctionMessage:
    """A message: lines before the first object, lines of each of the two, and what is computed with.

    tca_utc : as text. first, second : states at TCA and covariances, inertial axes. hard_body_km : of a comment "HBR = .. [m]" as
    operators write it (the standard has no field); None without.
    """

    header: tuple[Line, ...]
    objects: tuple[tuple[Line, ...], tuple[Line, ...]]
    first: StateEstimate
    second: StateEstimate
    hard_body_km: float | None = field(default=None)

    def text_of(self, keyword: str) -> str | None:
        """Value of a header keyword; None without."""
        return next((line.value for line in self.header if line.keyword == keyword), None)


def read_cdm(text: str, where: str) -> ConjunctionMessage:
    """The message in a text; `where` names it in errors. UserError for anything that is not a complete, sound message."""
    if len(text) > _LONGEST:
        raise UserError(f"{where}: longer than {_LONGEST} characters; not a conjunction message")
    header: list[Line] = []
    objects: list[list[Line]] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = _parsed(raw, f"{where}, line {number}")
        if line is None:
            continue
        if not header and line.keyword != "CCSDS_CDM_VERS":
            raise UserError(f"{where}: not a conjunction message in KVN: the first keyword is not CCSDS_CDM_VERS")
        if line.keyword == "OBJECT":
            expected = f"OBJECT{len(objects) + 1}"
            if line.value != expected or len(objects) == 2:
                raise UserError(
                    f"{where}, line {number}: OBJECT: expected {expected if len(objects) < 2 else 'two objects only'}"
                )
            objects.append([line])
        else:
            (objects[-1] if objects else header).append(line)
    if not header:
        raise UserError(f"{where}: empty; expected a conjunction message (CCSDS 508.0-B-1, KVN)")
    if not header[0].value.startswith("1."):
        raise UserError(f"{where}: CCSDS_CDM_VERS {header[0].value[:20]}: expected 1.0")
    if len(objects) != 2:
        raise UserError(f"{where}: {len(objects)} of the two objects")
    named = {line.keyword for line in header}
    for keyword in _HEADER:
        if keyword not in named:
            raise UserError(f"{where}: {keyword} is missing")
    states = [_estimate(lines, f"{where}, OBJECT{k + 1}") for k, lines in enumerate(objects)]
    frames = {_one(lines, "REF_FRAME") for lines in objects}
    if len(frames) > 1:
        raise UserError(f"{where}: REF_FRAME differs between the objects ({' and '.join(sorted(frames))})")
    return ConjunctionMessage(
        header=tuple(header),
        objects=(tuple(objects[0]), tuple(objects[1])),
        first=states[0],
        second=states[1],
        hard_body_km=_hard_body(header, where),
    )


def _parsed(raw: str, where: str) -> Line | None:
    """A line of KVN; None for an empty one."""
    text = raw.strip()
    if not text:
        return None
    if text.startswith("COMMENT"):
        return Line(keyword="COMMENT", value=text.removeprefix("COMMENT").strip())
    keyword, equals, rest = (part.strip() for part in text.partition("="))
    if not equals or not re.fullmatch(r"[A-Z][A-Z0-9_]*", keyword):
        raise UserError(f'{where}: expected "KEYWORD = value", got "{text[:40]}"')
    match = _VALUE.match(rest)
    if match is None or not match["value"]:
        raise UserError(f"{where}: {keyword} has no value")
    return Line(keyword=keyword, value=match["value"], unit=match["unit"] or "")


def _one(lines: Sequence[Line], keyword: str) -> str:
    return next(line.value for line in lines if line.keyword == keyword)


def _estimate(lines: Sequence[Line], where: str) -> StateEstimate:
    """State and covariance of an object, inertial axes."""
    by_name: dict[str, Line] = {}
    for line in lines:
        if line.keyword != "COMMENT" and line.keyword in by_name:
            raise UserError(f"{where}: {line.keyword} twice")
        by_name[line.keyword] = line
    for keyword in _REQUIRED:
        if keyword not in by_name:
            raise UserError(f"{where}: {keyword} is missing")
    frame = by_name["REF_FRAME"].value
    if frame not in FRAMES:
        raise UserError(f'{where}: REF_FRAME "{frame[:20]}" is not computed with; expected {" or ".join(FRAMES)}')
    state = np.array([_number(by_name[key], _UNITS[key], where) for key in _STATE])
    covariance = np.zeros((6, 6))
    for (i, j), (key, unit) in zip(_TRIANGLE, _COVARIANCE.items(), strict=True):
        covariance[i, j] = covariance[j, i] = _number(by_name[key], unit, where)
    refuse_unless_positive(covariance[:3, :3], f"{where}: covariance of the position")
    if not 6000.0 < float(np.linalg.norm(state[:3])) < 1e6 or float(np.linalg.norm(np.cross(state[:3], state[3:]))) < 1.0:
        raise UserError(f"{where}: X, Y, Z, X_DOT, Y_DOT, Z_DOT are no orbit about the Earth in km and km/s")
    both = np.kron(np.eye(2), rtn_axes(state).T)
    name = f"{by_name['OBJECT_NAME'].value} ({by_name['OBJECT_DESIGNATOR'].value})"
    return StateEstimate(name=name, state=state, covariance=1e-6 * both @ covariance @ both.T)


def _number(line: Line, unit: str, where: str) -> float:
    if line.unit not in ("", unit):
        raise UserError(f"{where}: {line.keyword} in [{line.unit[:20]}]; the standard has [{unit}]")
    try:
        value = float(line.value)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f'{where}: {line.keyword}: "{line.value[:30]}" is no finite number')
    return value


def _hard_body(header: Sequence[Line], where: str) -> float | None:
    for line in header:
        match = _HARD_BODY.match(line.value) if line.keyword == "COMMENT" else None
        if match is not None:
            value = _number(Line(keyword="HBR", value=match["value"]), "m", where)
            if value <= 0.0:
                raise UserError(f"{where}: HBR: expected more than 0 m, got {value:g}")
            return 1e-3 * value
    return None


def rtn_axes(state: Array) -> Array:
    """Unit vectors (3, 3), rows: radial, transverse, normal, of a state (6,)."""
    radial = state[:3] / np.linalg.norm(state[:3])
    normal = np.cross(state[:3], state[3:])
    normal = normal / np.linalg.norm(normal)
    return np.array([radial, np.cross(normal, radial), normal])


def cdm_text(message: ConjunctionMessage) -> str:
    """The message as KVN, keywords in their order."""
    return "".join(_written(line) for line in (*message.header, *message.objects[0], *message.objects[1]))


def _written(line: Line) -> str:
    if line.keyword == "COMMENT":
        return f"COMMENT {line.value}\n"
    return f"{line.keyword:<36}= {line.value}{f' [{line.unit}]' if line.unit else ''}\n"


@dataclass(frozen=True, kw_only=True, eq=False)
class MessageObject:
    """An object of a message to be written: who it is, and its state and covariance at TCA, EME2000.

    maneuverable : YES, NO or N/A. method : of the covariance, CALCULATED or DEFAULT. comments : how the orbit was made.
    """

    designator: str
    name: str
    international: str
    estimate: StateEstimate
    maneuverable: str = "N/A"
    method: str = "CALCULATED"
    comments: tuple[str, ...] = ()


def new_message(
    first: MessageObject,
    second: MessageObject,
    *,
    tca_tai_ns: int,
    created_tai_ns: int,
    originator: str,
    hard_body_km: float,
    probability: float,
    method: str,
) -> ConjunctionMessage:
    """A message about two objects whose states hold at TCA. method : of the probability, in the words of the SANA registry."""
    encounter = encounter_of(first.estimate, second.estimate, hard_body_km)
    relative = second.estimate.state - first.estimate.state
    axes = rtn_axes(first.estimate.state)
    place, drift = 1e3 * axes @ relative[:3], 1e3 * axes @ relative[3:]
    tca = utc_text([tca_tai_ns], 3)[0]
    stamp = re.sub(r"[-:T]", "", tca.partition(".")[0])
    header = [
        Line(keyword="CCSDS_CDM_VERS", value="1.0"),
        Line(keyword="CREATION_DATE", value=utc_text([created_tai_ns], 3)[0]),
        Line(keyword="ORIGINATOR", value=originator),
        Line(keyword="MESSAGE_ID", value=f"{first.designator}_conj_{second.designator}_{stamp}"),
        Line(keyword="TCA", value=tca),
        Line(keyword="MISS_DISTANCE", value=f"{1e3 * float(np.linalg.norm(relative[:3])):.3f}", unit="m"),
        Line(keyword="RELATIVE_SPEED", value=f"{1e3 * encounter.speed_km_s:.4f}", unit="m/s"),
        *(
            Line(keyword=f"RELATIVE_POSITION_{axis}", value=f"{value:.3f}", unit="m")
            for axis, value in zip("RTN", place, strict=True)
        ),
        *(
            Line(keyword=f"RELATIVE_VELOCITY_{axis}", value=f"{value:.4f}", unit="m/s")
            for axis, value in zip("RTN", drift, strict=True)
        ),
        Line(keyword="COLLISION_PROBABILITY", value=f"{probability:.6e}"),
        Line(keyword="COLLISION_PROBABILITY_METHOD", value=method),
        Line(keyword="COMMENT", value=f"HBR = {1e3 * hard_body_km:g} [m]"),
    ]
    objects = _object_lines(1, first), _object_lines(2, second)
    return ConjunctionMessage(
        header=tuple(header), objects=objects, first=first.estimate, second=second.estimate, hard_body_km=hard_body_km
    )


def _object_lines(number: int, item: MessageObject) -> tuple[Line, ...]:
    estimate = item.estimate
    both = np.kron(np.eye(2), rtn_axes(estimate.state))
    covariance = 1e6 * both @ estimate.covariance @ both.T
    return (
        Line(keyword="OBJECT", value=f"OBJECT{number}"),
        Line(keyword="OBJECT_DESIGNATOR", value=item.designator),
        Line(keyword="CATALOG_NAME", value="SATCAT"),
        Line(keyword="OBJECT_NAME", value=item.name),
        Line(keyword="INTERNATIONAL_DESIGNATOR", value=item.international),
        Line(keyword="EPHEMERIS_NAME", value="NONE"),
        Line(keyword="COVARIANCE_METHOD", value=item.method),
        Line(keyword="MANEUVERABLE", value=item.maneuverable),
        Line(keyword="REF_FRAME", value="EME2000"),
        *(Line(keyword="COMMENT", value=text) for text in item.comments),
        *(
            Line(keyword=key, value=f"{value:.9f}" if k < 3 else f"{value:.12f}", unit=_UNITS[key])
            for k, (key, value) in enumerate(zip(_STATE, estimate.state, strict=True))
        ),
        *(
            Line(keyword=key, value=f"{covariance[i, j]:.14e}", unit=unit)
            for (i, j), (key, unit) in zip(_TRIANGLE, _COVARIANCE.items(), strict=True)
        ),
    )
