"""The documentation site: links of the pages lead into it, and every module has its place in the API reference."""

import importlib.util
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


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
