"""The committed baseline, and what counts as a regression: worse by more than the measured noise allows.

A figure is kept with the standard deviation of its measured noise (its 90 % interval as a normal's). It has regressed when it
is worse by more than four standard deviations of baseline and measurement together, and by more than a floor. Figures without
a measured noise are reported and not judged; timings and memory have a fixed tolerance. Biases are judged by their size.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sboc_e2e.bench.entries import EITHER, LOWER, Entry
from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.errors import UserError

SIGMAS: Final = 4.0
FLOOR_SHARE: Final = 0.02
"""Smallest change that counts, as a share of the baseline: differences below are not worth a failed build."""

TIMING_UNITS: Final = ("s", "ms", "MB", "MB/s")
TIMING_SHARE: Final = 0.5
"""Timings and memory of shared machines scatter by tens of per cent; ratios to peers in the same run are the sharper test."""


@dataclass(frozen=True, kw_only=True)
class Regression:
    """A figure that became worse."""

    name: str
    before: float
    now: float
    allowed: float

    def __str__(self) -> str:
        """One line for a person."""
        return f"{self.name}: {self.now:.4g} where the baseline has {self.before:.4g} (allowed change {self.allowed:.2g})"


def judged(e: Entry) -> bool:
    """Whether a figure can regress: it has a value, a better direction, and a noise that is known."""
    return e.value is not None and e.better != EITHER and (e.measured or e.unit in TIMING_UNITS)


def write_baseline(path: Path, entries: Iterable[Entry]) -> None:
    """Keep values and their noise of all figures that can regress."""
    kept = {e.name: {"value": e.value, "sigma": e.sigma} for e in entries if judged(e)}
    write_text(path, json.dumps(kept, indent=1, sort_keys=True) + "\n")


def read_baseline(path: Path) -> dict[str, dict[str, float]]:
    """The committed baseline. Raises UserError when there is none."""
    try:
        return dict(json.loads(path.read_text()))
    except FileNotFoundError as error:
        raise UserError(f"{path}: no baseline; write one with: sboc bench --write-baseline") from error
    except ValueError as error:
        raise UserError(f"{path}: not a baseline file ({error})") from error


def regressions(entries: Iterable[Entry], baseline: dict[str, dict[str, float]]) -> list[Regression]:
    """Figures that are worse than the baseline by more than four sigma of both and the floor."""
    out = []
    for e in entries:
        before = baseline.get(e.name)
        if before is None or e.value is None or not judged(e):
            continue
        signed = float(before["value"])
        value, now = (abs(signed), abs(e.value)) if "bias" in e.name else (signed, e.value)
        share = TIMING_SHARE if e.unit in TIMING_UNITS else FLOOR_SHARE
        allowed = max(SIGMAS * (e.sigma**2 + float(before["sigma"]) ** 2) ** 0.5, share * value, 1e-9)
        worse = now - value if e.better == LOWER else value - now
        if worse > allowed:
            out.append(Regression(name=e.name, before=signed, now=e.value, allowed=allowed))
    return out
