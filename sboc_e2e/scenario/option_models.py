"""From option dataclasses of the segments to pydantic models of TOML tables, and back to dataclasses.

A field `exposure_s: float` with ``metadata={"doc": ..., "min": ..., "max": ...}`` becomes the key ``exposure`` that takes
a quantity string; fields without a unit suffix take bare values; nested dataclasses are tables; tuples of dataclasses
are arrays of tables. Segments know nothing of it.
"""

import dataclasses
import datetime
import difflib
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError, WithJsonSchema, create_model

from sboc_e2e.icd.errors import SbocError, UserError
from sboc_e2e.scenario import quantities

MAX_STRING: Final = 4096  # Characters of a text: those of a path on Linux (PATH_MAX).
_NAMES: Final = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}


@dataclass(frozen=True, kw_only=True)
class OptionField:
    """One option: the dataclass field, its TOML key, unit, element type and validity."""

    name: str
    key: str
    unit: str | None
    hint: Any
    default: Any
    meta: Mapping[str, Any]

    @property
    def meaning(self) -> str:
        """What the option means."""
        return str(self.meta.get("doc", self.name.replace("_", " ")))

    @property
    def limits(self) -> str:
        """The values that are allowed, in words; '' where any value of the type is."""
        return _limits(self.meta, self.unit)

    @property
    def doc(self) -> str:
        """What the option means, with its range."""
        return f"{self.meaning} ({self.limits})" if self.limits else self.meaning

    @property
    def required(self) -> bool:
        """Whether the option must be given."""
        return self.default is dataclasses.MISSING

    @property
    def written_default(self) -> Any:
        """The default as a scenario would write it; None where there is none, or where the key is required."""
        return None if self.required or self.default is None else _document_value(self.default, self.unit)


def is_options(hint: Any) -> bool:
    """Whether a type is an option dataclass."""
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


@cache
def option_fields(options: type) -> tuple[OptionField, ...]:
    """The options of a dataclass in their order; fields that would share a key keep their unit suffix in it."""
    hints = typing.get_type_hints(options)
    names = [item.name for item in dataclasses.fields(options) if item.init]
    stripped = {name: quantities.split_name(name) if _is_numeric(_without_none(hints[name])) else (name, None) for name in names}
    keys = [key for key, _ in stripped.values()]
    found: list[OptionField] = []
    for item in dataclasses.fields(options):
        if not item.init:
            continue
        key, unit = stripped[item.name]
        if keys.count(key) > 1:
            key = item.name
        default: Any = item.default
        if item.default_factory is not dataclasses.MISSING:
            default = item.default_factory()
        hint = _without_none(hints[item.name])
        found.append(OptionField(name=item.name, key=key, unit=unit, hint=hint, default=default, meta=item.metadata))
    return tuple(found)


@cache
def model_of(options: type) -> type[BaseModel]:
    """The pydantic model of a TOML table with these options; unknown keys are refused."""
    return create_model(
        options.__name__,
        __config__=ConfigDict(extra="forbid", protected_namespaces=(), frozen=True, validate_by_alias=True, defer_build=True),
        __doc__=(options.__doc__ or "").strip().splitlines()[0] if options.__doc__ else "",
        **model_fields(options),
    )


def model_fields(options: type) -> dict[str, Any]:
    """Definitions for `pydantic.create_model`: attribute ``option_<name>`` with the TOML key as alias."""
    return {
        f"option_{item.name}": (
            _annotation(item.hint, item.unit, item.meta),
            Field(default=..., alias=item.key, description=item.doc)
            if item.required
            else Field(default=_schema_default(item), alias=item.key, description=item.doc, json_schema_extra=without_null),
        )
        for item in option_fields(options)
    }


def _schema_default(item: OptionField) -> Any:
    """Default for the JSON schema alone: `to_options` takes the dataclass's own. Of a table only what its keys do not say."""
    if not is_options(item.hint) or item.default is None:
        return item.written_default
    own = {below.key: below.written_default for below in option_fields(item.hint)}
    return {key: value for key, value in item.written_default.items() if value != own[key]} or None


def without_null(schema: dict[str, Any]) -> None:
    """Leave out a default of null."""
    if schema.get("default") is None:
        schema.pop("default", None)


def to_options(options: type, model: BaseModel, default: Any = None) -> Any:
    """Dataclass instance from a validated model: keys that were given, over `default` or the class's defaults."""
    values: dict[str, Any] = {}
    for item in option_fields(options):
        attribute = f"option_{item.name}"
        if attribute not in model.model_fields_set:
            continue
        base = getattr(default, item.name) if default is not None else item.default
        values[item.name] = _value(item.hint, getattr(model, attribute), base)
    if default is not None:
        return dataclasses.replace(default, **values)
    return options(**values)


