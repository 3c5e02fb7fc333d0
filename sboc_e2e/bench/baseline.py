"""The committed baseline, and what counts as a regression: worse by more than the measured noise allows.

A figure is kept with the standard deviation of its measured noise (its 90 % interval as a normal's). It has regressed when it
is worse by more than four standard deviations of baseline and measurement together, and by more than a floor. Figures without
a measured noise are reported and not judged; timings and memory have a fixed tolerance. Biases are judged by their size, pulls
and coverages by their distance from what they should be.
Timings are compared in units of the part's yardstick: a baseline made on a fast machine serves on a slow one.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sboc_e2e.bench import yardstick
from sboc_e2e.bench.entries import AIMED, EITHER, HIGHER, REAL_TIME, TIMES, Entry
from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.errors import UserError

SIGMAS: Final = 4.0
"""Errors of both measurements that a change must exceed. Of 1,000 figures with normal noise 0.03 exceed four by chance (3.2e-5
each)."""
FLOOR_SHARE: Final = 0.02
"""Smallest change that counts, as a share of the baseline: differences below are not worth a failed build."""

MACHINE_POWER: Final = {"s": 1, "ms": 1, "MB/s": -1, REAL_TIME: -1, TIMES: 0, "MB": 0}
"""Power of the yardstick's time that figures of a unit follow from machine to machine."""
MACHINE_SHARE: Final = {"s": 0.5, "ms": 0.5, "MB/s": 0.5, REAL_TIME: 0.5, TIMES: 0.3, "MB": 0.1}
"""Smallest change of such figures that counts: timings of shared machines scatter by tens of per cent even in units of the
yardstick, ratios of timings in the same run by less."""


@dataclass(frozen=True, kw_only=True)
class Regression:
    """A figure that became worse."""

    name: str
    before: float
    """What the baseline has; timings as this machine would have taken."""
    now: float
    allowed: float

    def __str__(self) -> str:
        """One line for a person."""
        return f"{self.name}: {self.now:.4g} where the baseline has {self.before:.4g} (allowed change {self.allowed:.2g})"


def judged(e: Entry) -> bool:
    """Whether a figure can regress: it has a value, a better direction, and a noise that is known."""
    return e.value is not None and e.better != EITHER and (e.measured or e.unit in MACHINE_SHARE)


def _is_yardstick(e: Entry) -> bool:
    return e.name.endswith(f".{yardstick.NAME}")


def _part(name: str) -> str:
    return name.partition(".")[0]


def write_baseline(path: Path, entries: Iterable[Entry], kept: Mapping[str, dict[str, float]] = MappingProxyType({})) -> None:
    """Values and their noise of all figures that can regress, and the yardsticks.

    kept : an earlier baseline; its parts that are not among the entries are kept.
    """
    entries = list(entries)
    measured = {_part(e.name) for e in entries}
    baseline: dict[str, Any] = {name: figure for name, figure in kept.items() if _part(name) not in measured}
    baseline |= {e.name: {"value": e.value, "sigma": e.sigma} for e in entries if judged(e) or _is_yardstick(e)}
    write_text(path, json.dumps(baseline, indent=1, sort_keys=True) + "\n")


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
    entries = list(entries)
    slower = {
        _part(e.name): e.value / baseline[e.name]["value"] for e in entries if _is_yardstick(e) and e.value and e.name in baseline
    }
    out = []
    for e in entries:
        before = baseline.get(e.name)
        if before is None or e.value is None or not judged(e):
            continue
        scale = slower.get(_part(e.name), 1.0) ** MACHINE_POWER.get(e.unit, 0)
        signed, sigma = scale * float(before["value"]), scale * float(before["sigma"])
        value, now = (abs(signed - e.aim), abs(e.value - e.aim)) if e.better == AIMED else (signed, e.value)
        share = MACHINE_SHARE.get(e.unit, FLOOR_SHARE)
        allowed = max(SIGMAS * (e.sigma**2 + sigma**2) ** 0.5, share * value, 1e-9)
        worse = value - now if e.better == HIGHER else now - value
        if worse > allowed:
            out.append(Regression(name=e.name, before=signed, now=e.value, allowed=allowed))
    return out
