"""manifest.json: what was run, with which steps and versions, how far it got and how long it took."""

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import sboc_e2e
from sboc_e2e import provenance
from sboc_e2e.files.atomic import write_json
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.version import CONTRACT_VERSION
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import Scenario, from_document

VERSIONED: Final = (
    "numpy",
    "scipy",
    "astropy",
    "astropy-iers-data",
    "astropy-healpix",
    "pyerfa",
    "sgp4",
    "numba",
    "llvmlite",
    "opencv-contrib-python-headless",
    "scikit-image",
    "photutils",
    "sep",
    "tetra3rs",
    "zstandard",
    "imagecodecs",
)


def versions() -> dict[str, str]:
    """Versions that decide the bytes of a run."""
    return dict(_installed())


@cache
def _installed() -> dict[str, str]:
    found = {"sboc-e2e": sboc_e2e.__version__, "contract": CONTRACT_VERSION, "python": platform.python_version()}
    for name in VERSIONED:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


@dataclass(kw_only=True)
class Manifest:
    """The manifest of a run directory; `save` writes it after every change of a stage."""

    path: Path
    scenario: dict[str, Any]
    components: dict[str, dict[str, str]]
    seed: int
    run_id: int
    n_frames: int
    frame_rate_hz: float
    versions: dict[str, str] = field(default_factory=versions)
    commit: str = ""
    """Of the project's checkout that began the run; "none" for an installed package. Each stage has its own in `made_by`."""
    sources: dict[str, Any] = field(default_factory=dict)
    """Digests of the project's sources and of files that the scenario names; plug-ins stand with their components."""
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, path: Path, scenario: Scenario) -> "Manifest":
        """The manifest of a run that has not begun."""
        document = scenario.document()
        components = {
            seam: {"use": component.name, "class": f"{type(component.step).__module__}:{type(component.step).__qualname__}"}
            | (provenance.plugin(type(component.step)) or {})
            for seam, component in scenario.components.items()
        }
        return cls(
            path=path,
            scenario={"name": scenario.name, "document": document},
            components=components,
            seed=scenario.seed,
            run_id=run_id(document),
            n_frames=scenario.simulator.frames,
            frame_rate_hz=scenario.simulator.frame_rate_hz,
            commit=provenance.commit(),
            sources=sources(document),
        )

    @classmethod
    def read(cls, path: Path) -> "Manifest":
        """The manifest of a run directory."""
        try:
            made = cls(path=path, **json.loads(path.read_text(encoding="utf-8")))
            tables = (made.scenario["document"], made.components, made.versions, made.sources, made.stages, *made.stages.values())
            if not (isinstance(made.scenario["name"], str) and all(isinstance(table, dict) for table in tables)):
                raise TypeError("expected tables")
            return made
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise UserError(f"{path}: not a manifest of this program; run again with --force") from error
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {error.strerror or error}") from error

    def save(self) -> None:
        """Write the manifest."""
        write_json(self.path, {name: value for name, value in vars(self).items() if name != "path"})

    def resolve(self, registry: Registry) -> Scenario:
        """The scenario of the run, as resolved when it began."""
        return from_document(self.scenario["document"], name=self.scenario["name"], registry=registry, where=str(self.path))

    def done(self, stage: str) -> bool:
        """Whether a stage has finished."""
        return self.stages.get(stage, {}).get("state") == "done"

    def difference(self, other: "Manifest") -> str | None:
        """The first thing that decides the bytes of a run in which another manifest is not the same, in words."""
        for name in ("scenario", "versions", "components", "sources"):
            found = first_difference(getattr(self, name), getattr(other, name))
            if found:
                return found
        for stage, record in self.stages.items():
            if "made_by" in record:
                found = first_difference(decisive(record["made_by"]), decisive(other.made_by(stage)), f"stages.{stage}")
                if found:
                    return found
        return None

    def made_by(self, stage: str) -> dict[str, Any]:
        """What decides the bytes of a stage that the program makes now, and its commit; for a manifest made by `of`."""
        reached = {"simulate": (), "onboard": ("onboard",)}.get(stage, ("onboard", "ground"))
        return {
            "commit": self.commit,
            "code": provenance.code_digest("score" if stage == "report" else stage),
            "versions": self.versions,
            "plugins": {
                seam: component
                for seam, component in self.components.items()
                if "source_sha256" in component and seam.partition(".")[0] in reached
            },
            "files": self.sources["files"],
        }

    def begin(self, stage: str, **figures: Any) -> None:
        """Note that a stage runs, on what and by what; time of an interrupted attempt is kept and added to."""
        self.stages.setdefault(stage, {}).update(figures, state="running")
        self.save()

    def finish(self, stage: str, **figures: float | str) -> None:
        """Note that a stage is done, with its figures."""
        self.stages.setdefault(stage, {}).update(figures, state="done")
        self.save()

    def forget(self, stages: tuple[str, ...]) -> None:
        """Stages that have to run again."""
        for stage in stages:
            self.stages.pop(stage, None)


def decisive(made_by: Mapping[str, Any]) -> dict[str, Any]:
    """What of `Manifest.made_by` decides bytes: not the commit, which edits of documents change."""
    return {name: value for name, value in made_by.items() if name != "commit"}


def sources(document: Mapping[str, Any]) -> dict[str, Any]:
    """Digests of everything that determines a run's bytes besides the text of its scenario and its plug-ins."""
    return {"code": provenance.code_digest("ground"), "files": provenance.named_files(document)}


def run_id(document: Mapping[str, Any]) -> int:
    """32-bit number of a run, the same for the same scenario and seed."""
    text = json.dumps(document, sort_keys=True)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def first_difference(one: Any, other: Any, path: str = "") -> str | None:
    """The first key in which two documents differ, in words; None when they are the same."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in sorted(set(one) | set(other)):
            where = f"{path}.{key}" if path else str(key)
            if key not in one or key not in other:
                return f"{where} is {'new' if key not in one else 'gone'}"
            difference = first_difference(one[key], other[key], where)
            if difference:
                return difference
        return None
    return None if one == other else f"{path} was {one!r} and is {other!r}"[:200]
