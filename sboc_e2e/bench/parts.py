"""Parts of the benchmark report: whole runs and benchmarks of single steps, with the cost of each."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
SCRIPTS: Final = ROOT / "tests" / "benchmarks"
STORED: Final = ROOT / "bench" if SCRIPTS.is_dir() else Path(__file__).resolve().parent / "stored"
"""Baselines: of the checkout, or those that were current when the installed package was built."""
COSTS: Final = STORED / "costs.json"
"""Wall seconds of each part where the baseline was written."""

IDEAL: Final = ("sso_antisun", "--set", "psf.preset=ideal")
"""The camera whose figures are the measure against the physical limit."""

RUNS: Final = {"smoke": ("smoke",), "sso_antisun": ("sso_antisun",), "sso_antisun_ideal": IDEAL}
QUICK_RUNS: Final = {"smoke": ("smoke",), "sso_antisun_8_frames": ("sso_antisun", "--set", "frames=8")}

SIDE_BY_SIDE: Final = ("astrometry", "detection", "linking", "orbit", "streak_fit", "trailed_stars", "vetting")
"""Monte-Carlo benches whose figures are accuracies and CPU seconds: they may share the machine, one for each processor."""

FULL_ONLY: Final = ("scenarios", "tracks")
"""Parts without a quick form: whole scenarios and cubes of frames take minutes each."""

LONG: Final = ("soak",)
"""Parts whose full form lasts hours; they run in their quick form unless they are asked for by name."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """One part of the report; `scenario` holds the arguments of `sboc run` for a whole run, else it is a bench module."""

    name: str
    scenario: tuple[str, ...] = ()
    quick: bool = True

    @property
    def alone(self) -> bool:
        """Whether it needs the machine for itself."""
        return self.name not in SIDE_BY_SIDE


def parts(*, quick: bool, peers: bool, long: bool = False, only: tuple[str, ...] = ()) -> list[Part]:
    """All parts in order. only : names of those wanted, empty for all. long : full form of the parts that last hours.

    An installed package has the whole runs only. The benchmarks of single steps exist in a checkout.
    """
    out = [Part(name=name, scenario=arguments, quick=quick) for name, arguments in (QUICK_RUNS if quick else RUNS).items()]
    for script in sorted(SCRIPTS.glob("bench_*.py")):
        name = script.stem.removeprefix("bench_")
        if quick and name in FULL_ONLY:
            continue
        if peers or not name.startswith("peers_"):
            out.append(Part(name=name, quick=quick or (name in LONG and not long)))
    return [part for part in out if not only or part.name in only]


def expected_costs(wanted: list[Part], *, quick: bool) -> dict[str, float | None]:
    """Wall seconds that each part took when the baseline was written; None for one that had not been there."""
    stored = json.loads(COSTS.read_text()) if COSTS.is_file() else {}
    known = stored.get("quick" if quick else "full", {})
    return {part.name: known.get(part.name) for part in wanted}


def cost_words(costs: Mapping[str, float | None], wanted: list[Part], processors: int) -> str:
    """Expected cost of a benchmark, stated before it starts."""
    alone = sum(costs[part.name] or 0.0 for part in wanted if part.alone)
    shared = sum(costs[part.name] or 0.0 for part in wanted if not part.alone) / max(processors, 1)
    unknown = [name for name, cost in costs.items() if cost is None]
    words = f"{len(wanted)} parts, about {(alone + shared) / 60:.0f} minutes on {processors} processors as fast as the baseline's"
    return words + (f"; not timed yet: {', '.join(unknown)}" if unknown else "")
