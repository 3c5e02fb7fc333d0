"""Where numba keeps compiled kernels: a folder named after a digest of all kernel sources.

numba looks only at the file that holds a kernel. It looks neither at functions that it inlines from other files, nor at the
constants of other files, whose values it writes into the machine code. After an edit of one of them the old machine code would
run. A digest of every source that takes part makes that impossible: of the modules that import numba, and of the modules whose
names a statement that uses numba needs, directly or through the statements that bind these names. A report is not among them.
This module must run before modules with kernels are imported.
"""

import contextlib
import hashlib
import os
import re
import shutil
import sys
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

PACKAGES: Final = ("simulator", "onboard", "ground", "sboc_e2e")
KEPT_DIGESTS: Final = 3
"""Folders kept: this one and two others, so that going back and forth between two branches compiles nothing anew. Chosen."""

_IMPORT: Final = re.compile(
    rb"^from ((?:" + "|".join((*PACKAGES, "numba")).encode() + rb")\b[\w.]*) import (?:\(([^)]*)\)|([^(\n]*))", re.MULTILINE
)
_USES_NUMBA: Final = re.compile(rb"^ *(?:from|import) numba\b", re.MULTILINE)
_NUMBA_ALIAS: Final = re.compile(rb"^import numba[\w.]* as (\w+)", re.MULTILINE)
_COMMENT: Final = re.compile(rb"#[^\n]*")
_STATEMENT: Final = re.compile(rb"\n(?=[@\w])")
_BINDS: Final = re.compile(rb"^(?:(?:def|class) (\w+)|(\w[\w, ]*?) *(?::[^=\n]*)?=)", re.MULTILINE)
_WORD: Final = re.compile(rb"[A-Za-z_]\w*")


def use_cache_of_these_sources() -> None:
    """Point numba at the folder of the present sources, unless the user chose one; older folders are removed."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    digest = source_digest(Path(__file__).resolve().parents[1])
    for root in _roots():
        folder = root / digest
        try:
            folder.mkdir(parents=True, exist_ok=True)
            probe = folder / f".writable-{os.getpid()}"
            probe.touch()
            probe.unlink()
            os.utime(folder)
            others = sorted(root.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)[KEPT_DIGESTS:]
        except OSError:
            continue
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        if (numba := sys.modules.get("numba")) is not None:
            # A notebook may have imported numba before. Kernels compiled from now on are kept in this folder.
            numba.config.CACHE_DIR = str(folder)
        for old in others:
            shutil.rmtree(old, ignore_errors=True)
        return


def _roots() -> Iterator[Path]:
    """Folders that may hold kernels, in the order of their use: the user's own, and one of temporary files.

    Containers and clusters may have no home that can be written, and numba refuses kernels that it can keep nowhere.
    """
    with contextlib.suppress(RuntimeError):  # a user without a home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sboc-e2e" / "kernels"
    import tempfile  # takes milliseconds, which those with a home spare

    with contextlib.suppress(OSError):  # no folder of temporary files either
        root = Path(tempfile.gettempdir()) / f"sboc-e2e-kernels-{os.getuid()}"
        root.mkdir(mode=0o700, exist_ok=True)
        # others, who may write there too, could put machine code in a folder of theirs
        if root.lstat().st_uid == os.getuid() and not root.lstat().st_mode & 0o022 and not root.is_symlink():
            yield root


def source_digest(root: Path) -> str:
    """Sixteen hexadecimal digits over the sources that decide the machine code of kernels, in a fixed order.

    root : the folder of the packages.
    """
    digest = hashlib.sha256()
    for name, text in sorted(_Sources(root).deciding().items()):
        digest.update(f"{name}\0{len(text)}\0".encode())
        digest.update(text)
    return digest.hexdigest()[:16]


def constant_modules(root: Path) -> list[str]:
    """Modules without numba whose names kernels use, as paths below `root`, in a fixed order."""
    return sorted(name for name, text in _Sources(root).deciding().items() if not _USES_NUMBA.search(text))


class _Module:
    """A source in its top-level statements. Regular expressions, since Python's parser takes 0.2 s for all kernels."""

    def __init__(self, text: bytes) -> None:
        self.imported: dict[bytes, tuple[bytes, bytes]] = {}
        """Local name -> module of the project and name in it."""
        self.numba_names = {b"numba"}
        # Imports stand before the first function; where there is none, find's -1 becomes the end.
        head = text[: min(text.find(mark) % (len(text) + 1) for mark in (b"\n@", b"\ndef ", b"\nclass "))]
        for module, parenthesised, plain in _IMPORT.findall(head):
            for item in _COMMENT.sub(b"", parenthesised or plain).split(b","):
                name, *alias = item.split(b" as ")
                local = (alias[0] if alias else name).strip()
                if module.startswith(b"numba"):
                    self.numba_names.add(local)
                elif local:
                    self.imported[local] = (module, name.strip())
        self.numba_names |= set(_NUMBA_ALIAS.findall(head))
        self._text = text

    @cached_property
    def statements(self) -> list[bytes]:
        """Its top-level statements but imports, each with its decorators."""
        found: list[bytes] = []
        for part in _STATEMENT.split(self._text):
            if found and found[-1].startswith(b"@") and not _BINDS.search(found[-1]):
                found[-1] += b"\n" + part
            elif not part.startswith((b"from ", b"import ")):
                found.append(part)
        return found

    @cached_property
    def bound(self) -> dict[bytes, list[bytes]]:
        """Statements by the name that they bind."""
        found: dict[bytes, list[bytes]] = {}
        for part in self.statements:
            if match := _BINDS.search(part):
                for name in (match[1] or match[2]).split(b","):
                    found.setdefault(name.strip(), []).append(part)
        return found

    def kernels(self) -> list[bytes]:
        """Statements that use numba."""
        names = sorted(self.numba_names)
        uses = re.compile(rb"\b(?:" + b"|".join(names) + rb")\b")
        return [part for part in self.statements if any(name in part for name in names) and uses.search(part)]


