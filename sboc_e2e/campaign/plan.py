"""What a campaign file asks for: points of the parameter space, replicas, and the seed of each task.

A seed depends on the campaign's seed and the replica: points see the same sky and noise, so that they differ in what is varied.
With ``paired = false`` it depends on the point's values too. Order and worker count never matter.
"""

import dataclasses
import datetime as dt
import hashlib
import itertools
import json
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

import astropy.units as u
import numpy as np

from sboc_e2e.icd.errors import UserError
from sboc_e2e.scenario.toml_files import FOLDER

KEYS: Final = ("scenario", "description", "seed", "replicas", "draws", "paired", "set", "vary")
RANGE_KEYS: Final = {"low", "high", "scale"}
SEED: Final = "seed"
"""Key of a scenario that a campaign has of its own: seeds of runs follow from it."""
MAX_TASKS: Final = 1_000_000
"""Chosen, not measured: all tasks are listed before the first starts, and a larger number is a mistyped grid."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One run: where in the parameter space, which replica, which seed."""

    number: int
    point: tuple[tuple[str, Any], ...]
    replica: int
    seed: int

    @property
    def label(self) -> str:
        """The point in words."""
        return ", ".join(f"{key} = {value}" for key, value in self.point) or "the scenario as it is"


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """A parsed campaign file.

    vary : key -> list of values (grid) or a range to draw from (``{low, high, scale}``, then `draws` points are drawn, the same
    ones for each point of the grid). paired : common random numbers, every point with the same seeds.
    """

    name: str
    scenario: str
    description: str = ""
    seed: int = 1
    replicas: int = 1
    draws: int = 0
    paired: bool = True
    constant: dict[str, Any] = field(default_factory=dict)
    vary: dict[str, Any] = field(default_factory=dict)

    def tasks(self) -> tuple[Task, ...]:
        """All tasks in the order of their points."""
        points = self._points()
        if len(points) * self.replicas > MAX_TASKS:
            raise UserError(f"campaign {self.name}: {len(points) * self.replicas} tasks; allowed are {MAX_TASKS}")
        out: list[Task] = []
        for point in points:
            for replica in range(self.replicas):
                out.append(Task(number=len(out), point=point, replica=replica, seed=self._seed(point, replica)))
        return tuple(out)

    def reduced(self, replicas: int | None, overrides: Sequence[str]) -> "Campaign":
        """The same campaign with fewer replicas or other values of keys that it does not vary (``key=value`` texts).

        ``seed=N`` replaces the campaign's own seed, from which those of its runs follow: other draws, as for a run.
        """
        constant, seed = dict(self.constant), self.seed
        for text in overrides:
            key, equals, value = text.partition("=")
            if not equals or not key.strip():
                raise UserError(f'--set: expected key=value such as frames=3, got "{text[:80]}"')
            if key.strip() in self.vary:
                raise UserError(f"--set: campaign {self.name} varies {key.strip()}")
            if key.strip() == SEED:
                if not value.strip().isdecimal():
                    raise UserError(f'--set: seed: expected a whole number of 0 or more, got "{value.strip()[:80]}"')
                seed = int(value)
            else:
                constant[key.strip()] = value.strip()
        if replicas is not None and replicas < 1:
            raise UserError(f"--replicas: expected 1 or more, got {replicas}")
        return dataclasses.replace(self, constant=constant, seed=seed, replicas=replicas or self.replicas)

    def _seed(self, point: tuple[tuple[str, Any], ...], replica: int) -> int:
        own = () if self.paired else sorted((k, repr(v)) for k, v in point)
        text = repr((self.seed, own, replica))
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:7], "big")

    def _points(self) -> list[tuple[tuple[str, Any], ...]]:
        lists = {k: v for k, v in self.vary.items() if isinstance(v, list)}
        ranges = {k: v for k, v in self.vary.items() if not isinstance(v, list)}
        grid = [tuple(zip(lists, values, strict=True)) for values in itertools.product(*lists.values())]
        if not ranges:
            return grid
        drawn = []
        for number in range(self.draws):
            # A stream of its own for each draw: more of them leave the first ones as they are.
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
            drawn.append(tuple((k, _draw(r, rng)) for k, r in ranges.items()))
        # Draws of a narrow range may coincide as texts: one point with its runs twice would pass for more of them.
        return [(*fixed, *draw) for fixed in grid for draw in dict.fromkeys(drawn)]


def _draw(interval: dict[str, Any], rng: np.random.Generator) -> Any:
    """A value between low and high, uniform or log-uniform; quantities keep the unit of `low`."""
    low, high = u.Quantity(interval["low"]), u.Quantity(interval["high"])
    a, b = float(low.value), float(high.to_value(low.unit))
    share = float(rng.random())
    value = a * (b / a) ** share if interval.get("scale") == "log" else a + (b - a) * share
    return f"{value:.9g} {low.unit}" if isinstance(interval["low"], str) else value


