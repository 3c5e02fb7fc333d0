"""Runs that share results: frames where the simulator's options agree, packets where everything but ground agrees.

Every folder is named by a digest of everything that determines its content: options, versions, sources, plug-ins and named files.
"""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from sboc_e2e import provenance
from sboc_e2e.files.atomic import TEMPORARY_SUFFIX, require_writable, write_text
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.run.manifest import run_id, versions
from sboc_e2e.run.pipeline import Run
from sboc_e2e.run.progress import Progress, Silent
from sboc_e2e.scenario import Scenario

_LABELS: Final = ("description", "output")
_AFTER: Final = {
    "simulate": ("onboard", "ground", "faults", *_LABELS),
    "onboard": ("ground", *_LABELS),
    "ground": _LABELS,
}
"""Tables of a scenario that do not affect a stage or the stages before it."""
KEPT: Final = ("frames", "downlinks", "runs")
SHARED_FOLDERS: Final = ("frames", "truth", "calibration")
"""Folders of a simulation that the runs on its frames link."""
LINKED: Final = (*SHARED_FOLDERS, "downlink.bin")
"""What a run takes from others by links. Absolute ones, as earlier states made them, lead nowhere once the folder is moved."""
KEY_DIGITS: Final = 16
"""Length of a folder's name in hexadecimal digits: 64 bits, so that no two contents of one disk share a name."""


def stage_document(scenario: Scenario, stage: str) -> dict[str, Any]:
    """The part of a scenario that determines the results of a stage: "simulate", "onboard" or "ground"."""
    return {key: value for key, value in scenario.document().items() if key not in _AFTER[stage]}


def stage_content(scenario: Scenario, stage: str) -> dict[str, Any]:
    """Everything that determines the results of a stage."""
    document = stage_document(scenario, stage)
    reached = [segment for segment in ("onboard", "ground") if segment in document]
    outside = {
        seam: source
        for seam, component in scenario.components.items()
        if seam.partition(".")[0] in reached and (source := provenance.plugin(type(component.step)))
    }
    return {
        "scenario": document,
        "versions": versions(),
        "code": provenance.code_digest(stage),
        "plugins": outside,
        "files": provenance.named_files(document),
    }


def key(content: Mapping[str, Any]) -> str:
    """A digest of a document as the name of a folder."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:KEY_DIGITS]


@dataclass(frozen=True, kw_only=True)
class SharedRuns:
    """Runs below one folder. workers : simulation processes, 0 for as many as pay."""

    out: Path
    workers: int = 0
    progress: Progress = field(default_factory=Silent)

    def clear(self) -> None:
        """Forget everything that was kept. Other files in these folders stay: ``--out .`` has the user's own runs in one."""
        for name in KEPT:
            for entry in (self.out / name).glob("*"):
                if _is_kept(entry):
                    shutil.rmtree(entry, ignore_errors=True)

    def ground(self, scenario: Scenario) -> Run:
        """A scenario's run up to its products, on frames and packets of earlier ones where they serve: it must keep all."""
        made = self._run("runs", "ground", scenario)
        if made.manifest.done("ground") and all((made.directory.path / name).exists() for name in LINKED):
            return made
        frames = self._frames(scenario)
        for folder in SHARED_FOLDERS:
            _link(frames.directory.path / folder, made.directory.path / folder)
        made.manifest.stages["simulate"] = frames.manifest.stages["simulate"]
        content = stage_content(scenario, "onboard")
        # The run id does not depend on the choice of a ground step, so each choice can read these packets.
        made.manifest.run_id = run_id(content["scenario"])
        shared = self.out / "downlinks" / key(content)
        if (shared / "stage.json").is_file():
            made.manifest.stages["onboard"] = json.loads((shared / "stage.json").read_text())
        else:
            made.onboard()
            require_writable(shared)
            made.directory.downlink.replace(shared / "downlink.bin")
            write_text(shared / "stage.json", json.dumps(made.manifest.stages["onboard"]))
        _link(shared / "downlink.bin", made.directory.downlink)
        made.manifest.save()
        if not made.manifest.done("ground"):  # else links alone led nowhere
            made.ground()
        return made

    def _frames(self, scenario: Scenario) -> Run:
        """The simulated frames of a scenario."""
        made = self._run("frames", "simulate", scenario)
        if not made.manifest.done("simulate"):
            made.simulate()
        return made

    def _run(self, kind: str, stage: str, scenario: Scenario) -> Run:
        path = self.out / kind / key(stage_content(scenario, stage))
        return begin_or_continue(path, scenario, keyed=True, workers=self.workers, progress=self.progress)


def _is_kept(entry: Path) -> bool:
    """Whether a folder was made here: it is named by a digest and holds a manifest or packets, or nothing yet."""
    if not re.fullmatch(f"[0-9a-f]{{{KEY_DIGITS}}}", entry.name) or not entry.is_dir():
        return False
    names = {path.name for path in entry.iterdir() if path.suffix != TEMPORARY_SUFFIX and path.name != ".writable"}
    return "manifest.json" in names or names <= {"downlink.bin", "stage.json"}


def _link(source: Path, target: Path) -> None:
    """A relative link, so that a folder that holds both may be moved; one that leads nowhere is made again."""
    if target.exists():
        return
    if target.is_symlink():
        target.unlink()
    there = os.path.relpath(source.resolve(), target.parent.resolve())
    target.symlink_to(there, target_is_directory=source.is_dir())
