"""Tracking Data Messages (CCSDS 503.0-B-2): angles and magnitudes as they were published."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.published.axes import gcrs_from, unit_vectors
from sboc_e2e.score.published.epochs import tai_ns
from sboc_e2e.score.published.kvn import Kvn, Line, UnreadableProduct, read_kvn

Array = NDArray[np.float64]

_NUMBER: Final = re.compile(r"(\d+)$")
_CORRECTIONS: Final = ("CORRECTION_ANGLE_1", "CORRECTION_ANGLE_2", "CORRECTION_MAG")
"""Keywords of what is to be added to both angles (deg) and to magnitudes. Those of other quantities are not read."""
_DEMANDED: Final = {"ANGLE_TYPE": "RADEC", "TIMETAG_REF": "RECEIVE"}
"""What the comparison with the truth takes for granted; a segment that says otherwise is refused, not misread."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TdmSegment:
    """One tracklet.

    tracklet_id : number at the end of TRACK_ID (else of PARTICIPANT_2), -1 without one. angle_tai_ns, direction : (n,), (n, 3)
    unit vectors, GCRS axes. mag_tai_ns, mag : (m,).
    """

    tracklet_id: int
    angle_tai_ns: NDArray[np.int64]
    direction: Array
    mag_tai_ns: NDArray[np.int64]
    mag: Array


def read_tdm(path: Path) -> tuple[TdmSegment, ...]:
    """All segments. Raises UnreadableProduct."""
    message = read_kvn(path, "CCSDS_TDM_VERS")
    segments: list[TdmSegment] = []
    meta: dict[str, str] = {}
    data: list[Line] | None = None
    for line in message.lines:
        if line.value == "META_START" and not line.keyword:
            meta = {}
        elif line.value == "DATA_START" and not line.keyword:
            data = []
        elif line.value == "DATA_STOP" and not line.keyword:
            if data is None:
                raise message.wrong(line, "DATA_START before it")
            segments.append(_segment(message, meta, data, line))
            data = None
        elif data is not None:
            data.append(line)
        elif line.keyword:
            meta[line.keyword] = line.value
    if data is not None:
        raise message.wrong(message.lines[-1], "DATA_STOP")
    return tuple(segments)


def _segment(message: Kvn, meta: dict[str, str], data: list[Line], end: Line) -> TdmSegment:
    values: dict[str, dict[str, float]] = {"ANGLE_1": {}, "ANGLE_2": {}, "MAG": {}}
    for line in data:
        if line.keyword not in values:
            continue
        epoch, _, number = line.value.partition(" ")
        if epoch in values[line.keyword]:
            raise message.wrong(line, f"one {line.keyword} at each epoch")
        values[line.keyword][epoch] = message.numbers(line, number.split(), 1)[0]
    first, second, mags = values["ANGLE_1"], values["ANGLE_2"], values["MAG"]
    if first.keys() != second.keys():
        raise message.wrong(end, "ANGLE_1 and ANGLE_2 at the same epochs in the segment before it")
    if first:
        for keyword, wanted in _DEMANDED.items():
            if meta.get(keyword) != wanted:
                raise message.wrong(end, f"{keyword} = {wanted} in the segment before it, not {meta.get(keyword)}")
    try:
        scale = meta.get("TIME_SYSTEM", "")
        angle_tai_ns, mag_tai_ns = tai_ns(list(first), scale), tai_ns(list(mags), scale)
        axes = gcrs_from(meta.get("REFERENCE_FRAME", "")) if first else np.eye(3)
    except UserError as error:
        raise UnreadableProduct(f"{message.name} segment that ends in line {end.number}: {error}") from error
    add_1, add_2, add_mag = _corrections(message, meta, end)
    angle_1, angle_2 = np.array(list(first.values())), np.array([second[epoch] for epoch in first])
    direction = unit_vectors(angle_1 + add_1, angle_2 + add_2) @ axes.T
    named = _NUMBER.search(meta.get("TRACK_ID", "")) or _NUMBER.search(meta.get("PARTICIPANT_2", ""))
    return TdmSegment(
        tracklet_id=int(named.group(1)) if named else -1,
        angle_tai_ns=angle_tai_ns,
        direction=direction,
        mag_tai_ns=mag_tai_ns,
        mag=np.array(list(mags.values())) + add_mag,
    )


def _corrections(message: Kvn, meta: dict[str, str], end: Line) -> tuple[float, float, float]:
    """What is to be added to both angles (deg) and to MAG: corrections that the segment states and has not applied."""
    stated = {key: text for key, text in meta.items() if key.startswith("CORRECTION_")}
    applied = meta.get("CORRECTIONS_APPLIED", "" if stated else "YES").upper()
    if applied == "YES":
        return 0.0, 0.0, 0.0
    if applied != "NO":
        raise message.wrong(end, "CORRECTIONS_APPLIED = YES or NO in the segment before it, which states corrections")
    for key, text in stated.items():
        if key.startswith("CORRECTION_ABERRATION") and _number(message, end, key, text) != 0.0:
            raise message.wrong(end, f"{key} applied in the segment before it")
    first, second, mag = (_number(message, end, key, stated.get(key, "0")) for key in _CORRECTIONS)
    return first, second, mag


def _number(message: Kvn, end: Line, key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise message.wrong(end, f"a number as {key} in the segment before it, not '{text[:40]}'") from error
