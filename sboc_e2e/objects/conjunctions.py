"""Conjunction messages judged, and element sets screened against each other."""

from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray
from sgp4.api import SatrecArray

from ground.conjunctions.assess import Assessment, assess
from ground.conjunctions.cdm import ConjunctionMessage, Line, cdm_text, read_cdm
from ground.conjunctions.screening import Approaches, screen
from ground.orbit.catalogue_match import read_elements
from ground.orbit.reference import utc_jd
from ground.products.epochs import utc_text
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.texts import text_of

METHODS: Final = {"two-dimensional": "ALFANO-2005", "curved": "OTHER", "Monte Carlo": "MCKINLEY-2006"}
"""Words of the SANA registry of methods where there is one for what stands."""


def assess_message(path: Path, hard_body_m: float | None, pairs: int) -> tuple[ConjunctionMessage, Assessment]:
    """Read a message and judge its encounter. hard_body_m : combined radius, replaces that of the message."""
    message = read_cdm(text_of(path), path.name)
    radius_km = message.hard_body_km if hard_body_m is None else 1e-3 * hard_body_m
    if radius_km is None:
        raise UserError(f'{path.name}: no hard-body radius: no comment "HBR = .. [m]" in the message; give --hard-body METRES')
    if pairs < 1000:
        raise UserError(f"--pairs: expected 1000 or more, got {pairs}")
    return message, assess(message.first, message.second, radius_km, pairs)


def assessment_lines(message: ConjunctionMessage, judged: Assessment) -> list[str]:
    """What was found, for a terminal."""
    encounter, worst = judged.encounter, judged.dilution
    sigma = np.sqrt(np.linalg.eigvalsh(encounter.covariance_km2))
    foster, chan = ("not valid" if np.isnan(value) else f"{value:.4g}" for value in (judged.foster, judged.chan))
    holds = "" if judged.stands == "two-dimensional" else ", does not stand"
    return [
        f"{message.first.name} and {message.second.name}, TCA {message.text_of('TCA')} UTC",
        f"  miss {1e3 * float(np.linalg.norm(encounter.miss_km)):.1f} m, {1e3 * encounter.speed_km_s:.2f} m/s, "
        f"hard body {1e3 * encounter.hard_body_km:g} m, errors in the plane {1e3 * sigma[1]:.4g} x {1e3 * sigma[0]:.4g} m",
        f"  probability {judged.probability:.4g}: {judged.stands} ({judged.reason})",
        f"  two-dimensional{holds}: Alfano {judged.alfano:.4g}, Foster {foster}, Chan {chan}",
        f"  at most {worst.probability:.3g}, with errors {worst.scale:.3g} times as large"
        + ("; diluted: better tracking may raise the probability" if worst.diluted else ""),
        f"  the message says {message.text_of('COLLISION_PROBABILITY') or 'nothing'}",
    ]


def judged_message(message: ConjunctionMessage, judged: Assessment) -> str:
    """The message with the probability that stands, its method and the reason as a comment."""
    new = [
        Line(keyword="COLLISION_PROBABILITY", value=f"{judged.probability:.6e}"),
        Line(keyword="COLLISION_PROBABILITY_METHOD", value=METHODS[judged.stands]),
        Line(keyword="COMMENT", value=f"Probability: {judged.stands}: {judged.reason}"),
        Line(keyword="COMMENT", value=f"HBR = {1e3 * judged.encounter.hard_body_km:g} [m]"),
    ]
    dropped = ("COLLISION_PROBABILITY", "COLLISION_PROBABILITY_METHOD")
    kept = [
        line for line in message.header
        if line.keyword not in dropped and not (line.keyword == "COMMENT" and line.value.startswith("HBR"))
    ]  # fmt: skip
    return cdm_text(replace(message, header=(*kept, *new)))


def epoch_of(text: str) -> int:
    """TAI ns of an ISO epoch in UTC; UserError for anything else."""
    try:
        date = datetime.fromisoformat(text.removesuffix("Z"))
    except ValueError as error:
        raise UserError(f'epoch: expected UTC such as 2022-01-22T00:00:00, got "{text[:40]}"') from error
    if date.tzinfo is not None:
        raise UserError(f'epoch: "{text[:40]}" has a time zone; UTC without one is expected')
    parts = erfa.dtf2d("UTC", date.year, date.month, date.day, date.hour, date.minute, date.second + 1e-6 * date.microsecond)
    return tai.from_jd_parts(*(float(part) for part in erfa.utctai(*parts)))


def screen_elements(path: Path, start_utc: str, days: float, distance_km: float) -> tuple[list[str], Approaches, int]:
    """Names, every approach nearer than a distance, and the start (TAI ns): element sets propagated by SGP4, TEME axes."""
    known = read_elements(text_of(path))
    if len(known.satellites) < 2:
        raise UserError(f"{path.name}: {len(known.satellites)} element sets; two or more are expected")
    start = epoch_of(start_utc)
    array = SatrecArray(list(known.satellites))
    day, fraction = utc_jd([start])

    def states(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
        failed, place, velocity = array.sgp4(np.full(len(t_s), day[0]), fraction[0] + t_s / 86400.0)
        out = np.concatenate([place, velocity], axis=2)
        out[failed != 0] = np.nan
        return out

    found = screen(states, 86400.0 * days, distance_km)
    labels = [f"{name} ({number})" for name, number in zip(known.names, known.numbers, strict=True)]
    return labels, found, start


def write_approaches(labels: list[str], found: Approaches, start_tai_ns: int, out: Path) -> None:
    """A table of approaches as CSV: time, objects, distance, speed."""
    epochs = utc_text([start_tai_ns + round(1e9 * t) for t in found.time_s], 3)
    rows = zip(epochs, found.first, found.second, found.distance_km, found.speed_km_s, strict=True)
    lines = [f'{epoch},"{labels[int(i)]}","{labels[int(j)]}",{distance:.4f},{speed:.4f}' for epoch, i, j, distance, speed in rows]
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(["tca_utc,first,second,distance_km,speed_km_s", *lines]) + "\n", encoding="utf-8")