def to_document(instance: Any) -> dict[str, Any]:
    """TOML-shaped table of all options of an instance, defaults included; None is left out."""
    table: dict[str, Any] = {}
    kind: Any = type(instance)
    for item in option_fields(kind):
        value = getattr(instance, item.name)
        if value is not None:
            table[item.key] = _document_value(value, item.unit)
    return table


def validate(
    model: type[BaseModel], table: Mapping[str, Any], where: str, also: Mapping[str, tuple[str, ...]] = types.MappingProxyType({})
) -> BaseModel:
    """Validated model. Raises a `UserError` of one line that names the key, what was expected and what was given.

    also : keys of nested tables that are allowed though the model does not have them, for the list of what is known.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise UserError(_one_line(error, model, where, also)) from error
    except RecursionError as error:
        raise UserError(f"{where}: nested too deeply") from error


def build(options: type, model: BaseModel, where: str, default: Any = None) -> Any:
    """`to_options`, with refusals of the dataclass itself turned into a `UserError` that names the table."""
    try:
        return to_options(options, model, default)
    except SbocError as error:
        raise UserError(f"{where}: {error}") from error
    except (ValueError, TypeError) as error:
        raise UserError(f"{where}: {options.__name__} refuses these options: {error}") from error


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A suggestion for a mistyped word and the list of what is known, for the end of an error line."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    hint = f'did you mean "{close[0]}"? ' if close else ""
    return f"{hint}known: {', '.join(names) if names else 'none'}"


def _without_none(hint: Any) -> Any:
    """``X | None -> X``: an absent key means None."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        rest = [arm for arm in typing.get_args(hint) if arm is not type(None)]
        if len(rest) == 1:
            return rest[0]
    return hint


def _is_numeric(hint: Any) -> bool:
    """Whether values are numbers, alone or in a tuple."""
    if typing.get_origin(hint) is tuple:
        return all(arm is Ellipsis or arm in (int, float) for arm in typing.get_args(hint))
    return hint in (int, float)


def _limits(meta: Mapping[str, Any], unit: str | None) -> str:
    """Range or choices in words, '' when there are none."""
    if "choices" in meta:
        return "one of " + ", ".join(str(choice) for choice in meta["choices"])
    low, high = meta.get("min"), meta.get("max")
    of_unit = f" {quantities.display(unit)}" if unit else ""
    if low is not None and high is not None:
        return f"{_bound(low)} to {_bound(high)}{of_unit}"
    if low is not None:
        return f"at least {_bound(low)}{of_unit}"
    return f"at most {_bound(high)}{of_unit}" if high is not None else ""


def _bound(value: float) -> str:
    """A limit in words; whole numbers with all digits."""
    return str(value) if isinstance(value, int) else f"{value:g}"


def _annotation(hint: Any, unit: str | None, meta: Mapping[str, Any]) -> Any:
    """Type of a model's field."""
    if is_options(hint):
        return model_of(hint)
    origin = typing.get_origin(hint)
    if origin is tuple:
        arms = typing.get_args(hint)
        if len(arms) == 2 and arms[1] is Ellipsis:
            return tuple[_annotation(arms[0], unit, meta), ...]  # type: ignore[misc]
        return tuple[tuple(_annotation(arm, unit, meta) for arm in arms)]  # type: ignore[misc]
    if origin is Literal:
        return _scalar(str, None, {**meta, "choices": typing.get_args(hint)})
    if hint in _NAMES:
        return _scalar(hint, unit, meta)
    raise UserError(f"an option of type {hint} cannot be written in a scenario")


def _scalar(kind: type, unit: str | None, meta: Mapping[str, Any]) -> Any:
    """Annotated scalar with this project's own checks and words."""
    return Annotated[Any, PlainValidator(_checker(kind, unit, meta)), WithJsonSchema(_scalar_schema(kind, unit, meta))]


def _checker(kind: type, unit: str | None, meta: Mapping[str, Any]) -> Callable[[object], Any]:
    """Function that accepts a TOML value or raises ValueError with the reason."""
    limits = _limits(meta, unit)

    def check(value: object) -> Any:
        result: Any
        if unit is not None:
            result = quantities.parse(value, unit, limits)
            if kind is int:
                if abs(result - round(result)) > 1e-9 * max(1.0, abs(result)):
                    raise ValueError(f"expected a whole number of {quantities.display(unit)}, got {value!r}")
                result = round(result)
        else:
            accepted: tuple[type, ...] = (int, float) if kind is float else (kind,)
            if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
                quotes = ", in quotes" if kind is str and isinstance(value, datetime.date | datetime.time) else ""
                raise ValueError(f"expected {_NAMES[kind]}{quotes}, got {quantities.shown(value)}")
            if isinstance(value, str) and len(value) > MAX_STRING:
                raise ValueError(f"expected at most {MAX_STRING} characters, got {len(value)}")
            result = _finite(value) if kind is float else value
        if "choices" in meta and result not in meta["choices"]:
            raise ValueError(f"expected {limits}, got {quantities.shown(value)}")
        if ("min" in meta and result < meta["min"]) or ("max" in meta and result > meta["max"]):
            raise ValueError(f"expected {limits}, got {quantities.shown(value)}")
        return result

    return check