def shipped() -> dict[str, Path]:
    """Campaigns that come with the project, by name."""
    return {path.stem: path for path in sorted((FOLDER / "campaigns").glob("*.toml"))}


def find_campaign(name: str | Path) -> Path:
    """File of a campaign given by name or path."""
    path = Path(name)
    if path.is_file():
        return path
    if str(name) in shipped():
        return shipped()[str(name)]
    raise UserError(f"{path}: no such campaign file; give a path to a .toml file or one of: {', '.join(shipped())}")


def read_campaign(name: str | Path) -> Campaign:
    """A campaign by name or file; raises UserError with one line for anything it does not allow."""
    path = find_campaign(name)
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not a TOML file: {error}") from error
    for key in tables:
        if key not in KEYS:
            near = get_close_matches(key, KEYS, 1)
            hint = f'; did you mean "{near[0]}"?' if near else f"; known are {', '.join(KEYS)}"
            raise UserError(f'{path}: unknown key "{key}"{hint}')
    if not isinstance(tables.get("scenario"), str):
        raise UserError(f'{path}: scenario: expected a name such as "smoke"')
    paired = tables.get("paired", True)
    if not isinstance(paired, bool):
        raise UserError(f"{path}: paired: expected true or false, got {paired!r}")
    for name in ("set", "vary"):
        if not isinstance(tables.get(name, {}), dict):
            raise UserError(f"{path}: {name}: expected a table of scenario keys")
        _require_keys(path, name, tables.get(name, {}))
    vary = tables.get("vary", {})
    draws = _whole(path, tables, "draws", 0)
    for key, value in vary.items():
        if isinstance(value, list) and value:
            _require_different(path, key, value)
            continue
        if not isinstance(value, dict) or not {"low", "high"} <= set(value) <= RANGE_KEYS:
            raise UserError(f"{path}: vary.{key}: expected a list of values or {{low, high, scale}}")
        if draws < 1:
            raise UserError(f"{path}: draws: vary.{key} is a range, so draws must be 1 or more")
        _draw_check(path, key, value)
    return Campaign(
        name=path.stem,
        scenario=tables["scenario"],
        description=str(tables.get("description", "")),
        seed=_whole(path, tables, "seed", 1),
        replicas=max(1, _whole(path, tables, "replicas", 1)),
        draws=draws,
        paired=paired,
        constant=dict(tables.get("set", {})),
        vary=dict(vary),
    )


def _whole(path: Path, tables: dict[str, Any], key: str, default: int) -> int:
    value = tables.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise UserError(f"{path}: {key}: expected a whole number of 0 or more, got {value!r}")
    return value


def _require_keys(path: Path, name: str, table: dict[str, Any]) -> None:
    """Refuse what cannot be a key or a value of a scenario's run."""
    if SEED in table:
        raise UserError(f"{path}: {name}.seed: seeds of runs follow from the campaign's own key: write seed = N above [{name}]")
    for key, value in table.items():
        if (date := _first_date(value)) is not None:
            raise UserError(f'{path}: {name}.{key}: a date is a text in quotes, such as "{date}"')


def _first_date(value: Any) -> str | None:
    """The first date or time of TOML in a value, as text."""
    if isinstance(value, dt.date | dt.time):
        return value.isoformat()
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return next((date for part in parts if (date := _first_date(part)) is not None), None)


def _require_different(path: Path, key: str, values: list[Any]) -> None:
    """Refuse a value that is given twice: runs of one point would be counted twice, and intervals be too narrow."""
    seen: set[str] = set()
    for value in values:
        plain = float(value) if type(value) is int and abs(value) < 2**53 else value
        text = json.dumps(plain)
        if text in seen:
            raise UserError(f"{path}: vary.{key}: {json.dumps(value)} is given twice; each value once")
        seen.add(text)


def _draw_check(path: Path, key: str, interval: dict[str, Any]) -> None:
    try:
        low, high = u.Quantity(interval["low"]), u.Quantity(interval["high"])
        ordered = bool(high > low)
    except (TypeError, ValueError, u.UnitsError) as error:
        raise UserError(f"{path}: vary.{key}: low and high need the same dimension ({error})") from error
    if not ordered or interval.get("scale", "linear") not in ("linear", "log"):
        raise UserError(f'{path}: vary.{key}: low must be less than high; scale is "linear" or "log"')
    if interval.get("scale") == "log" and float(low.value) <= 0:
        raise UserError(f"{path}: vary.{key}: a log scale needs low > 0")
