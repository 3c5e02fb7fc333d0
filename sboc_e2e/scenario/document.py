"""The resolved scenario: options of the three segments, the chosen steps, what to keep, and back to a document."""

import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, create_model

from ground.options import GroundOptions
from onboard.options import OnboardOptions
from sboc_e2e.faults.options import FaultOptions
from sboc_e2e.icd.errors import UserError
from sboc_e2e.provenance import FILE_KEYS
from sboc_e2e.registry import SEAMS, Registry
from sboc_e2e.scenario import option_models, origin, toml_files
from simulator.options import SimulatorOptions


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """What a run keeps on disk."""

    keep_frames_every: int = field(
        default=0, metadata={"doc": "frames/ keeps every n-th frame as FITS; 1 keeps all, 0 none", "min": 0, "max": 1_000_000}
    )


@dataclass(frozen=True, kw_only=True)
class HarnessOptions:
    """Keys of a scenario that belong to no segment."""

    description: str = field(default="", metadata={"doc": "what the scenario shows, in a sentence"})
    seed: int = field(default=1, metadata={"doc": "seed of every random stream", "min": 0, "max": 2**63 - 1})
    output: OutputOptions = field(default_factory=OutputOptions, metadata={"doc": "what is kept on disk"})
    faults: FaultOptions = field(default_factory=FaultOptions, metadata={"doc": "faults to inject between the segments"})


@dataclass(frozen=True, kw_only=True)
class Component:
    """A chosen step: where it sits, the name it was asked for by, and the configured step itself."""

    seam: str
    name: str
    step: Any


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Everything that determines the bytes of a run."""

    name: str
    description: str
    seed: int
    simulator: SimulatorOptions
    onboard: OnboardOptions
    ground: GroundOptions
    output: OutputOptions
    faults: FaultOptions
    components: Mapping[str, Component]
    layers: tuple[origin.Layer, ...] = field(default=(), compare=False, repr=False)
    """Origin of the values: presets, file and command line. Empty for a scenario made from tables."""

    def told(self, message: str) -> str:
        """The message of a refusal, with the source of the key that it names where the user did not write it."""
        return origin.told(message, self.layers, default_texts()) if self.layers else message

    def step(self, seam: str) -> Any:
        """The configured step of a seam."""
        return self.components[seam].step

    def document(self) -> dict[str, Any]:
        """TOML-shaped tables with every option, defaults included; `from_document` gives the same scenario back."""
        tables: dict[str, Any] = {"description": self.description, "seed": self.seed}
        tables |= option_models.to_document(self.simulator)
        tables["onboard"] = option_models.to_document(self.onboard)
        tables["ground"] = option_models.to_document(self.ground)
        for seam, component in self.components.items():
            segment, _, key = seam.partition(".")
            tables[segment][key] = {"use": component.name, **option_models.to_document(component.step)}
        tables["output"] = option_models.to_document(self.output)
        tables["faults"] = option_models.to_document(self.faults)
        return tables


MAX_LABEL: Final = 120
"""Largest number of typed characters that an error repeats."""

SEGMENT_OPTIONS: Final[dict[str, type]] = {"onboard": OnboardOptions, "ground": GroundOptions}
SEGMENT_SEAMS: Final = {
    segment: tuple(seam.partition(".")[2] for seam in SEAMS if seam.startswith(f"{segment}.")) for segment in SEGMENT_OPTIONS
}
"""Keys of component tables by segment; they are read before the model of the segment's options."""

PRESET_TABLES: Final = tuple(
    field.key
    for options in (HarnessOptions, SimulatorOptions)
    for field in option_models.option_fields(options)
    if option_models.is_options(field.hint)
)
"""Tables that a preset may lie under; their key `preset` is read before the model of their options."""


@cache
def scenario_model() -> type[BaseModel]:
    """Pydantic model of a whole scenario file without its component tables."""
    segments: dict[str, Any] = {
        f"option_{name}": (
            option_models.model_of(options),
            Field(default=None, alias=name, description=f"{name} segment", json_schema_extra=option_models.without_null),
        )
        for name, options in SEGMENT_OPTIONS.items()
    }
    return create_model(
        "Scenario",
        __config__=ConfigDict(extra="forbid", protected_namespaces=(), frozen=True),
        __doc__="A run of the SBOC end-to-end demonstrator.",
        **option_models.model_fields(HarnessOptions),
        **option_models.model_fields(SimulatorOptions),
        **segments,
    )