def _finite(value: Any) -> float:
    """A float that is neither infinite nor NaN."""
    try:
        number = float(value)
    except OverflowError as error:
        raise ValueError("expected a finite number, got an integer too large for a float") from error
    if number != number or number in (float("inf"), float("-inf")):
        raise ValueError(f"expected a finite number, got {value}")
    return number


def _scalar_schema(kind: type, unit: str | None, meta: Mapping[str, Any]) -> dict[str, Any]:
    """JSON schema of a scalar."""
    if unit is not None:
        return {"type": "string", "pattern": r"^\s*[+-]?(\d|\.\d)", "examples": [f"1 {quantities.display(unit)}"]}
    schema: dict[str, Any] = {"type": {bool: "boolean", int: "integer", float: "number", str: "string"}[kind]}
    if "choices" in meta:
        schema["enum"] = list(meta["choices"])
    if "min" in meta:
        schema["minimum"] = meta["min"]
    if "max" in meta:
        schema["maximum"] = meta["max"]
    return schema


def _value(hint: Any, value: Any, default: Any) -> Any:
    """Dataclass value of a model's value."""
    if is_options(hint):
        return to_options(hint, value, default if is_options(type(default)) else None)
    if typing.get_origin(hint) is tuple:
        arms = typing.get_args(hint)
        element = arms[0] if len(arms) == 2 and arms[1] is Ellipsis else None
        return tuple(_value(element if element is not None else arms[i], item, None) for i, item in enumerate(value))
    return value


def _document_value(value: Any, unit: str | None) -> Any:
    """TOML-shaped value of an option."""
    if dataclasses.is_dataclass(value):
        return to_document(value)
    if isinstance(value, tuple):
        return [_document_value(item, unit) for item in value]
    if unit is not None:
        return quantities.write(value, unit)
    return value


def _one_line(error: ValidationError, model: type[BaseModel], where: str, also: Mapping[str, tuple[str, ...]]) -> str:
    """The first complaint of pydantic in this project's words."""
    first = error.errors(include_url=False)[0]
    path = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        *parents, key = first["loc"]
        table = ".".join(str(part) for part in parents)
        known = [*also.get(table, ()), *_keys_at(model, parents)]
        elsewhere = [f"[{other}]" for other in _tables_with(model, str(key))]
        hint = f"{' and '.join(elsewhere[:3])} {'has' if len(elsewhere) == 1 else 'have'} such a key; " if elsewhere else ""
        return f'{where}: unknown key "{key}"{f" in [{table}]" if table else ""}; {hint}{did_you_mean(str(key), known)}'
    if first["type"] == "missing":
        return f"{where}: {path} is missing"
    cause = first.get("ctx", {}).get("error")
    if cause is not None:
        return f"{where}: {path}: {cause}"
    if first["type"] in ("model_type", "model_attributes_type"):
        return f"{where}: {path}: expected a table, got {quantities.shown(first['input'])}"
    if first["type"] == "tuple_type":
        return f"{where}: {path}: expected an array, got {quantities.shown(first['input'])}; tables are [[{path}]], values [1, 2]"
    return f"{where}: {path}: {first['msg'][0].lower()}{first['msg'][1:]}, got {quantities.shown(first['input'])}"


def _tables_with(model: Any, key: str, prefix: str = "") -> list[str]:
    """Dotted names of the tables below the top that have a key of this name."""
    found = []
    for info in model.model_fields.values():
        below = info.annotation
        if isinstance(below, type) and issubclass(below, BaseModel):
            path = f"{prefix}{info.alias}"
            if any(str(item.alias) == key for item in below.model_fields.values()):
                found.append(path)
            found += _tables_with(below, key, f"{path}.")
    return found


def _keys_at(model: type[BaseModel], path: list[int | str]) -> list[str]:
    """Keys that are allowed in a nested table."""
    current: Any = model
    for part in path:
        if isinstance(part, int):
            continue
        info = next((f for f in current.model_fields.values() if f.alias == part), None)
        current = info.annotation if info is not None else None
        while typing.get_origin(current) is tuple:
            current = typing.get_args(current)[0]
        if not (isinstance(current, type) and issubclass(current, BaseModel)):
            return []
    return [str(field.alias) for field in current.model_fields.values()]
