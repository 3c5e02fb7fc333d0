"""The structure of the house: no circle of files or of folders, and segments that import what the design lets them.

`make lint` holds the layers (import-linter, pyproject.toml); what it cannot say is tested here on the same graph.
"""

import ast
import tomllib
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[2]
SEGMENTS = ("simulator", "onboard", "ground")

ALLOWED = {
    "simulator": {"sboc_e2e.icd", "sboc_e2e.catalogue", "sboc_e2e.truth"},
    "onboard": {"sboc_e2e.icd"},
    "ground": {"sboc_e2e.icd", "sboc_e2e.catalogue"},
}
"""What a segment may import of the harness, directly or not; everything else is forbidden."""


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """Which modules each module of the house imports, imports inside functions and for types included."""
    graph = grimp.build_graph("sboc_e2e", *SEGMENTS, cache_dir=None)
    return {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}


def circle_in(edges: Mapping[str, set[str]]) -> list[str]:
    """The nodes of one circle, the first repeated at the end; empty where there is none."""
    try:
        TopologicalSorter(edges).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def room_in(module: str, folder: str) -> str | None:
    """The file or folder directly inside `folder` that holds a module; None for what lies outside."""
    inside = module.startswith(f"{folder}.")
    return ".".join(module.split(".")[: folder.count(".") + 2]) if inside else None


def rooms(imports: Mapping[str, set[str]], folder: str) -> dict[str, set[str]]:
    """Which files and folders directly inside a folder import each other."""
    edges: dict[str, set[str]] = {}
    for module, targets in imports.items():
        here = room_in(module, folder)
        if here is not None:
            there = {room_in(target, folder) for target in targets}
            edges.setdefault(here, set()).update(room for room in there if room is not None and room != here)
    return edges


def house(imports: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The top floor: segments, and the parts of the harness, whose contract the segments import and which wires them."""
    edges: dict[str, set[str]] = {}
    for module, targets in imports.items():
        here, *there = (t.split(".")[0] if t.split(".")[0] in SEGMENTS else room_in(t, "sboc_e2e") for t in (module, *targets))
        if here is not None:
            edges.setdefault(here, set()).update(room for room in there if room is not None and room != here)
    return edges


def circles_of_folders(imports: Mapping[str, set[str]]) -> Iterator[list[str]]:
    """A circle for each folder whose files and folders have one."""
    folders = sorted({module.rpartition(".")[0] for module in imports} - {""})
    for edges in (house(imports), *(rooms(imports, folder) for folder in folders)):
        while circle := circle_in(edges):
            yield circle
            edges = {node: targets - set(circle) if node in circle else targets for node, targets in edges.items()}


def test_no_circle_of_files(imports: dict[str, set[str]]) -> None:
    assert circle_in(imports) == []


def test_no_circle_of_folders(imports: dict[str, set[str]]) -> None:
    assert list(circles_of_folders(imports)) == []


def test_a_circle_of_folders_is_found() -> None:
    """Two files of two folders that need each other's neighbours are no circle of files, but one of folders."""
    imports = {"ground.a": set(), "ground.a.x": {"ground.b.y"}, "ground.b.z": {"ground.a.x"}, "ground.b.y": set()}
    assert circle_in(imports) == []
    assert [set(circle) for circle in circles_of_folders(imports)] == [{"ground.a", "ground.b"}]


@pytest.mark.parametrize("segment", SEGMENTS)
def test_segments_import_what_they_may(imports: dict[str, set[str]], segment: str) -> None:
    """A whitelist: a new module of the harness is forbidden without anybody having to think of it."""
    own = [module for module in imports if module.split(".")[0] == segment]
    used = {room_in(target, "sboc_e2e") for module in own for target in imports[module]} - {None}
    assert used <= ALLOWED[segment]


@pytest.mark.parametrize("segment", SEGMENTS)
def test_the_linter_forbids_everything_else(imports: dict[str, set[str]], segment: str) -> None:
    """The contract of import-linter names every part of the harness that a segment may not import."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (contract,) = (c for c in contracts if c["type"] == "forbidden" and c["source_modules"] == [segment])
    parts = {room_in(module, "sboc_e2e") for module in imports} - {None}
    assert set(contract["forbidden_modules"]) >= parts - ALLOWED[segment]
    assert set(contract["forbidden_modules"]).isdisjoint(ALLOWED[segment])


@pytest.mark.parametrize("segment", SEGMENTS)
def test_a_chain_names_the_steps_and_leaves_the_work_to_them(segment: str) -> None:
    """A file that must be read as a whole stays short enough for it."""
    assert len((ROOT / segment / "chain.py").read_text(encoding="utf-8").splitlines()) <= 250


def test_no_function_takes_more_than_ten_arguments() -> None:
    """Kernels apart, which take arrays one by one, and commands, whose arguments are the options of the command line."""
    too_many = []
    for package in (*SEGMENTS, "sboc_e2e"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(node, ast.FunctionDef) or any(
                    "jit" in ast.unparse(mark) or ".command" in ast.unparse(mark) for mark in node.decorator_list
                ):
                    continue
                names = [one.arg for one in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len([name for name in names if name not in ("self", "cls")]) > 10:
                    too_many.append(f"{path.relative_to(ROOT)}: {node.name}")
    assert too_many == []


def test_no_file_holds_the_marks_of_a_merge() -> None:
    """They passed every reader of Markdown once."""
    written = [p for suffix in ("md", "py", "toml") for p in ROOT.rglob(f"*.{suffix}") if not {".venv", "runs"} & set(p.parts)]
    assert len(written) > 500
    marks = ("<" * 7 + " ", ">" * 7 + " ")
    assert [str(p) for p in written if any(line.startswith(marks) for line in p.read_text(encoding="utf-8").splitlines())] == []
