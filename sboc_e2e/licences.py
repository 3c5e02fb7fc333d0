"""LICENSES.md from the lock file and the metadata of installed packages: ``python -m sboc_e2e.licences LICENSES.md``."""

import argparse
import re
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, Final

LOCK: Final = Path(__file__).resolve().parents[1] / "requirements.lock"
_PINNED: Final = re.compile(r"^([A-Za-z0-9._-]+)==([^\s\\;]+)", re.MULTILINE)
HEAD: Final = (
    "# Licences\n\n"
    "The project is under Apache-2.0 (LICENSE). Data that come with it: Tycho-2 (Hog et al. 2000) through the Debian source\n"
    "package tycho2, BSD-2-Clause; spectra of the Sun and of dwarfs in 5 nm bins, derived from tables in pvlib, EXOSIMS and\n"
    "MeanStars (BSD-3-Clause; simulator/optics/star_spectra.md); other derived statistics carry their provenance beside them.\n\n"
    "Locked packages, from their own metadata; none is shipped with the project. `ccsds-ndm` (GPL) is used by tests only.\n\n"
    "| package | version | licence |\n|---|---|---|\n"
)
_STATED_ELSEWHERE: Final = {
    "satkit-data": "none stated for the package; its files: DE440, EGM96 and JGM are works of the US Government, IERS tables are "
    "freely redistributable, ITU_GRACE16 is CC BY 4.0, CelesTrak asks that EOP-All.csv and SW-All.csv be not mirrored "
    "(THIRDPARTY-DATA.md and data/manifest.json of satkit)",
}
"""Packages whose metadata say nothing: what is stated of their content, and where."""


def licence_of(name: str) -> str:
    """Licence of an installed package in a few words: SPDX expression, else classifiers, else the first line of the field."""
    try:
        data: Any = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return "not installed here"
    if name in _STATED_ELSEWHERE:
        return _STATED_ELSEWHERE[name]
    expression = data.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = [c.rpartition(" :: ")[2] for c in data.get_all("Classifier") or () if c.startswith("License ::")]
    known = [c for c in classifiers if c != "OSI Approved"]
    text = "; ".join(known) or str(data.get("License") or "not stated").strip().splitlines()[0]
    return text.replace("|", "/")[:80]


def page() -> str:
    """The whole page."""
    pinned = sorted(_PINNED.findall(LOCK.read_text(encoding="utf-8")), key=lambda item: item[0].lower())
    return HEAD + "".join(f"| {name} | {version} | {licence_of(name)} |\n" for name, version in pinned)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page, or with --check say whether the committed one is current."""
    parser = argparse.ArgumentParser(
        prog="python -m sboc_e2e.licences", description="Licences of all locked packages, as a page."
    )
    parser.add_argument("--check", action="store_true", help="write nothing, fail when the page is not current")
    parser.add_argument("page", type=Path, help="the page's file, LICENSES.md")
    asked = parser.parse_args(arguments)
    path: Path = asked.page
    if asked.check:
        current = path.is_file() and path.read_text(encoding="utf-8") == page()
        if not current:
            print(f"{path}: not current; run: python -m sboc_e2e.licences {path}")
        return 0 if current else 1
    path.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
