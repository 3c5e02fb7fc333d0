"""The documentation site: links of the pages lead into it, and every module has its place in the API reference."""

import ast
import importlib.util
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


def public_names() -> set[str]:
    """Functions, classes, their methods, and variables of every public module, with their modules."""
    names = set()
    for package in ("sboc_e2e", "simulator", "onboard", "ground"):
        for path in (ROOT / package).rglob("*.py"):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            tree = ast.parse(path.read_text(encoding="utf-8"))
            names |= {f"{module}.{name}" for name in _defined(tree.body)} if not path.stem.startswith("_") else set()
    return names


def _defined(body: Sequence[ast.stmt]) -> Iterator[str]:
    """Public names that the statements of a module or a class define; of a class its methods, too."""
    for statement in body:
        if isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
            names = [statement.name]
        elif isinstance(statement, (ast.Assign, ast.AnnAssign)):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names = [target.id for target in targets if isinstance(target, ast.Name)]
        else:
            continue
        for name in names:
            if not name.startswith("_"):
                yield name
                if isinstance(statement, ast.ClassDef):
                    yield from (f"{name}.{inner}" for inner in _defined(statement.body))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The script that gathers pages, writing into a folder of the test."""
    spec = importlib.util.spec_from_file_location("site_build", ROOT / "docs" / "site" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.PAGES = tmp_path_factory.mktemp("pages")
    module.gather()
    return module


def test_links_between_pages_lead_somewhere(site: ModuleType) -> None:
    for page in site.PAGES.rglob("*.md"):
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if not target.startswith(("http", "mailto")) and "api" not in page.relative_to(site.PAGES).parts:
                assert (page.parent / target).exists(), f"{page.relative_to(site.PAGES)}: {target}"


def test_every_module_is_in_the_api_reference(site: ModuleType) -> None:
    named = {
        line.removeprefix("::: ")
        for page in (site.PAGES / "api").glob("*.md")
        for line in page.read_text(encoding="utf-8").splitlines()
        if line.startswith("::: ")
    }
    wanted = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for package in site.PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if not path.stem.startswith("_")
    }
    assert named == wanted


@pytest.mark.slow
def test_the_site_builds_without_a_warning() -> None:
    if shutil.which("make") is None or not (ROOT / ".venv-docs").is_dir():
        pytest.skip("the tools of the site are not installed (make docs installs them)")
    done = subprocess.run(["make", "docs"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (ROOT / "build" / "site" / "index.html").is_file()
    shown = {
        anchor
        for page in (ROOT / "build" / "site" / "api").rglob("*.html")
        for anchor in re.findall(r'id="([^"]+)"', page.read_text(encoding="utf-8"))
    }
    assert public_names() - shown == set()
