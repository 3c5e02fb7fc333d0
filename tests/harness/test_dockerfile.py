"""The Dockerfile, as far as it can be checked without Docker: what it copies and runs is there."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "Dockerfile").read_text(encoding="utf-8")


def test_its_python_is_one_that_the_project_supports() -> None:
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["requires-python"]
    (image,) = re.findall(r"^FROM python:(\d+)\.(\d+)-slim$", TEXT, flags=re.MULTILINE)
    assert needed == f">={image[0]}.{image[1]}"


def test_the_targets_it_names_are_those_of_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target, environment in (("e2e", "KERNELS"), ("bench", "TOOLS")):
        assert re.search(rf"^{target}: \$\({environment}\)", makefile, flags=re.MULTILINE)
        assert re.search(rf"sboc {target}\b|\"{target}\"", TEXT)
    assert "VENV := .venv\n" in makefile
    assert {"TOOLS := $(VENV)/.tools", "KERNELS := $(VENV)/.kernels"} <= set(makefile.splitlines())
    assert "RUN make .venv/.tools .venv/.kernels " in TEXT


def test_nothing_that_it_needs_is_left_out_of_the_context() -> None:
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    tracked = {path.name for path in ROOT.iterdir()} - {".git", ".venv"}
    needed = {"Makefile", "pyproject.toml", "README.md", "scenarios", "tests", "bench"}
    needed |= {"requirements.lock", "requirements-run.lock"}
    assert needed <= tracked - set(ignored)
