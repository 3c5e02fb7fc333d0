"""Where numba keeps compiled kernels: a folder named after a digest of all kernel sources.

numba looks only at the file that holds a kernel, and not at functions that it inlines from other files. After an edit of an
inlined function, the old machine code would run with new tables. A digest of every source that takes part makes that
impossible. This module must run before modules with kernels are imported.
"""

import hashlib
import os
import shutil
import sys
from pathlib import Path
from typing import Final

PACKAGES: Final = ("simulator", "onboard", "ground", "sboc_e2e")
KEPT_DIGESTS: Final = 3
"""Folders kept: this one and two others, so that going back and forth between two branches compiles nothing anew. Chosen."""


def use_cache_of_these_sources() -> None:
    """Point numba at the folder of the present sources, unless the user chose one; older folders are removed."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sboc-e2e" / "kernels"
    folder = root / source_digest(Path(__file__).resolve().parents[1])
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if (numba := sys.modules.get("numba")) is not None:
        # A notebook may have imported numba before. Kernels compiled from now on are kept in this folder.
        numba.config.CACHE_DIR = str(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        others = sorted(root.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)[KEPT_DIGESTS:]
    except OSError:
        return  # An unwritable home folder costs compilation time only.
    for old in others:
        shutil.rmtree(old, ignore_errors=True)


def source_digest(root: Path) -> str:
    """Sixteen hexadecimal digits over the sources of all modules that name numba, in a fixed order."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            text = path.read_bytes()
            if b"numba" in text:
                digest.update(str(path.relative_to(root)).encode())
                digest.update(text)
    return digest.hexdigest()[:16]
