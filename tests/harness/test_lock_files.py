"""The two lock files agree: what a run needs is a part of what developers need, in the same versions."""

import re
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]


def locked(name: str) -> dict[str, tuple[str, frozenset[str]]]:
    """Version and hashes of each package."""
    text = (ROOT / name).read_text(encoding="utf-8")
    blocks = re.findall(r"^([\w.-]+)==([^\s;]+)(.*?)(?=^[\w.-]+==|\Z)", text, flags=re.MULTILINE | re.DOTALL)
    return {package: (version, frozenset(re.findall(r"sha256:([0-9a-f]{64})", rest))) for package, version, rest in blocks}


def test_what_a_run_needs_is_locked_alike_in_both_files() -> None:
    run, everything = locked("requirements-run.lock"), locked("requirements.lock")
    assert len(run) > 40
    assert {name: everything[name][0] for name in run} == {name: version for name, (version, _) in run.items()}
    for name, (_, hashes) in run.items():  # one file may list wheels of more platforms than the other
        assert hashes & everything[name][1], name


def test_a_run_needs_no_package_that_only_developers_have() -> None:
    """All that the project and its packages of a run require, followed through their metadata, is in the short file."""
    run = locked("requirements-run.lock")
    seen: set[tuple[str, frozenset[str]]] = set()
    following = [("sboc-e2e", frozenset({"distributed", "survey", "solve", "objects"}))]
    while following:
        name, extras = following.pop()
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        for text in distribution(name).requires or ():
            needed = Requirement(text)
            if needed.marker is None or any(needed.marker.evaluate({"extra": extra}) for extra in (*extras, "")):
                following.append((re.sub(r"[-_.]+", "-", needed.name).lower(), frozenset(needed.extras)))
    assert {name for name, _ in seen} - {"sboc-e2e"} == set(run)
