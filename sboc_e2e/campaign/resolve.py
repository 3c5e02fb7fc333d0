"""From tasks to scenarios: what each task resolves to, a fingerprint of all that decides its result, and what tasks share."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from sboc_e2e import provenance, scenario
from sboc_e2e.campaign.plan import Campaign, Task
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.run.decoders import require_decoder
from sboc_e2e.run.manifest import versions
from sboc_e2e.run.shared import key, stage_content
from sboc_e2e.scenario import Scenario
from sboc_e2e.scenario.toml_files import value_text

SURROUNDINGS: Final = ("versions", "code", "plugins", "files")
"""What decides a result beside the scenario."""


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """A task with its resolved scenario. fingerprint : digest of everything that determines its shard. frames, downlink :
    digests of everything that determines the frames and the downlink."""

    task: Task
    fingerprint: str
    frames: str
    downlink: str


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """All tasks of a campaign: those whose scenario stands, and those whose point it refuses, with the reason.

    outside : records of the "plugins" by class and digests of the "files" that the points name.
    """

    standing: list[Resolved]
    refused: list[tuple[Task, str]]
    outside: dict[str, dict[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A campaign with the tables of its scenario: all that a worker needs, wherever it runs.

    trusted_modules : those that the user trusts to be imported (``--plugin``).
    """

    campaign: Campaign
    tables: Mapping[str, Any]
    trusted_modules: tuple[str, ...] = ()

    @classmethod
    def of(cls, campaign: Campaign, registry: Registry) -> "Plan":
        """The plan of a campaign; reads the scenario file."""
        return cls(
            campaign=campaign, tables=scenario.tables(scenario.find(campaign.scenario)), trusted_modules=registry.trusted_modules
        )

    def identity(self) -> dict[str, Any]:
        """What is the same for all tasks: results of two campaigns that differ here do not belong together."""
        campaign = self.campaign
        return {
            "scenario": dict(self.tables) | {"description": ""},
            "set": campaign.constant,
            "seed": campaign.seed,
            "paired": campaign.paired,
            "code": provenance.code_digest("score"),
            "versions": versions(),
        }

    def scenario_of(self, point: tuple[tuple[str, Any], ...], seed: int) -> Scenario:
        """The scenario of a point. Raises `UserError` that names the campaign's key."""
        campaign = self.campaign
        registry = Registry(trusted_modules=self.trusted_modules)
        texts = overrides(campaign, point)
        try:
            found = scenario.bare(campaign.scenario, self.tables, registry=registry, overrides=texts)
        except UserError as error:
            raise UserError(f"campaign {campaign.name}: {str(error).removeprefix('--set ')}") from error
        return dataclasses.replace(found, seed=seed)

    def resolved(self, task: Task, found: Scenario) -> Resolved:
        """The task with the fingerprints of its scenario."""
        content = stage_content(found, "ground")
        whole = {
            "run": content,
            "code": provenance.code_digest("score"),
            "point": json.dumps(dict(task.point)),
            "replica": task.replica,
        }
        frames, downlink = (key(stage_content(found, stage)) for stage in ("simulate", "onboard"))
        return Resolved(task=task, fingerprint=key(whole), frames=frames, downlink=downlink)

    def surroundings(self, task: Task) -> dict[str, Any]:
        """Everything besides the scenario that determines the result of a task on this machine."""
        content = stage_content(self.scenario_of(task.point, task.seed), "ground")
        return {name: content[name] for name in SURROUNDINGS} | {"code": provenance.code_digest("score")}

    def resolve(self) -> Resolution:
        """Every task with its scenario or the reason why there is none.

        Raises `UserError` when it refuses every point: then a key is wrong, or a value that all share.
        """
        standing: list[Resolved] = []
        refused: list[tuple[Task, str]] = []
        reasons: dict[tuple[tuple[str, Any], ...], str] = {}
        scenarios: dict[tuple[tuple[str, Any], ...], Scenario] = {}
        outside: dict[str, dict[str, Any]] = {"plugins": {}, "files": {}}
        for task in self.campaign.tasks():
            if task.replica == 0:
                # The replicas of a point follow each other, so one scenario at a time is kept.
                scenarios.clear()
                try:
                    found = scenarios[task.point] = self.scenario_of(task.point, task.seed)
                    require_decoder(found)
                    for component in found.components.values():
                        if record := provenance.plugin(type(component.step)):
                            outside["plugins"][type(component.step).__module__ + ":" + type(component.step).__qualname__] = record
                    outside["files"] |= provenance.named_files(found.document())
                except UserError as error:
                    reasons[task.point] = str(error)
            if task.point in reasons:
                refused.append((task, reasons[task.point]))
            else:
                standing.append(self.resolved(task, dataclasses.replace(scenarios[task.point], seed=task.seed)))
        if not standing:
            raise UserError(refused[0][1])
        return Resolution(standing=standing, refused=refused, outside=outside)


def overrides(campaign: Campaign, point: tuple[tuple[str, Any], ...]) -> list[str]:
    """The ``key=value`` texts that turn the campaign's scenario into a point's."""
    values = campaign.constant | dict(point)
    return [f"{key}={value if isinstance(value, str) else value_text(value)}" for key, value in values.items()]