def available() -> dict[str, str]:
    """Scenarios that come with the project, recreated real frames last: name and description."""
    paths = [path for pattern in ("*.toml", "validation/*.toml") for path in sorted(toml_files.FOLDER.glob(pattern))]
    return {
        path.relative_to(toml_files.FOLDER).with_suffix("").as_posix(): str(toml_files.read(path).get("description", ""))
        for path in paths
    }


def find(scenario: str) -> Path:
    """File of a scenario given by name or path."""
    path = Path(scenario)
    if scenario in available():
        return toml_files.FOLDER / f"{scenario}.toml"
    if path.suffix != ".toml" and len(path.parts) == 1:
        raise UserError(f'there is no scenario "{scenario[:80]}"; {option_models.did_you_mean(scenario, available())}')
    if not path.is_file():
        raise UserError(f"{path}: no such scenario file; give a path to a .toml file or one of: {', '.join(available())}")
    return path


def load(
    scenario: str,
    *,
    registry: Registry,
    overrides: Iterable[str] = (),
    use: Mapping[str, str] | None = None,
    seed: int | None = None,
) -> Scenario:
    """The resolved scenario of a name or path.

    overrides : ``key=value`` texts of ``--set``; one that names a preset takes the place of that of the file. use : step names
    typed on the command line by seam; they replace the scenario's choice together with its options. Raises `UserError` of one
    line for anything wrong.
    """
    path = find(scenario)
    overrides = tuple(overrides)
    presets = tuple(text for text in overrides if toml_files.names_preset(text))
    document = tables(path, presets)
    layers = origin.layers_of(path, overrides, use or {})
    overrides = tuple(text for text in overrides if text not in presets)
    try:
        resolved = _resolved(document, path.stem, str(path), registry, overrides, use or {}, seed)
    except UserError as error:
        raise UserError(origin.told(str(error), layers, default_texts())) from error
    return dataclasses.replace(resolved, layers=tuple(layers))


@cache
def default_texts() -> dict[str, str]:
    """Dotted names of all keys of the segments and the harness, with their defaults as a scenario would write them."""
    found: dict[str, str] = {}

    def walk(options: type, prefix: str) -> None:
        for item in option_models.option_fields(options):
            if option_models.is_options(item.hint):
                walk(item.hint, f"{prefix}{item.key}.")
            else:
                found[prefix + item.key] = "not set" if item.default is None else str(item.written_default)

    for options, prefix in ((HarnessOptions, ""), (SimulatorOptions, ""), *((o, f"{s}.") for s, o in SEGMENT_OPTIONS.items())):
        walk(options, prefix)
    return found


def tables(path: Path, presets: Iterable[str] = ()) -> dict[str, Any]:
    """The tables of a scenario file with its presets; files that lie beside it by their full path.

    A relative path of `FILE_KEYS` is looked for beside the scenario, then in the working folder.
    presets : texts of ``--set`` that choose presets as if the file did.
    """
    given = toml_files.read(path)
    if not given:
        # All defaults would be a run of hours that nobody asked for.
        raise UserError(f"{path}: holds no key; a scenario says at least one thing, such as frames = 6")
    for text in presets:
        given = toml_files.with_override(given, text)
    typed = {text.partition(".")[0].strip(): f"--set {text}"[:MAX_LABEL] for text in presets}
    merged = toml_files.with_presets(given, path.resolve().parent, str(path), typed)
    for *parents, key in FILE_KEYS:
        table: Any = merged
        for parent in parents:
            table = table.get(parent) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(name := table.get(key), str) and os.path.isfile(path.parent / name):  # noqa: PTH113
            # unlike Path.is_file it takes a text that is too long for a path as what it is: no file
            table[key] = str(path.parent / name)
    return merged


def bare(
    name: str,
    document: Mapping[str, Any],
    *,
    registry: Registry,
    overrides: Iterable[str] = (),
    use: Mapping[str, str] | None = None,
) -> Scenario:
    """A scenario without a file: the given tables over the defaults, then overrides and typed steps.

    Options that the tables give a step are those of its default. They are gone where ``--set SEAM.use=`` chooses another, as
    with ``--use``: the user did not write them. Raises `UserError` of one line for anything wrong, such as an override that
    names a preset: it would have to lie under the keys of a file.
    """
    overrides = tuple(overrides)
    for text in overrides:
        if toml_files.names_preset(text):
            table = text.partition(".")[0].strip()
            raise UserError(
                f"--set {text[:MAX_LABEL]}: a preset is not taken here, only in a scenario file and where a command takes one; "
                f"allowed are the keys of [{table}] themselves"
            )
    tables = dict(document)
    chosen = {text.partition("=")[0].strip() for text in overrides}
    for seam in SEAMS:
        segment, _, key = seam.partition(".")
        if f"{seam}.use" in chosen and key in tables.get(segment, {}):
            tables[segment] = {each: value for each, value in tables[segment].items() if each != key}
    return _resolved(tables, name, name, registry, overrides, use or {}, None)


