"""The published files in plain words: each figure of section `products`, its aim, and whether it is reached."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from sboc_e2e.report.headlines import figure_at
from sboc_e2e.report.words import figure_words, number

HOLDS, MISSES, UNSURE, UNKNOWN = "holds", "missed", "not sure", "-"
"""Inside what is aimed at; outside with the whole interval; outside, but the interval reaches in; not measured."""


@dataclass(frozen=True, kw_only=True)
class Aim:
    """What a figure should be: between `low` and `high`, or at most the figure named `bound`."""

    figure: str
    label: str
    low: float = 0.0
    high: float = float("inf")
    bound: str = ""


AIMS: Final = (
    Aim(
        figure="angles.differs_from_streaks",
        label="TDM angles that differ from streaks.ecsv by more than 1 mas (share)",
        high=0.0,
    ),
    Aim(
        figure="angles.along_rms_arcsec",
        label="TDM angles along the motion (arcsec rms)",
        bound="angles.streaks_along_rms_arcsec",
    ),
    Aim(
        figure="angles.cross_rms_arcsec",
        label="TDM angles across the motion (arcsec rms)",
        bound="angles.streaks_cross_rms_arcsec",
    ),
    Aim(figure="angles.gross_share", label="TDM angles off by more than a degree (share)", high=0.0),
    Aim(figure="angles.along_pull_std", label="errors stated for TDM angles, along (pulls)", low=0.9, high=1.1),
    Aim(figure="angles.cross_pull_std", label="errors stated for TDM angles, across (pulls)", low=0.9, high=1.1),
    Aim(figure="angles.epoch_rms_ms", label="TDM epochs (ms rms)", high=1.0),
    Aim(figure="magnitudes.line_rms_mag", label="TDM magnitudes (mag rms)"),
    Aim(figure="magnitudes.tracklet_pull_std", label="errors stated for magnitudes of tracklets (pulls)", low=0.9, high=1.1),
    Aim(figure="observer.position_rms_m", label="OEM positions of the camera (m rms)"),
    Aim(figure="observer.velocity_rms_m_s", label="OEM velocities of the camera (m/s rms)"),
    Aim(figure="observer.implied_minus_quoted_rms_m_s", label="OEM velocities implied minus quoted (m/s rms)", high=0.05),
    Aim(figure="states.covariance_share", label="tracklets with an orbit state and its covariance (share)"),
    Aim(figure="states.samples_share", label="tracklets with samples of orbit states (share)"),
    Aim(figure="states.nees", label="covariances of orbit states (NEES)", low=0.9, high=1.1),
)


@dataclass(frozen=True, kw_only=True)
class PublishedRow:
    """One line of the table, ready to print."""

    label: str
    value: str
    note: str
    aim: str
    verdict: str


def published_rows(score: Mapping[str, Any]) -> list[PublishedRow]:
    """All lines, those that could not be measured too."""
    return [_row(score, aim) for aim in AIMS]


def missed(score: Mapping[str, Any]) -> list[PublishedRow]:
    """The lines whose aim is missed."""
    return [row for row in published_rows(score) if row.verdict == MISSES]


def _row(score: Mapping[str, Any], aim: Aim) -> PublishedRow:
    figure = figure_at(score, f"products.{aim.figure}")
    value, note = figure_words(figure)
    high, wanted = aim.high, ""
    if aim.bound:
        bound = figure_at(score, f"products.{aim.bound}")["value"]
        high = float("inf") if bound is None else float(bound)
        wanted = "" if bound is None else f"at most {number(high)}, that of streaks.ecsv"
    elif aim.low > 0.0:
        wanted = f"{aim.low:g} to {aim.high:g}"
    elif high < float("inf"):
        wanted = f"at most {high:g}" if high else "0"
    return PublishedRow(label=aim.label, value=value, note=note, aim=wanted, verdict=_verdict(figure, aim.low, high, wanted))


def _verdict(figure: Mapping[str, Any], low: float, high: float, wanted: str) -> str:
    if figure["value"] is None or not wanted:
        return UNKNOWN
    slack = 1e-3 * abs(high) if high < float("inf") else 0.0  # messages round what the table does not
    if low <= figure["value"] <= high + slack:
        return HOLDS
    return MISSES if figure["low"] > high + slack or figure["high"] < low else UNSURE
