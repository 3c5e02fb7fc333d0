"""Orbit Ephemeris Messages (CCSDS 502.0-B-2): the states that were published, with their covariances."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.published.axes import gcrs_from
from sboc_e2e.score.published.covariance_lines import in_gcrs, symmetric
from sboc_e2e.score.published.epochs import tai_ns
from sboc_e2e.score.published.kvn import Kvn, Line, UnreadableProduct, read_kvn

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Ephemeris:
    """States of one segment by time: t_tai_ns (n,), state (n, 6) km and km/s, GCRS axes.

    covariance : (n, 6, 6) km2, km2/s, km2/s2, NaN at epochs for which none is given. centre, interpolation, degree : as the
    segment says; "" and 0 where it does not.
    """

    t_tai_ns: NDArray[np.int64]
    state: Array
    covariance: Array
    centre: str = ""
    interpolation: str = ""
    degree: int = 0


def read_oem(path: Path) -> tuple[Ephemeris, ...]:
    """All segments. Raises UnreadableProduct."""
    message = read_kvn(path, "CCSDS_OEM_VERS")
    starts = [k for k, line in enumerate(message.lines) if not line.keyword and line.value == "META_START"]
    if not starts:
        raise message.wrong(message.lines[-1], "META_START")
    ends = [*starts[1:], len(message.lines)]
    return tuple(_segment(message, message.lines[a + 1 : b]) for a, b in zip(starts, ends, strict=True))


def _segment(message: Kvn, lines: tuple[Line, ...]) -> Ephemeris:
    meta: dict[str, str] = {}
    rows: list[tuple[str, list[float]]] = []
    blocks: list[tuple[str, str, list[float]]] = []
    in_meta, in_covariance = True, False
    epoch, frame = "", ""
    triangle: list[float] = []
    for line in lines:
        if line.keyword:
            if in_meta:
                meta[line.keyword] = line.value
            elif in_covariance and line.keyword == "EPOCH":
                # each matrix names its own axes, or is on those of the states
                epoch, triangle, frame = line.value, [], meta.get("REF_FRAME", "")
            elif in_covariance and line.keyword == "COV_REF_FRAME":
                frame = line.value
        elif line.value == "META_STOP":
            in_meta = False
        elif line.value in ("COVARIANCE_START", "COVARIANCE_STOP"):
            in_covariance = line.value == "COVARIANCE_START"
        elif in_covariance:
            triangle = [*triangle, *message.numbers(line, line.value.split(), len(line.value.split()))]
            if len(triangle) == 21:
                blocks.append((epoch, frame, triangle))
        else:
            when, *numbers = line.value.split()
            if len(numbers) not in (6, 9):
                raise message.wrong(line, "an epoch and 6 or 9 numbers")
            rows.append((when, message.numbers(line, numbers, len(numbers))[:6]))
    try:
        return _assembled(meta, rows, blocks)
    except UserError as error:
        raise UnreadableProduct(f"{message.name}: {error}") from error


def _assembled(
    meta: dict[str, str], rows: list[tuple[str, list[float]]], blocks: list[tuple[str, str, list[float]]]
) -> Ephemeris:
    """Everything on GCRS axes. A covariance belongs to the state of the same epoch."""
    scale = meta.get("TIME_SYSTEM", "")
    axes = gcrs_from(meta.get("REF_FRAME", ""))
    t = tai_ns([when for when, _ in rows], scale)
    state = np.array([numbers for _, numbers in rows]).reshape(-1, 2, 3) @ axes.T
    state = state.reshape(-1, 6)
    covariance = np.full((len(rows), 6, 6), np.nan)
    place = {int(ns): k for k, ns in enumerate(t)}
    for epoch, frame, triangle in blocks:
        k = place.get(int(tai_ns([epoch], scale)[0]))
        if k is not None:
            covariance[k] = in_gcrs(symmetric(triangle), frame, state[k, :3], state[k, 3:])
    order = np.argsort(t, kind="stable")
    return Ephemeris(
        t_tai_ns=t[order],
        state=state[order],
        covariance=covariance[order],
        centre=meta.get("CENTER_NAME", ""),
        interpolation=meta.get("INTERPOLATION", ""),
        degree=_degree(meta.get("INTERPOLATION_DEGREE", "0")),
    )


def _degree(text: str) -> int:
    if not text.isdecimal():
        raise UserError(f"expected INTERPOLATION_DEGREE as a whole number, got '{text[:40]}'")
    return int(text)