def _resolved(
    document: dict[str, Any],
    name: str,
    where: str,
    registry: Registry,
    overrides: Iterable[str],
    use: Mapping[str, str],
    seed: int | None,
) -> Scenario:
    """The scenario of a document after what was typed on the command line; a refusal names what was typed, or the file."""
    layers: list[tuple[str, Callable[[dict[str, Any]], dict[str, Any]]]] = [
        *((f"--use {seam}={step}", partial(_with_step, seam=seam, step=step)) for seam, step in use.items()),
        *((f"--set {text}", partial(toml_files.with_override, text=text)) for text in overrides),
    ]
    if seed is not None:
        layers.append((f"--seed {seed}", lambda tables: {**tables, "seed": seed}))
    stages = [(where, document)]
    for label, changed in layers:
        stages.append((label[:MAX_LABEL], changed(stages[-1][1])))
    resolve = partial(from_document, name=name, registry=registry, typed=frozenset(use.values()))
    try:
        return resolve(stages[-1][1], where=where)
    except UserError:
        # The error names the first override that is invalid; if the file alone is invalid, it names the file.
        for label, tables in stages:
            resolve(tables, where=label)
        raise


def _with_step(document: Mapping[str, Any], *, seam: str, step: str) -> dict[str, Any]:
    """The document with the step of a seam that was typed; the scenario's choice and its options are gone."""
    segment, _, key = seam.partition(".")
    table = document.get(segment, {})
    return {**document, segment: {**table, key: {"use": step}} if isinstance(table, Mapping) else table}


def from_document(
    document: Mapping[str, Any], *, name: str, registry: Registry, where: str, typed: frozenset[str] = frozenset()
) -> Scenario:
    """The resolved scenario of TOML-shaped tables; `typed` holds the step names that the user typed."""
    tables = {
        key: dict(value) if key in SEGMENT_OPTIONS and isinstance(value, Mapping) else value for key, value in document.items()
    }
    components = {seam: _component(seam, _taken(tables, seam, where), registry, where, typed) for seam in SEAMS}
    model: Any = option_models.validate(
        scenario_model(), tables, where, also=dict.fromkeys(PRESET_TABLES, ("preset",)) | SEGMENT_SEAMS
    )
    harness: HarnessOptions = option_models.build(HarnessOptions, model, where)
    segments = {
        segment: option_models.build(options, given, f"{where}: {segment}")
        if (given := getattr(model, f"option_{segment}")) is not None
        else options()
        for segment, options in SEGMENT_OPTIONS.items()
    }
    return Scenario(
        name=name,
        description=harness.description,
        seed=harness.seed,
        simulator=option_models.build(SimulatorOptions, model, where),
        onboard=segments["onboard"],
        ground=segments["ground"],
        output=harness.output,
        faults=harness.faults,
        components=components,
    )


def _taken(tables: dict[str, Any], seam: str, where: str) -> dict[str, Any]:
    """The component table of a seam, removed from the document."""
    segment, _, key = seam.partition(".")
    parent = tables.get(segment)
    if not isinstance(parent, dict) or key not in parent:
        return {}
    table = parent.pop(key)
    if not isinstance(table, dict):
        raise UserError(f'{where}: {seam}: expected a table such as [{seam}] with use = "{SEAMS[seam].default}"')
    return dict(table)


def _component(seam: str, table: dict[str, Any], registry: Registry, where: str, typed: frozenset[str]) -> Component:
    """The configured step of a component table; the default step when the table names none."""
    name = table.pop("use", SEAMS[seam].default)
    if not isinstance(name, str):
        raise UserError(f"{where}: {seam}.use: expected the name of a step, got {name!r}"[:300])
    try:
        options = registry.resolve(seam, name, typed=name in typed)
    except UserError as error:
        raise UserError(f"{where}: {error}") from error
    model = option_models.validate(option_models.model_of(options), table, f'{where}: [{seam}] use = "{name}"')
    return Component(seam=seam, name=name, step=option_models.build(options, model, f"{where}: [{seam}]"))
