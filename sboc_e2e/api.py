"""The commands as Python functions, for notebooks and scripts: run a scenario, compare choices of a step, sweep a campaign.

```python
from sboc_e2e.api import compare, run

result = run("smoke", set={"frames": 3})
print(result)
result.streaks  # an astropy table
result.value("detection.ground.completeness_snr8")

versus = compare("smoke", "onboard.detector", ["line_integral", "threshold"])
print(versus.verdict)
```

And one step at a time on a numpy array: `detect`, `measure`, `solve` (`sboc_e2e.outside.one_step`).

Works as written, without a guard against a second import: everything runs in this process unless `workers` says otherwise.
Compiled kernels are kept where the command line keeps them.
"""

from sboc_e2e.kernel_cache import use_cache_of_these_sources

use_cache_of_these_sources()

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table

from sboc_e2e import scenario as scenarios
from sboc_e2e.campaign import read_campaign, run_campaign
from sboc_e2e.campaign.pages import write_results
from sboc_e2e.compare import Request
from sboc_e2e.compare import compare as _compare
from sboc_e2e.compare.pages import HEAD, PAIR_HEAD, choice_rows, pair_rows, sentences_of
from sboc_e2e.icd.errors import UserError
from sboc_e2e.outside.one_step import Found, detect, measure, solve
from sboc_e2e.registry import Registry
from sboc_e2e.report.closing import closing_text
from sboc_e2e.report.headlines import figure_at, headline_rows
from sboc_e2e.report.words import figure_words
from sboc_e2e.run.pipeline import RunRequest
from sboc_e2e.run.pipeline import run as _run
from sboc_e2e.scenario.toml_files import value_text

__all__ = ["Comparison", "Found", "RunResult", "Sweep", "compare", "detect", "measure", "open_run", "run", "solve", "sweep"]


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """A finished run: its folder, and the content of the folder as tables and figures.

    folder : the run directory. score : what score.json holds. manifest : what manifest.json holds.
    """

    folder: Path
    score: Mapping[str, Any] = field(repr=False)
    manifest: Mapping[str, Any] = field(repr=False)

    def __str__(self) -> str:
        return closing_text(self.score, self.manifest["stages"])

    def figure(self, path: str) -> dict[str, Any]:
        """Value, low, high and n of a figure of the score by its dotted name; `docs/scoring.md` defines them.

        Raises `UserError` for a name that the score does not have.
        """
        found = figure_at(self.score, path)
        if "value" not in found:
            raise UserError(f'"{path}" is a section of the score, not a figure; it holds {", ".join(found)}')
        return found

    def value(self, path: str) -> float | None:
        """Value of a figure by its dotted name; None where it could not be measured."""
        value = self.figure(path)["value"]
        return None if value is None else float(value)

    @property
    def headlines(self) -> Table:
        """The figures that a run ends with, as texts: figure, value with its 90 % interval, n or the reason of its absence."""
        return _table(("figure", "value", "n"), headline_rows(self.score))

    @property
    def report(self) -> Path:
        """The page for people."""
        return self.folder / "report.html"

    def product(self, name: str) -> Table:
        """A table of products/, such as "light_curves". Raises `UserError` when the run has none of this name."""
        return _read(self.folder / "products", name)

    def truth(self, name: str = "streaks") -> Table:
        """A table of truth/: "frames", "stars", "streaks", "cosmics" or "objects". Raises `UserError`."""
        return _read(self.folder / "truth", name)

    @cached_property
    def frames(self) -> Table:
        """Time, solution and noise of each frame."""
        return self.product("frames")

    @cached_property
    def streaks(self) -> Table:
        """Measured streaks: places (px, ICRS deg), flux (e-), magnitudes (V), errors, flags."""
        return self.product("streaks")

    @cached_property
    def tracklets(self) -> Table:
        """Linked streaks: mean places, rates, magnitudes."""
        return self.product("tracklets")

    @cached_property
    def orbits(self) -> Table:
        """Coarse orbits of tracklets, with intervals."""
        return self.product("orbits")


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A finished comparison. result : what compare.json holds."""

    folder: Path
    result: Mapping[str, Any] = field(repr=False)

    def __str__(self) -> str:
        return "\n".join(self.verdict)

    @property
    def verdict(self) -> list[str]:
        """A sentence for each pair: which choice is better, by how much, with which confidence, at which cost."""
        return sentences_of(dict(self.result))

    @property
    def choices(self) -> Table:
        """One row of texts for each choice."""
        return _table(HEAD, choice_rows(dict(self.result)))

    @property
    def pairs(self) -> Table:
        """One row of texts for each pair of choices."""
        return _table(PAIR_HEAD, pair_rows(dict(self.result)))

    @property
    def questions(self) -> Table:
        """Figures of this seam in particular: one row for each figure, one column for each choice."""
        names = list(self.result["choices"])
        rows = [
            (asked["label"], *(figure_words(asked["choices"][name])[0] for name in names)) for asked in self.result["questions"]
        ]
        return _table(("figure", *names), rows)

    @property
    def report(self) -> Path:
        """The page for people."""
        return self.folder / "compare.html"


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A finished campaign. result : what campaign.json holds."""

    folder: Path
    result: Mapping[str, Any] = field(repr=False)

    @property
    def points(self) -> Table:
        """One row for each point: its values and the headline figures as texts."""
        names = ("completeness_snr8", "snr50", "false_per_frame")
        rows = [(point, *(figure_words(found[name])[0] for name in names)) for point, found in self.result["points"].items()]
        return _table(("point", *names), rows)

    @property
    def failed(self) -> Table:
        """Point, replica and reason of each task that failed."""
        rows = [(task["point"], str(task["replica"]), task["reason"]) for task in self.result["failed"]]
        return _table(("point", "replica", "reason"), rows)

    @property
    def report(self) -> Path:
        """The page for people."""
        return self.folder / "campaign.html"


