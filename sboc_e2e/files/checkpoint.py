"""States of segments and per-frame results as files: trees of dataclasses, arrays and plain values in an .npz, no pickle.

Records are stored by class name and restored only as dataclasses or enumerations of modules that are already loaded, so
that a file cannot make the program import or run anything.
"""

import dataclasses
import io
import json
import lzma
import struct
import sys
import tokenize
import zipfile
import zlib
from collections import deque
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_bytes
from sboc_e2e.icd.errors import PluginError, UserError

_TREE: Final = "tree"
_DAMAGE: Final = (
    ValueError, LookupError, TypeError, AttributeError, EOFError, OverflowError, SyntaxError, RuntimeError, MemoryError,
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, struct.error, tokenize.TokenError,
)  # fmt: skip
"""What the readers of zip files, arrays and trees raise of damaged bytes. RuntimeError: encrypted, a compression that is
not known, nested too deeply. OSError: damaged bzip2. MemoryError: a huge shape. TokenError: the header of an array."""


def save(path: Path, value: Any, shared: Mapping[str, Any] = MappingProxyType({})) -> None:
    """Write a value atomically. Raises `PluginError` for values that a checkpoint cannot hold.

    shared : large objects that a reader has anyway (the star catalogue), stored by name only.
    """
    write_bytes(path, to_bytes(value, shared))


def load(path: Path, shared: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """The value of a file. Raises `UserError` when the file is no checkpoint of this program."""
    data = path.read_bytes()
    try:
        return from_bytes(data, shared)
    except _DAMAGE as error:
        raise UserError(f"{path}: not a checkpoint of this program ({type(error).__name__}); run again with --force") from error


def to_bytes(value: Any, shared: Mapping[str, Any] = MappingProxyType({})) -> bytes:
    """An .npz with the tree as JSON text and its arrays beside it; an array that occurs twice is stored once."""
    arrays: list[NDArray[Any]] = []
    tree = json.dumps(_encode(value, arrays, {}, {id(item): name for name, item in shared.items()}))
    stream = io.BytesIO()
    members: dict[str, Any] = {f"a{i}": array for i, array in enumerate(arrays)}
    np.savez(stream, allow_pickle=False, **members, **{_TREE: np.frombuffer(tree.encode(), dtype=np.uint8)})
    return stream.getvalue()


def from_bytes(data: bytes, shared: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """Inverse of `to_bytes`."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        tree = json.loads(archive[_TREE].tobytes().decode())
        arrays = [archive[f"a{i}"] for i in range(len(archive.files) - 1)]
    for array in arrays:
        array.flags.writeable = False
    return _decode(tree, arrays, shared)


def _encode(value: Any, arrays: list[NDArray[Any]], seen: dict[int, int], shared: dict[int, str]) -> Any:
    """JSON tree of a value; arrays are appended to `arrays`, `seen` maps id -> index of those met before."""
    if id(value) in shared:
        return {"shared": shared[id(value)]}
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, Enum):
        return {"enum": _name(type(value)), "value": value.value}
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise PluginError("a state holds an array of Python objects, which cannot be saved between frames")
        if id(value) not in seen:
            seen[id(value)] = len(arrays)
            arrays.append(value)
        return {"array": seen[id(value)]}
    if isinstance(value, np.generic):
        arrays.append(np.asarray(value))
        return {"scalar": len(arrays) - 1}
    if isinstance(value, bytes):
        arrays.append(np.frombuffer(value, dtype=np.uint8))
        return {"bytes": len(arrays) - 1}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: _encode(getattr(value, f.name), arrays, seen, shared) for f in dataclasses.fields(value)}
        return {"record": _name(type(value)), "fields": fields}
    if isinstance(value, dict):
        return {"dict": [[_encode(k, arrays, seen, shared), _encode(v, arrays, seen, shared)] for k, v in value.items()]}
    for kind, label in ((tuple, "tuple"), (list, "list"), (deque, "deque")):
        if type(value) is kind or (label == "tuple" and isinstance(value, tuple)):
            return {label: [_encode(item, arrays, seen, shared) for item in value]}
    raise PluginError(f"a state holds a {type(value).__name__}, which cannot be saved between frames")


def _decode(node: Any, arrays: list[NDArray[Any]], shared: Mapping[str, Any]) -> Any:
    """Value of a JSON tree."""
    if not isinstance(node, dict):
        return node
    kind = next(iter(node))
    content = node[kind]
    if kind == "shared":
        return shared[content]
    if kind == "array":
        return arrays[content]
    if kind == "scalar":
        return arrays[content][()]
    if kind == "bytes":
        return arrays[content].tobytes()
    if kind == "enum":
        return _class(content, Enum)(node["value"])
    if kind == "record":
        found = _class(content, None)
        record: Any = object.__new__(found)
        for name, item in node["fields"].items():
            object.__setattr__(record, name, _decode(item, arrays, shared))
        return record
    if kind == "dict":
        return {_decode(k, arrays, shared): _decode(v, arrays, shared) for k, v in content}
    items = [_decode(item, arrays, shared) for item in content]
    return {"tuple": tuple, "list": list, "deque": deque}[kind](items)


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _class(name: str, base: type | None) -> type:
    """A loaded dataclass (base None) or enumeration of this name; imports nothing."""
    module, _, path = name.partition(":")
    found: Any = sys.modules[module]
    for part in path.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or not (dataclasses.is_dataclass(found) if base is None else issubclass(found, base)):
        raise ValueError(f"{name} is not a record")
    return found
