"""Gather the pages of the documentation site and build it: ``python docs/site/build.py``, or ``make docs``.

Pages keep their paths below the project, so that links between them hold as they do in a checkout; README.md is the start page.
Links to sources and folders become links to the pages that stand for them, or plain text. The API reference has a page for each
folder of code.
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
PAGES: Final = ROOT / "build" / "pages"
PACKAGES: Final = ("sboc_e2e", "simulator", "onboard", "ground")
SINGLE: Final = ("CHANGELOG.md", "LICENSES.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "sboc_e2e/icd/ICD.md")
LINK: Final = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def gather() -> None:
    """Copy pages and pictures, and write those that are made."""
    shutil.rmtree(PAGES, ignore_errors=True)
    for path in sorted((ROOT / "docs").rglob("*")):
        if path.suffix in (".md", ".png", ".svg") and "site" not in path.parts:
            _copy(path, PAGES / path.relative_to(ROOT))
    for name in SINGLE:
        _copy(ROOT / name, PAGES / name)
    _copy(ROOT / "README.md", PAGES / "index.md")
    decisions = sorted((PAGES / "docs" / "decisions").glob("*.md"))
    titles = (path.read_text(encoding="utf-8").splitlines()[0].lstrip("# ") for path in decisions)
    lines = [f"- [{title}]({path.name})" for title, path in zip(titles, decisions, strict=True)]
    (PAGES / "docs" / "decisions" / "index.md").write_text("# Decisions\n\n" + "\n".join(lines) + "\n", encoding="utf-8")
    api()


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.suffix != ".md":
        shutil.copyfile(source, target)
        return
    target.write_text(LINK.sub(lambda found: _link(found, source), source.read_text(encoding="utf-8")), encoding="utf-8")


def _link(found: re.Match[str], source: Path) -> str:
    """A link that leads somewhere in the site, or its text alone."""
    picture, text, target = found.groups()
    place = target.partition("#")[0]
    if picture or target.startswith(("http", "#", "mailto")) or not place:
        return found.group(0)
    path = (source.parent / place).resolve()
    if path == ROOT / "docs" / "decisions":
        return f"[{text}]({place.rstrip('/')}/index.md)"
    if path == ROOT / "README.md":
        return f"[{text}]({place.replace('README.md', 'index.md')})"
    shown = path.suffix == ".md" and path.is_file()
    if not shown and path.suffix == ".py" and path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in PACKAGES:
        up = "../" * (len(source.relative_to(ROOT).parts) - 1)
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        return f"[{text}]({up}api/{_page_of(path)}#{module})"
    return found.group(0) if shown else text


def _page_of(path: Path) -> str:
    """Name of the page of the folder that a module lies in."""
    return "-".join(path.parent.relative_to(ROOT).parts) + ".md"


def api() -> None:
    """One page for each folder with modules, and their list."""
    folder = PAGES / "api"
    folder.mkdir(parents=True)
    lines = ["# API reference", "", "`sboc_e2e.api` is for scripts and notebooks. The rest is for whoever changes the code.", ""]
    for package in PACKAGES:
        for path in [ROOT / package, *sorted(p for p in (ROOT / package).rglob("*") if p.is_dir())]:
            modules = [m for m in sorted(path.glob("*.py")) if m.stem != "__main__" and not m.stem.startswith("_")]
            if not modules:
                continue
            name = ".".join(path.relative_to(ROOT).parts)
            body = [f"# {name}", ""]
            body += [f"::: {name}.{module.stem}\n" for module in modules]
            target = folder / _page_of(modules[0])
            target.write_text("\n".join(body), encoding="utf-8")
            lines.append(f"- [`{name}`]({target.name}): {', '.join(module.stem for module in modules)}")
    (folder / "index.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    gather()
    config = Path(__file__).with_name("mkdocs.yml")
    sys.exit(subprocess.call([sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", str(config)]))