def run(
    scenario: str | Path,
    out: str | Path | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    use: Mapping[str, str] | None = None,
    seed: int | None = None,
    workers: int = 1,
    plugins: Sequence[str] = (),
    force: bool = True,
) -> RunResult:
    """Simulate, process on board and on ground, score and report a scenario.

    Parameters
    ----------
    scenario : name of a shipped scenario, or path of a TOML file.
    out : run directory, by default ``runs/<scenario>``.
    set : keys to change, such as ``{"frames": 3, "shutter.exposure": "0.3 s"}``. Values may be of numpy, paths, lists, and
        tables: ``{"shutter": {"exposure": "0.3 s"}}`` is the same as ``{"shutter.exposure": "0.3 s"}``.
    use : steps to swap by seam, such as ``{"onboard.detector": "my_lab.nets:StreakNet"}``.
    seed : replaces the scenario's.
    workers : simulation processes. More than one start new interpreters that import the script again, which then
        needs ``if __name__ == "__main__":``; notebooks need nothing.
    plugins : modules that the scenario may name as ``module:Class``.
    force : replace an earlier run in `out`.

    Raises
    ------
    UserError
        One line: what is wrong, where, what is allowed.
    """
    registry = Registry(trusted_modules=tuple(plugins))
    resolved = scenarios.load(str(scenario), registry=registry, overrides=_overrides(set), use=use or {}, seed=seed)
    folder = Path(out) if out is not None else Path("runs") / resolved.name
    _run(RunRequest(scenario=resolved, out=folder, force=force, workers=workers))
    return open_run(folder)


def open_run(folder: str | Path) -> RunResult:
    """A run that was made earlier. Raises `UserError` when the folder holds no scored run, or a damaged one."""
    path = Path(folder)
    return RunResult(folder=path, score=_json(path, "score.json"), manifest=_json(path, "manifest.json"))


