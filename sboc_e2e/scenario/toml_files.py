"""Reading scenario files: size limits, presets, overrides; plain tables in and out, no meaning."""

import contextlib
import copy
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from sboc_e2e.icd.errors import UserError

FOLDER: Final = Path(__file__).resolve().parents[2] / "scenarios"
"""Scenarios and presets that come with the project."""

MAX_FILE_BYTES: Final = 1 << 20  # 1 MiB; the largest shipped scenario has 2.3 kB. Keeps a wrong path from filling the memory.
MAX_DEPTH: Final = 16  # Shipped files nest five deep; what walks tables by recursion stays far from Python's limit of 1,000.
_UNQUOTED: Final = re.compile(r"([A-Za-z0-9_.-]{1,60})\s*=\s*([A-Za-z0-9+.-][^\"'#\[\]{}=,]{0,60}?)\s*(?:#.*)?")
"""A key with a bare value of letters and digits, such as ``ra = 150 deg``."""
_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")
_PRESET_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def read(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; `UserError` for files that are missing, too large or not TOML."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{path}: larger than {MAX_FILE_BYTES} bytes; a scenario is a small text file")
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not a text file in UTF-8") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from error
    return parse(text, str(path))


def parse(text: str, where: str) -> dict[str, Any]:
    """The tables of a TOML text; `UserError` of one line otherwise."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{where}: not valid TOML: {error}{_line_words(str(error), text)}") from error
    except (RecursionError, ValueError) as error:
        raise UserError(f"{where}: not valid TOML: {type(error).__name__}") from error
    _refuse_deep(document, where)
    return document


def _line_words(complaint: str, text: str) -> str:
    """The line that a complaint names, and quotes where they alone are missing; '' where it names no line."""
    named = re.search(r"at line (\d+)", complaint)
    lines = text.splitlines()
    if named is None or not 0 < int(named.group(1)) <= len(lines):
        return ""
    line = lines[int(named.group(1)) - 1].strip()
    unquoted = _UNQUOTED.fullmatch(line)
    if unquoted is None or not re.search("[A-Za-z]", unquoted.group(2)):
        return f": {line[:80]}"
    key, value = unquoted.groups()
    return f': {line[:80]}; texts and quantities with a unit are written in quotes: {key} = "{value}"'


def _refuse_deep(document: dict[str, Any], where: str) -> None:
    """Refuse nesting that no scenario has and that later recursive steps could not walk."""
    tables: list[Any] = [document]
    for _ in range(MAX_DEPTH):
        below = [item.values() if isinstance(item, dict) else item for item in tables if isinstance(item, dict | list)]
        tables = [value for values in below for value in values]
        if not tables:
            return
    raise UserError(f"{where}: tables are nested more than {MAX_DEPTH} deep")


def with_presets(
    document: Mapping[str, Any], origin: Path, where: str, typed: Mapping[str, str] = MappingProxyType({})
) -> dict[str, Any]:
    """The document over the fragments that its tables name with ``preset = "..."``; the document's own keys win.

    typed : what the user typed to choose a table's preset, by table; a refusal names it instead of the file.
    """
    own = copy.deepcopy(dict(document))
    result: dict[str, Any] = {}
    if isinstance(own.get("preset"), str):
        raise UserError(f"{where}: preset: stands outside of a table; a preset is named inside one, such as [instrument]")
    for table_name, table in own.items():
        if isinstance(table, dict) and "preset" in table:
            place = typed.get(table_name, f"{where}: {table_name}.preset")
            path = preset_path(table.pop("preset"), table_name, origin, place)
            preset = read(path)
            meant = _table_of(preset)
            if meant != table_name:
                known = ", ".join(_presets_of(table_name, origin)) or "none"
                raise UserError(
                    f'{place}: "{path.stem}" is a preset of [{meant}], not of [{table_name}]; presets of [{table_name}]: {known}'
                )
            result = merged(result, preset)
    return merged(result, own)


def _table_of(preset: Mapping[str, Any]) -> str | None:
    """The table that a preset is one of: its first. What else it holds belongs to that."""
    return next((key for key, value in preset.items() if isinstance(value, dict)), None)


def _preset_folders(origin: Path) -> tuple[Path, Path]:
    return origin / "presets", FOLDER / "presets"


def _presets_of(table: str, origin: Path) -> list[str]:
    """Names of the presets of a table; files that cannot be read are left out."""
    known = set()
    for folder in _preset_folders(origin):
        for path in folder.glob("*.toml"):
            with contextlib.suppress(UserError):
                if _table_of(read(path)) == table:
                    known.add(path.stem)
    return sorted(known)


def preset_path(name: object, table: str, origin: Path, where: str) -> Path:
    """File of a preset: a bare name in scenarios/presets or in presets/ beside the scenario."""
    folders = _preset_folders(origin)
    if isinstance(name, str) and _PRESET_NAME.fullmatch(name):
        for folder in folders:
            path = folder / f"{name}.toml"
            if path.is_file():
                return path
    shown = name[:80] if isinstance(name, str) else repr(name)[:80]
    known = ", ".join(_presets_of(table, origin)) or "none"
    raise UserError(f'{where}: there is no preset "{shown}"; presets of [{table}]: {known}')


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Tables merged key by key; anything that is not a table is replaced."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return result


def names_preset(override: str) -> bool:
    """Whether the text of a ``--set`` chooses the preset of a table, such as ``psf.preset=as_measured``."""
    keys = [key.strip() for key in override.partition("=")[0].split(".")]
    return len(keys) == 2 and keys[1] == "preset"


def with_override(document: Mapping[str, Any], text: str) -> dict[str, Any]:
    """The document after ``--set table.key=value``; a value that is not TOML is taken as a string."""
    result = copy.deepcopy(dict(document))
    path, equals, value_text = text.partition("=")
    keys = [key.strip() for key in path.split(".")]
    if not equals or not all(keys) or len(keys) > MAX_DEPTH:
        raise UserError(f'--set: expected key=value such as instrument.rows=512, got "{text[:80]}"')
    table = result
    for key in keys[:-1]:
        table = table.setdefault(key, {})
        if not isinstance(table, dict):
            raise UserError(f'--set: "{key}" in "{path}" is not a table')
    table[keys[-1]] = _value(value_text.strip())
    return result


def _value(text: str) -> Any:
    """A TOML value, or the text itself."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        return text
    return parsed["value"] if set(parsed) == {"value"} else text


def value_text(value: Any) -> str:
    """A value as TOML; tables inside arrays as inline tables. Raises `TypeError` for what TOML does not have."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if isinstance(value, Mapping):
        pairs = (f"{_key_text(key)} = {value_text(below)}" for key, below in value.items())
        return "{ " + ", ".join(pairs) + " }" if value else "{}"
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        return "[" + ", ".join(value_text(below) for below in value) + "]"
    if isinstance(value, int | float):
        return repr(value)
    raise TypeError(f"{type(value).__name__} has no form in TOML")


def _key_text(key: str) -> str:
    """A key as TOML, in quotes where it needs some."""
    return key if _BARE_KEY.fullmatch(key) else value_text(key)
