"""Origin of the value of a key: the scenario's file, a preset, the command line, or the default."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from sboc_e2e.scenario import toml_files

Layer = tuple[str, Mapping[str, Any]]
"""Name of an origin in words, and the tables that it sets."""

_KEY: Final = re.compile(r"(?<![\w./\[])[a-z][a-z0-9_]*(?:\.[a-z][a-z0-9_]*)+(?![\w/.])")


def layers_of(path: Path, overrides: Sequence[str], use: Mapping[str, str]) -> list[Layer]:
    """Presets, the file and what was typed, in the order in which later ones win."""
    own = toml_files.read(path)
    presets = [text for text in overrides if toml_files.names_preset(text)]
    for text in presets:
        own = toml_files.with_override(own, text)
    layers: list[Layer] = []
    for name, table in own.items():
        if isinstance(table, dict) and "preset" in table:
            preset = toml_files.preset_path(table["preset"], name, path.resolve().parent, f"{path}: {name}.preset")
            layers.append((f"preset {preset.stem}", toml_files.read(preset)))
    layers.append((path.name, own))
    for seam, step in use.items():
        segment, _, key = seam.partition(".")
        # the options that a preset or the file gives the step are gone with it
        layers = [(label, _without(tables, segment, key)) for label, tables in layers]
        layers.append(("--use", {segment: {key: {"use": step}}}))
    layers += [("--set", toml_files.with_override({}, override)) for override in overrides if override not in presets]
    return layers


def _without(tables: Mapping[str, Any], segment: str, key: str) -> Mapping[str, Any]:
    """The tables without the one of a step."""
    table = tables.get(segment)
    if not isinstance(table, Mapping) or key not in table:
        return tables
    return {**tables, segment: {each: value for each, value in table.items() if each != key}}


def source(path: tuple[str, ...], layers: Sequence[Layer]) -> str:
    """The last layer that gives a key; '' where none does."""
    for label, tables in reversed(layers):
        value: Any = tables
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        if value is not None:
            return label
    return ""


def told(message: str, layers: Sequence[Layer], defaults: Mapping[str, Any]) -> str:
    """The message of a refusal, and where the first key that it names is from, unless the user wrote it.

    defaults : dotted names of all keys, with their defaults. Several keys may contradict each other; the one that a check
    names need not be the one that was written.
    """
    for name in _KEY.findall(message):
        if name not in defaults:
            continue
        given_by = source(tuple(name.split(".")), layers)
        if not given_by:
            return f"{message} ({name} is not in the scenario; its default is {defaults[name]})"
        return f"{message} ({name} is from {given_by})" if given_by.startswith("preset") else message
    return message
