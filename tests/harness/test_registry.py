"""Steps by name: what may be loaded, by whom, and what is refused."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from sboc_e2e import registry, scenario
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import SEAMS, Registry

LAB = """
from dataclasses import dataclass
@dataclass(frozen=True, kw_only=True)
class Net:
    n_sigma: float = 5.0
    @property
    def history_frames(self) -> int: return 0
    def detect(self, view): return ()
class Loose:
    def detect(self, view): return ()
@dataclass
class Thawed:
    def detect(self, view): return ()
@dataclass(frozen=True)
class Mute:
    pass
@dataclass(frozen=True)
class Forgetful:
    def detect(self, view): return ()
@dataclass(frozen=True, kw_only=True)
class Asking:
    history_frames: int
    def detect(self, view): return ()
value = 3
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module outside the project, in the working folder; importing it leaves a trace."""
    name = "lab_of_" + tmp_path.name.replace("-", "_")
    (tmp_path / f"{name}.py").write_text(LAB + f"\nopen({str(tmp_path / 'imported')!r}, 'w').close()\n")
    (tmp_path / f"{name}_broken.py").write_text("import a_module_that_is_not_there")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path / f"{name}.py"


def test_every_default_step_is_installed_and_fits_its_seam() -> None:
    for seam in SEAMS.values():
        step = Registry().resolve(seam.name, seam.default)()
        assert isinstance(step, seam.protocol), seam.name


def test_every_installed_step_resolves() -> None:
    for seam in SEAMS:
        names = Registry().names(seam)
        assert names, seam
        for name in names:
            assert Registry().resolve(seam, name)() is not None


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(UserError, match=r'onboard.detector: no step is called "nonsuch"; known: .*line_integral'):
        Registry().resolve("onboard.detector", "nonsuch")
    with pytest.raises(UserError, match=r'unknown seam "onboard.nose"; known: onboard.background'):
        Registry().resolve("onboard.nose", "mesh")


@pytest.mark.parametrize(
    "attack",
    [
        "subprocess:Popen", "os:system", "builtins:eval", "../lab:Net", "/etc/passwd:x", "os.path:join", "lab/../lab:Net",
        "lab:Net:x", ":", "a:", ":b", "http://x:y", "lab;import os:Net", "importlib:import_module", "lab:Net.__init__",
    ],
)  # fmt: skip
def test_a_scenario_file_alone_cannot_import_anything(tmp_path: Path, lab: Path, attack: str) -> None:
    attack = attack.replace("lab", lab.stem)
    path = tmp_path / "from_somebody.toml"
    path.write_text(f"[onboard.detector]\nuse = {attack!r}\n")
    with pytest.raises(UserError) as caught:
        scenario.load(str(path), registry=Registry())
    message = str(caught.value)
    assert "is not loaded from a scenario file" in message or "is not of the form module:Class" in message
    assert lab.stem not in sys.modules
    assert not (tmp_path / "imported").exists()


def test_a_trusted_module_is_loaded_and_only_that_one(tmp_path: Path, lab: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'[onboard.detector]\nuse = "{lab.stem}:Net"\nn_sigma = 4.0\n')
    trusting = Registry(trusted_modules=(lab.stem,))
    assert scenario.load(str(path), registry=trusting).step("onboard.detector").n_sigma == 4.0
    with pytest.raises(UserError, match="--plugin"):
        scenario.load(str(path), registry=Registry(trusted_modules=(lab.stem[:-1],)))


def test_a_typed_class_is_loaded_without_trusting_the_file(lab: Path) -> None:
    found = scenario.load("smoke", registry=Registry(), use={"onboard.detector": f"{lab.stem}:Net"})
    assert type(found.step("onboard.detector")).__name__ == "Net"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (":Loose", "is not a dataclass"),
        (":Thawed", "is not frozen"),
        (":Mute", r"has no method detect\(\)"),
        (":Forgetful", "has no history_frames; Detector asks for history_frames as fields or properties"),
        (":value", "is a int; expected a class"),
        (":Nonsuch", 'cannot be imported: AttributeError: .* has no class "Nonsuch"; it has: .*Loose.*Mute'),
        ("_broken:Net", "cannot be imported: ModuleNotFoundError"),
        (
            "_nowhere:Net",
            r"cannot be imported: ModuleNotFoundError: .*looked for in the working folder \(.*\) and among installed",
        ),
    ],
)
def test_what_does_not_fit_is_refused(lab: Path, name: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        Registry().resolve("onboard.detector", lab.stem + name, typed=True)


def test_a_number_that_a_protocol_asks_for_may_be_a_field_without_a_default(lab: Path) -> None:
    assert Registry().resolve("onboard.detector", lab.stem + ":Asking", typed=True).__name__ == "Asking"


def test_two_packages_with_the_same_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    group = "sboc_e2e.onboard.detector"
    points = [EntryPoint("net", "lab_a:Net", group), EntryPoint("net", "lab_b:Net", group)]
    monkeypatch.setattr(registry, "_installed", lambda seam: {"net": tuple(points)})
    with pytest.raises(UserError, match=r'two installed packages call a step "net": lab_a:Net .* and lab_b:Net'):
        Registry().resolve("onboard.detector", "net")


def test_names_of_plugins_are_checked() -> None:
    assert registry.plugin_names(["my_lab", "my_lab.nets"]) == ("my_lab", "my_lab.nets")
    with pytest.raises(UserError, match="is not the name of a Python module"):
        registry.plugin_names(["../my_lab"])
