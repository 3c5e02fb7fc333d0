"""The number that tells one set of parameters from another: in every header packet, so that ground knows what flew."""

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass


def lines(name: str, value: object) -> Iterator[str]:
    """Every parameter as ``name = value``, options of options included; a step's class is a parameter of its own."""
    if is_dataclass(value) and not isinstance(value, type):
        yield f"{name} : {type(value).__module__}.{type(value).__qualname__}"
        for one in fields(value):
            yield from lines(f"{name}.{one.name}", getattr(value, one.name))
    elif isinstance(value, Mapping):
        for key in sorted(value, key=str):
            yield from lines(f"{name}.{key}", value[key])
    elif isinstance(value, bool | int | float | str | bytes | tuple | list | None):
        yield f"{name} = {value!r}"
    else:
        yield f"{name} : {type(value).__module__}.{type(value).__qualname__}"


def parameter_set_id(*values: object) -> int:
    """CRC-32 of all parameters of some options and steps, as text."""
    return zlib.crc32("\n".join(line for k, value in enumerate(values) for line in lines(str(k), value)).encode())