class _Sources:
    """The sources below a folder, and which of them kernels depend on."""

    def __init__(self, root: Path) -> None:
        self._texts: dict[str, bytes] = {}
        for package in PACKAGES:
            for folder, _, files in os.walk(root / package):
                inside = os.path.relpath(folder, root).replace(os.sep, "/")
                for file in files:
                    if file.endswith(".py"):
                        with open(f"{folder}/{file}", "rb") as stream:  # noqa: PTH123  paths take as long to make as files to read
                            self._texts[f"{inside}/{file}"] = stream.read()
        self._modules: dict[str, _Module] = {}
        self._files: dict[bytes, str | None] = {}

    def deciding(self) -> dict[str, bytes]:
        """Texts of the modules that import numba, and of those whose names kernels use, by path."""
        found = {name: text for name, text in self._texts.items() if b"numba" in text and _USES_NUMBA.search(text)}
        waiting: list[tuple[str, bytes]] = []  # modules, and statements in them
        seen: set[tuple[str, bytes]] = set()
        for name in found:
            kernels = self._module(name).kernels()
            waiting.append((name, b"\n".join(kernels)))
            seen.update((name, part) for part in kernels)
        while waiting:
            name, part = waiting.pop()
            new = set(self._used(name, part)) - seen
            seen |= new
            waiting += new
            found |= {module: self._texts[module] for module, _ in new}
        return found

    def _used(self, name: str, part: bytes) -> Iterator[tuple[str, bytes]]:
        """Statements that bind the names of a statement, each with its module; a name may be handed on by several modules."""
        module = self._module(name)
        words = set(_WORD.findall(part))
        for word in words & module.bound.keys():
            yield from ((name, statement) for statement in module.bound[word])
        for word in words & module.imported.keys():
            source, imported = module.imported[word]
            inner = self._file(source + b"." + imported)
            if inner is None:
                yield from self._bound(self._file(source), imported)
            else:
                for attribute in re.findall(rb"\b" + word + rb"\.(\w+)", part):
                    yield from self._bound(inner, attribute)

    def _bound(self, name: str | None, word: bytes) -> Iterator[tuple[str, bytes]]:
        """The module, its statements that bind a name, and those of the modules that it has the name from."""
        while name is not None:
            module = self._module(name)
            yield name, b""
            yield from ((name, statement) for statement in module.bound.get(word, ()))
            source, word = module.imported.get(word, (b"", b""))
            name = self._file(source) if source else None

    def _module(self, name: str) -> _Module:
        if name not in self._modules:
            self._modules[name] = _Module(self._texts[name])
        return self._modules[name]

    def _file(self, module: bytes) -> str | None:
        """Path of a module's source."""
        if module not in self._files:
            path = module.decode().replace(".", "/")
            self._files[module] = next((name for name in (f"{path}.py", f"{path}/__init__.py") if name in self._texts), None)
        return self._files[module]
