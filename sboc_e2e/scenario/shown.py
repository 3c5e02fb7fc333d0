"""A resolved scenario as a commented TOML text: every key with its value, where the value is from, and what the key means.

The text is a scenario file itself: read again, it gives the same run.
"""

import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ground.options import GroundOptions
from onboard.options import OnboardOptions
from sboc_e2e.registry import SEAMS
from sboc_e2e.scenario.document import HarnessOptions, Scenario
from sboc_e2e.scenario.option_models import OptionField, is_options, option_fields
from sboc_e2e.scenario.origin import Layer, source
from sboc_e2e.scenario.toml_files import value_text
from simulator.options import SimulatorOptions


def text(scenario: Scenario) -> str:
    """The commented file."""
    layers = scenario.layers
    document = scenario.document()
    head = f"# {scenario.name}: every key with its value. A comment says what the key means, then where its value is from."
    lines = [head, "# Keys without a source have their default.", ""]
    roots = (*option_fields(HarnessOptions), *option_fields(SimulatorOptions))
    lines += _keys([field for field in roots if not is_options(field.hint)], document, (), layers)
    for field in roots:
        if is_options(field.hint):
            lines += _table(field.hint, document[field.key], (field.key,), field.meaning, layers)
    for segment, options in (("onboard", OnboardOptions), ("ground", GroundOptions)):
        lines += _table(options, document[segment], (segment,), f"{segment} segment", layers)
        for seam in SEAMS.values():
            name, _, key = seam.name.partition(".")
            if name == segment:
                lines += _step(scenario, seam.name, document[segment][key], (segment, key), layers)
    return "\n".join(lines) + "\n"


def _table(options: type, values: Mapping[str, Any], path: tuple[str, ...], meaning: str, layers: Sequence[Layer]) -> list[str]:
    """A table with its keys, then the tables inside it."""
    fields = option_fields(options)
    lines = _keys([field for field in fields if not is_options(field.hint)], values, path, layers)
    if lines:
        lines = ["", f"[{'.'.join(path)}]  # {meaning}", *lines]
    for field in fields:
        if is_options(field.hint) and field.key in values:
            lines += _table(field.hint, values[field.key], (*path, field.key), field.meaning, layers)
    return lines


def _step(scenario: Scenario, seam: str, values: Mapping[str, Any], path: tuple[str, ...], layers: Sequence[Layer]) -> list[str]:
    """The table of a seam: the step's name and its options."""
    given_by = source((*path, "use"), layers)
    kind: Any = type(scenario.step(seam))
    lines = ["", f"[{seam}]", f"use = {value_text(values['use'])}{f'  # from {given_by}' if given_by else ''}"]
    return lines + _keys(option_fields(kind), values, path, layers)


def _keys(fields: Sequence[OptionField], values: Mapping[str, Any], path: tuple[str, ...], layers: Sequence[Layer]) -> list[str]:
    """One line for each key."""
    lines = []
    for field in fields:
        given_by = source((*path, field.key), layers)
        comment = f"# {field.doc}{f'; from {given_by}' if given_by else ''}"
        if field.key not in values:
            lines.append(f"# {field.key} = (not set)  {comment}")
            continue
        written = f"{field.key} = {value_text(values[field.key])}"
        if isinstance(values[field.key], list) and _of_tables(field):
            lines.append(comment)
            lines += _entries(field.key, values[field.key])
        else:
            lines.append(f"{written}  {comment}")
    return lines


def _of_tables(field: OptionField) -> bool:
    arms = typing.get_args(field.hint)
    return bool(arms) and is_options(arms[0])


def _entries(key: str, entries: Sequence[Any]) -> Iterator[str]:
    """An array of tables, an entry in a line."""
    if not entries:
        yield f"{key} = []"
        return
    yield f"{key} = ["
    yield from (f"  {value_text(entry)}," for entry in entries)
    yield "]"