def _json(run: Path, name: str) -> Mapping[str, Any]:
    """A JSON file of a run."""
    path = run / name
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{error.filename}: not found; a run has it once it is scored (sboc score {run})") from error
    except ValueError as error:
        raise UserError(f"{path}: damaged: {error}; make it again: sboc score {run}") from error
    if not isinstance(found, dict):
        raise UserError(f"{path}: damaged: holds a {type(found).__name__}, expected a table; make it again: sboc score {run}")
    return found


def compare(
    scenario: str | Path,
    seam: str,
    choices: Sequence[str],
    out: str | Path | None = None,
    *,
    seeds: int = 1,
    set: Mapping[str, Any] | None = None,
    workers: int = 1,
    plugins: Sequence[str] = (),
    force: bool = False,
) -> Comparison:
    """Judge two or more choices of one step on the same frames.

    Parameters
    ----------
    scenario, set, workers, plugins : as for `run`.
    seam : the step to exchange, such as ``"onboard.detector"``.
    choices : names or ``module:Class``.
    out : folder, by default ``runs/compare-<scenario>``. What earlier comparisons left there is used again.
    seeds : how many seeds, from the scenario's on.
    force : run everything again.
    """
    folder = Path(out) if out is not None else Path("runs") / f"compare-{Path(scenario).stem}"
    request = Request(
        scenario=str(scenario),
        seam=seam,
        choices=tuple(choices),
        seeds=seeds,
        overrides=_overrides(set),
        workers=workers,
    )
    return Comparison(folder=folder, result=_compare(request, folder, Registry(trusted_modules=tuple(plugins)), force=force))


def sweep(
    campaign: str | Path,
    out: str | Path | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    replicas: int | None = None,
    workers: int = 1,
    plugins: Sequence[str] = (),
    force: bool = False,
) -> Sweep:
    """Run a campaign over scenario keys: a file, or the name of a shipped one. Finished tasks in `out` are kept.

    `set`, `workers` and `plugins` are those of `run`; `replicas` replaces the campaign's number; `force` begins anew.
    """
    plan = read_campaign(str(campaign)).reduced(replicas, _overrides(set))
    folder = Path(out) if out is not None else Path("runs") / f"sweep-{plan.name}"
    registry = Registry(trusted_modules=tuple(plugins))
    result = run_campaign(plan, folder, workers=workers, registry=registry, force=force, here=workers == 1)
    write_results(plan, result, folder)
    return Sweep(folder=folder, result=json.loads((folder / "campaign.json").read_text(encoding="utf-8")))


def _overrides(changed: Mapping[str, Any] | None) -> tuple[str, ...]:
    """``key=value`` texts as the command line takes them; tables of `changed` key by key."""
    texts: list[str] = []
    for key, value in (changed or {}).items():
        if not isinstance(key, str):
            raise UserError(f"set: expected names of keys such as instrument.rows, got {key!r}"[:300])
        if isinstance(value, Mapping):
            texts += _overrides({f"{key}.{below}": inside for below, inside in value.items()})
            continue
        try:
            texts.append(f"{key}={value_text(_plain(value))}")
        except TypeError as error:
            raise UserError(
                f"set: {key}: expected a number, text, path, true or false, or lists and tables of them, got "
                f"{'None; leave a key out for its default' if value is None else repr(value)} ({error})"[:300]
            ) from error
    return tuple(texts)


def _plain(value: Any) -> Any:
    """A value of numpy or a path as one of Python's own; in lists and tables too."""
    if isinstance(value, os.PathLike):
        return os.fsdecode(value)
    if isinstance(value, np.generic) or type(value) is np.ndarray:  # a subclass may hold a unit, which would be lost
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(below) for key, below in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(below) for below in value]
    return value


def _table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    return Table(rows=[tuple(row) for row in rows], names=list(names), dtype=[str] * len(names))


def _read(folder: Path, name: str) -> Table:
    path = folder / f"{name}.ecsv"
    if not path.is_file():
        known = ", ".join(sorted(found.stem for found in folder.glob("*.ecsv"))) or "none"
        raise UserError(f'{folder}: there is no table "{name}"; known: {known}')
    return Table.read(path, format="ascii.ecsv")
