"""Digests of sources: an edit of anything that a step can run or read changes them, and nothing else does."""

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.detect.peers.lsd import LsdDetector
from sboc_e2e import provenance, scenario
from sboc_e2e.registry import Registry
from sboc_e2e.run.manifest import Manifest
from sboc_e2e.run.shared import key, stage_content
from sboc_e2e.scenario.document import default_texts

STEP = """
from dataclasses import dataclass

import numpy as np

@dataclass(frozen=True, kw_only=True)
class Nothing:
    history_frames: int = 0

    def detect(self, view):
        from {helper} import limit
        return ()
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a loose module, a package, and something that neither of them imports."""
    (tmp_path / "loose_step.py").write_text(STEP.format(helper="loose_helper"))
    (tmp_path / "loose_helper.py").write_text("import deep_helper\nlimit = 1\n")
    (tmp_path / "deep_helper.py").write_text("value = 1\n")
    (tmp_path / "unrelated.py").write_text("value = 1\n")
    package = tmp_path / "packed_lab"
    (package / "nets").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "nets" / "__init__.py").write_text(STEP.format(helper="packed_lab.limits"))
    (package / "limits.py").write_text("limit = 1\n")
    (package / "weights.bin").write_bytes(b"\0\1")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.partition(".")[0] in ("loose_step", "packed_lab")]:
        del sys.modules[name]


def record(module: str) -> dict[str, str]:
    """The record of a class as a new process would take it."""
    for name in [name for name in sys.modules if name == module or name.startswith(module.partition(".")[0])]:
        del sys.modules[name]
    importlib.invalidate_caches()
    found = provenance.plugin(importlib.import_module(module).Nothing)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("module", "edited"),
    [
        ("loose_step", "loose_step.py"),
        ("loose_step", "loose_helper.py"),
        ("loose_step", "deep_helper.py"),
        ("packed_lab.nets", "packed_lab/nets/__init__.py"),
        ("packed_lab.nets", "packed_lab/limits.py"),
        ("packed_lab.nets", "packed_lab/weights.bin"),
    ],
)
def test_an_edit_of_what_a_plugin_can_reach_changes_its_digest(lab: Path, module: str, edited: str) -> None:
    before = record(module)
    (lab / edited).write_bytes((lab / edited).read_bytes() + b"\n")
    after = record(module)
    assert after["source_sha256"] != before["source_sha256"]
    assert (after["file_sha256"] != before["file_sha256"]) == (edited in ("loose_step.py", "packed_lab/nets/__init__.py"))


@pytest.mark.parametrize("module", ["loose_step", "packed_lab.nets"])
def test_nothing_else_does(lab: Path, module: str) -> None:
    before = record(module)
    (lab / "unrelated.py").write_text("value = 2\n")
    cache = lab / "packed_lab" / "__pycache__"
    cache.mkdir(exist_ok=True)
    (cache / "limits.cpython-399.pyc").write_bytes(b"compiled")
    assert record(module) == before


def test_steps_of_the_project_are_covered_by_its_own_digest() -> None:
    assert provenance.plugin(LsdDetector) is None
    digests = [provenance.code_digest(stage) for stage in provenance.STAGES]
    assert len(set(digests)) == len(digests)


def test_keys_of_shared_runs_follow_plugins_code_and_named_files(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What an on-board plug-in decides is keyed by its source, what is simulated before it is not."""

    def keys() -> dict[str, str]:
        found = scenario.load("smoke", registry=Registry(), use={"onboard.detector": "loose_step:Nothing"})
        return {stage: key(stage_content(found, stage)) for stage in ("simulate", "onboard", "ground")}

    before = keys()
    record("loose_step")
    assert keys() == before
    (lab / "deep_helper.py").write_text("value = 2\n")
    record("loose_step")
    edited = keys()
    assert edited["simulate"] == before["simulate"]
    assert edited["onboard"] != before["onboard"]
    assert edited["ground"] != before["ground"]
    monkeypatch.setattr(provenance, "code_digest", lambda stage: "other" if stage == "ground" else "same")
    assert keys()["ground"] != edited["ground"]


def test_a_named_file_is_known_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "objects.3le"
    path.write_text("one")
    before = provenance.named_files({"ground": {"known_objects_file": str(path), "n": 1}})
    path.write_text("two")
    after = provenance.named_files({"ground": {"known_objects_file": str(path), "n": 1}})
    assert list(before) == list(after) == [str(path)]
    assert before != after


def test_a_text_is_no_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only keys that name a file do, whatever their name looks like; a long text is not looked for on the disk."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elements").write_text("one")
    text = "A fence that follows the belt. " * 12
    found = scenario.bare("told", {"description": text, "ground": {"known_objects_file": "elements"}}, registry=Registry())
    assert list(provenance.named_files(found.document())) == ["elements"]
    assert provenance.named_files({"description": "elements", "ground": {"known_objects_file": text}}) == {}


def test_keys_of_files_are_all_those_whose_name_says_so() -> None:
    named = {name for name in default_texts() if name.endswith("file")}
    assert named == {".".join(keys) for keys in provenance.FILE_KEYS}


def test_options_of_plugins_may_name_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights").write_text("one")
    (tmp_path / "header").write_text("one")

    def named(use: str) -> list[str]:
        return list(provenance.named_files({"onboard": {"detector": {"use": use, "nets": [{"file": "weights"}], "n": 1}}}))

    assert named("my_lab.nets:StreakNet") == ["weights"]
    assert named("threshold") == []


def test_the_manifest_names_plugin_version_file_and_commit(lab: Path, tmp_path: Path) -> None:
    found = scenario.load("smoke", registry=Registry(), use={"onboard.detector": "packed_lab.nets:Nothing"})
    manifest = Manifest.of(tmp_path / "manifest.json", found)
    step = manifest.components["onboard.detector"]
    assert step["distribution"] == "none"
    assert len(step["file_sha256"]) == 64
    assert "file_sha256" not in manifest.components["onboard.codec"]
    assert len(manifest.commit) >= 4
    manifest.save()
    stored = json.loads((tmp_path / "manifest.json").read_text())
    assert stored["sources"]["code"] == provenance.code_digest("ground")
    assert Manifest.read(tmp_path / "manifest.json").difference(manifest) is None
    edited = Manifest.of(tmp_path / "manifest.json", found)
    edited.components["onboard.detector"] = step | {"source_sha256": "other"}
    assert "onboard.detector.source_sha256 was" in str(edited.difference(manifest))
