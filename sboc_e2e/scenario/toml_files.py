"""Reading scenario files: size limits, presets, overrides; plain tables in and out, no meaning."""

import copy
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from sboc_e2e.icd.errors import UserError

FOLDER: Final = Path(__file__).resolve().parents[2] / "scenarios"
"""Scenarios and presets that come with the project."""

MAX_FILE_BYTES: Final = 1 << 20
MAX_DEPTH: Final = 16
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
        raise UserError(f"{where}: not valid TOML: {error}") from error
    except (RecursionError, ValueError) as error:
        raise UserError(f"{where}: not valid TOML: {type(error).__name__}") from error
    _refuse_deep(document, where)
    return document


def _refuse_deep(document: dict[str, Any], where: str) -> None:
    """Refuse nesting that no scenario has and that later recursive steps could not walk."""
    level: list[Any] = [document]
    for _ in range(MAX_DEPTH):
        below = [item.values() if isinstance(item, dict) else item for item in level if isinstance(item, dict | list)]
        level = [value for values in below for value in values]
        if not level:
            return
    raise UserError(f"{where}: tables are nested more than {MAX_DEPTH} deep")


def with_presets(document: Mapping[str, Any], origin: Path, where: str) -> dict[str, Any]:
    """The document over the fragments that its tables name with ``preset = "..."``; the document's own keys win."""
    own = copy.deepcopy(dict(document))
    result: dict[str, Any] = {}
    for table_name, table in own.items():
        if isinstance(table, dict) and "preset" in table:
            path = preset_path(table.pop("preset"), origin, f"{where}: {table_name}.preset")
            preset = read(path)
            # A preset says in its first table what it is one of; what else it holds belongs to that.
            meant = next((key for key, value in preset.items() if isinstance(value, dict)), None)
            if meant != table_name:
                raise UserError(f'{where}: {table_name}.preset: "{path.stem}" is a preset of [{meant}], not of [{table_name}]')
            result = merged(result, preset)
    return merged(result, own)


def preset_path(name: object, origin: Path, where: str) -> Path:
    """File of a preset: a bare name in scenarios/presets or in presets/ beside the scenario."""
    folders = (origin / "presets", FOLDER / "presets")
    known = sorted({path.stem for folder in folders if folder.is_dir() for path in folder.glob("*.toml")})
    if isinstance(name, str) and _PRESET_NAME.fullmatch(name):
        for folder in folders:
            path = folder / f"{name}.toml"
            if path.is_file():
                return path
    shown = name[:80] if isinstance(name, str) else repr(name)[:80]
    raise UserError(f'{where}: there is no preset "{shown}"; known: {", ".join(known) or "none"}')


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
