"""docs/scenario-reference.md from the option models: every key of a scenario with default, unit, range and meaning.

``python -m sboc_e2e.scenario.reference docs/scenario-reference.md`` writes the page; a test holds it to the code.
"""

import argparse
import dataclasses
import inspect
import json
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from ground.options import GroundOptions
from onboard.options import OnboardOptions
from sboc_e2e.registry import SEAMS, Registry, own_names
from sboc_e2e.scenario import quantities
from sboc_e2e.scenario.document import HarnessOptions
from sboc_e2e.scenario.option_models import OptionField, is_options, option_fields
from simulator.options import SimulatorOptions

HEAD: Final = """# Scenario reference

Generated from the code by `python -m sboc_e2e.scenario.reference docs/scenario-reference.md`.

A scenario is one TOML file. This page lists every key with its default. A key that a scenario leaves out has its default.

- A key with a unit takes a text with a number and a unit, such as `exposure = "0.2 s"`. Any unit of the same dimension will do:
  `"200 ms"` is the same. The unit in the table is the one of the default and of the range.
- A key without a unit takes a bare number, `true` or `false`, or a text.
- `--set` on the command line takes the same keys with dots: `--set shutter.exposure="1 s"`.
- A table may name a preset, `preset = "sboc_like"`. The preset's keys lie under the table's own keys.
- `sboc scenarios show NAME` prints a shipped scenario, or your own file, with all of these keys filled in.

[Write your own scenario](own-scenario.md) explains the choices in order, with three worked examples.
"""

KINDS: Final = {bool: "true or false", int: "whole number", float: "number", str: "text"}


def page() -> str:
    """The whole page."""
    parts = [HEAD, "\n## Keys outside of tables\n\n"]
    roots = (*option_fields(HarnessOptions), *option_fields(SimulatorOptions))
    parts.append(_table([field for field in roots if not is_options(field.hint)]))
    for field in roots:
        if is_options(field.hint):
            parts += _section(field.key, field.meaning, field.hint, field.default)
    for segment, options in (("onboard", OnboardOptions), ("ground", GroundOptions)):
        parts += _section(segment, {"onboard": "on-board software", "ground": "ground software"}[segment], options, options())
        parts += _steps(segment)
    return "".join(parts)


def _section(path: str, meaning: str, options: type, default: Any) -> list[str]:
    """A heading and the table of its keys, then the same for the tables and arrays of tables inside."""
    fields = option_fields(options)
    plain = [field for field in fields if not is_options(field.hint)]
    parts = [f"\n{'#' * min(4, 2 + path.count('.'))} `[{path}]`\n\n{_sentence(meaning)}.\n"]
    if plain:
        parts.append("\n" + _table(plain, default))
    for field in fields:
        if is_options(field.hint):
            parts += _section(f"{path}.{field.key}", field.meaning, field.hint, getattr(default, field.name))
        elif (element := _element(field)) is not None:
            parts.append(f"\n#### `[[{path}.{field.key}]]`\n\n{_sentence(field.meaning)}. Each entry is a table:\n\n")
            parts.append(_table(list(_flat(element))))
    return parts


def _flat(options: type, prefix: str = "") -> Iterator[OptionField]:
    """The keys of an entry of an array; those of tables inside it with a dot."""
    for field in option_fields(options):
        if is_options(field.hint):
            yield from _flat(field.hint, f"{prefix}{field.key}.")
        else:
            yield dataclasses.replace(field, key=prefix + field.key)


def _element(field: OptionField) -> type | None:
    """The option class of an array of tables."""
    arms = typing.get_args(field.hint)
    return arms[0] if arms and is_options(arms[0]) else None


def _steps(segment: str) -> list[str]:
    """Tables of the steps of a segment: one for each seam and shipped implementation."""
    registry = Registry()
    parts = []
    for seam in SEAMS.values():
        if not seam.name.startswith(f"{segment}."):
            continue
        summary = inspect.cleandoc(seam.protocol.__doc__ or "").splitlines()[0]
        parts.append(f"\n### `[{seam.name}]`\n\n{_sentence(summary)}\n\n")
        choices = ", ".join(f"`{name}`" for name in own_names(seam.name))
        parts.append(
            f"`use` names the step: {choices}, an installed plug-in, or `module:Class` with `--plugin module`. "
            f'The default is `"{seam.default}"`.\n'
        )
        for name in own_names(seam.name):
            step = registry.resolve(seam.name, name)
            fields = list(option_fields(step))
            parts.append(f'\n#### `use = "{name}"`\n\n' + (_table(fields) if fields else "No further keys.\n"))
    return parts


def _table(fields: list[OptionField], default: Any = None) -> str:
    """The table of some keys; `default` is the instance of their class where that differs from the class's own defaults."""
    rows = ["| key | default | unit | allowed | meaning |", "|---|---|---|---|---|"]
    for field in fields:
        value = field.default if default is None else getattr(default, field.name)
        unit = quantities.display(field.unit) if field.unit else ""
        cells = (_default(dataclasses.replace(field, default=value)), unit, _allowed(field), _cell(field.meaning))
        rows.append(f"| `{field.key}` | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _default(field: OptionField) -> str:
    if field.required:
        return "required"
    value = field.written_default
    if value is None:
        return "not set"
    if _element(field) is not None:
        return "none" if not value else f"{len(value)} {'entry' if len(value) == 1 else 'entries'}"
    return f"`{json.dumps(value)}`"


def _allowed(field: OptionField) -> str:
    if _element(field) is not None:
        return "array of tables"
    if typing.get_origin(field.hint) is tuple:
        return "list" + (f", each {field.limits}" if field.limits else "")
    return field.limits or KINDS.get(field.hint, "")


def _cell(text: str) -> str:
    return text.replace("|", "/")


def _sentence(text: str) -> str:
    """A text with a capital first letter."""
    return text[:1].upper() + text[1:]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.scenario.reference", description="Write the scenario reference.")
    parser.add_argument("page", type=Path, help="the page's file, docs/scenario-reference.md")
    parser.parse_args().page.write_text(page(), encoding="utf-8")
