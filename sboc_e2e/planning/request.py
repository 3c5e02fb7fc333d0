"""The file of a plan."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ground.planning.fence import FenceOptions
from ground.planning.options import PlanOptions
from sboc_e2e.icd.errors import UserError
from sboc_e2e.scenario import option_models, toml_files

GOALS = ("orbits", "fence")


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """What a plan is for.

    The scenario gives camera, orbit or site, and frame rate; its pointing, objects and light are not used.
    """

    description: str = field(default="", metadata={"doc": "what the plan is for, in a sentence"})
    scenario: str = field(default="", metadata={"doc": "name or path of the scenario that gives instrument and platform"})
    goal: str = field(
        default="orbits", metadata={"doc": "knowledge of the orbits of `objects`, or a fence across the ring", "choices": GOALS}
    )
    objects: str = field(default="", metadata={"doc": "file of two- or three-line element sets, relative to the plan's file"})
    names: tuple[str, ...] = field(default=(), metadata={"doc": "only objects of these names or numbers; empty for all"})
    least_mean_motion: float = field(default=0.0, metadata={"doc": "of the objects, revolutions a day", "min": 0.0, "max": 20.0})
    most_mean_motion: float = field(default=20.0, metadata={"doc": "of the objects, revolutions a day", "min": 0.0, "max": 20.0})
    weather: str = field(
        default="",
        metadata={"doc": "file of the times at which a site is closed, `start_utc` and `end_utc`, relative to the plan's file"},
    )
    start_utc: str = field(default="", metadata={"doc": "start of the plan; default is the scenario's epoch"})
    flown: int = field(
        default=3, metadata={"doc": "visits that the scenario beside the schedule lets the chain fly", "min": 1, "max": 1000}
    )
    plan: PlanOptions = field(default_factory=PlanOptions, metadata={"doc": "horizon, visits, constraints"})
    fence: FenceOptions = field(default_factory=FenceOptions, metadata={"doc": "the strip of a fence"})


def shipped() -> dict[str, Path]:
    """Plans that come with the project, by name."""
    return {path.stem: path for path in sorted((toml_files.FOLDER / "plans").glob("*.toml"))}


def read_request(name: str, overrides: Iterable[str] = ()) -> tuple[PlanRequest, Path]:
    """A plan by name or path, with its file. UserError of one line for anything wrong."""
    path = shipped().get(name, Path(name))
    if not path.is_file():
        raise UserError(f"{path}: no such plan; give the path of a .toml file or one of: {', '.join(shipped())}")
    document: dict[str, Any] = toml_files.read(path)
    for text in overrides:
        document = toml_files.with_override(document, text)
    model = option_models.validate(option_models.model_of(PlanRequest), document, str(path))
    request: PlanRequest = option_models.build(PlanRequest, model, str(path))
    if not request.scenario:
        raise UserError(f'{path}: scenario: expected a name such as "geo_survey"')
    if request.goal == "orbits" and not request.objects:
        raise UserError(f"{path}: objects: the goal `orbits` needs a file of element sets")
    if request.least_mean_motion > request.most_mean_motion:
        raise UserError(
            f"{path}: least_mean_motion: {request.least_mean_motion:g} is above most_mean_motion, {request.most_mean_motion:g}"
        )
    return request, path
