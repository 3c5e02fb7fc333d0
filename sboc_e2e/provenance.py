"""Everything besides the scenario that determines the bytes of a run: sources of the project and of plug-ins, and named files.

Digests are taken once in a process, as sources are loaded once: what runs is what was hashed.
"""

import ast
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Final
from weakref import WeakKeyDictionary

from sboc_e2e.registry import SEAMS, own_names

ROOT: Final = Path(__file__).resolve().parents[1]
SEGMENTS: Final = ("simulator", "onboard", "ground")
STAGES: Final = ("simulate", "onboard", "ground", "score")
_PACKAGES: Final = ("sboc_e2e", *SEGMENTS)
_JUDGES: Final = frozenset({"score"})
_PAGES: Final = frozenset({"cli", "licences.py", "report", "step_pages.py", "validation", "warm_up.py"})
_ONLOOKERS: Final = _PAGES | {"bench", "campaign", "checks.py", "compare", "exams", "survey"}
"""Parts of the harness that do not affect the bytes of a run."""
_NOT_SOURCE: Final = frozenset({".pyc", ".md", ".nbi", ".nbc"})
_LIBRARY_FOLDERS: Final = frozenset({"site-packages", "dist-packages"})
_DIGITS: Final = 16  # Hexadecimal digits: 64 bits. Two of a million sources share a digest with a chance of 3e-8.


@cache
def code_digest(stage: str) -> str:
    """Digest of the sources and data files that determine a stage's results, including those of earlier stages.

    stage : "simulate", "onboard", "ground" or "score".
    """
    reached = STAGES.index(stage)
    skipped = _ONLOOKERS if stage == "score" else _ONLOOKERS | _JUDGES
    harness = [path for path in sorted((ROOT / "sboc_e2e").iterdir()) if path.name not in skipped]
    return _digest_of(ROOT, _files([*harness, *(ROOT / name for name in SEGMENTS[: reached + 1])]))


@cache
def commit() -> str:
    """The commit of a source checkout, with "-dirty" after edits; "none" for an installed package."""
    if not (ROOT / ".git").exists():
        return "none"
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)  # noqa: S603  our own command line
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return done.stdout.strip() or "unknown"


def plugin(kind: type) -> dict[str, str] | None:
    """Where a step's class from outside comes from; None for one of the project's own.

    distribution : name and version of the installed package, "none" for a module that is not installed.
    file_sha256 : of the file that defines the class. source_sha256 : of all that it can import from its own package folder and
    distribution, data files such as weights included; of a module outside any package, of those beside it that it imports.
    """
    if kind not in _taken:
        _taken[kind] = _plugin(kind.__module__)
    return _taken[kind]


_taken: WeakKeyDictionary[type, dict[str, str] | None] = WeakKeyDictionary()
"""By class, since a module that is loaded again is another one."""


def _plugin(module: str) -> dict[str, str] | None:
    """The record of a module's classes."""
    top = module.partition(".")[0]
    file = getattr(sys.modules.get(module), "__file__", None)
    if top in _PACKAGES:
        return None
    if file is None:
        return dict.fromkeys(("distribution", "file_sha256", "source_sha256"), "none")
    path = Path(file).resolve()
    base = path
    for _ in range(module.count(".") + (path.name == "__init__.py")):
        base = base.parent
    folder = base.parent
    owner = _distribution(top)
    files = {*_owned(owner), *_reachable(top, folder)}
    return {
        "distribution": f"{owner.name} {owner.version}" if owner else "none",
        "file_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "source_sha256": _digest_of(folder, sorted(files)),
    }


FILE_KEYS: Final = (
    ("stars", "catalogue_file"),
    ("objects", "satellites", "file"),
    ("objects", "satellites", "sizes_file"),
    ("ground", "catalogue_file"),
    ("ground", "known_objects_file"),
    ("ground", "precise_orbits_file"),
)
"""Keys of a scenario that name a file. No option of a step of the project does; those of plug-ins may."""


def named_files(document: Mapping[str, Any]) -> dict[str, str]:
    """Digests of the files that a scenario's document names, by path. Their content matters as much as their names.

    Of options of plug-ins, any text that is the path of a file counts as one: nothing says what a plug-in does with it.
    """
    texts = {text for keys in FILE_KEYS if isinstance(text := _below(document, keys), str)}
    for seam in SEAMS:
        options = _below(document, seam.split("."))
        if isinstance(options, Mapping) and options.get("use") not in own_names(seam):
            texts.update(_texts({key: value for key, value in options.items() if key != "use"}))
    # unlike Path.is_file, os.path.isfile takes a text that is too long for a path as what it is: no file
    files = [text for text in sorted(texts) if os.path.isfile(text)]  # noqa: PTH113
    return {text: hashlib.sha256(Path(text).read_bytes()).hexdigest()[:_DIGITS] for text in files}


def _below(document: Any, keys: Iterable[str]) -> Any:
    """What stands under nested keys; None where there is nothing."""
    for key in keys:
        document = document.get(key) if isinstance(document, Mapping) else None
    return document


def _texts(node: Any) -> Iterator[str]:
    """All strings of a document."""
    if isinstance(node, str):
        yield node
    elif isinstance(node, Mapping | list | tuple):
        for item in node.values() if isinstance(node, Mapping) else node:
            yield from _texts(item)


def _distribution(top: str) -> metadata.Distribution | None:
    """The installed distribution that a top-level package belongs to."""
    owners = metadata.packages_distributions().get(top, [])
    return metadata.distribution(owners[0]) if owners else None


def _owned(owner: metadata.Distribution | None) -> list[Path]:
    """The files that a distribution installed."""
    listed = owner.files if owner else None
    paths = (Path(str(file.locate())).resolve() for file in listed or () if _is_source(Path(*file.parts)))
    return [path for path in paths if path.is_file() and path.parent.suffix != ".dist-info"]


def _reachable(top: str, folder: Path) -> set[Path]:
    """Files of a module or package, and of those beside it that they import; of a folder of libraries its own only."""
    waiting, seen, found = [top], set(), set[Path]()
    while waiting:
        name = waiting.pop()
        if name in seen or name in _PACKAGES:
            continue
        seen.add(name)
        files = list(_files([p for p in (folder / f"{name}.py", folder / name) if p.exists()]))
        found.update(files)
        if folder.name not in _LIBRARY_FOLDERS:
            waiting += [imported for path in files if path.suffix == ".py" for imported in _imports(path)]
    return found


def _imports(path: Path) -> set[str]:
    """Top-level names that a source file imports, wherever in it."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return set()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


def _is_source(path: Path) -> bool:
    """Whether a path within a package can affect results."""
    return path.suffix not in _NOT_SOURCE and not any(part.startswith(".") or part == "__pycache__" for part in path.parts)


def _files(places: Iterable[Path]) -> Iterator[Path]:
    """Files and the files of folders, in a fixed order."""
    for place in places:
        if place.is_file():
            yield place
        else:
            yield from sorted(path for path in place.rglob("*") if _is_source(path.relative_to(place)) and path.is_file())


def _digest_of(folder: Path, files: Iterable[Path]) -> str:
    """Digest over names and contents."""
    digest = hashlib.sha256()
    for path in files:
        name = path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name
        content = path.read_bytes()
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()[:_DIGITS]
