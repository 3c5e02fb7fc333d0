"""A run small enough for tests: four frames of 128 x 128 over the field of sso_antisun."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sboc_e2e import scenario
from sboc_e2e.registry import Registry
from sboc_e2e.run import RunDirectory, RunRequest, run
from sboc_e2e.run.manifest import Manifest
from sboc_e2e.run.pipeline import Run

TINY = """
description = "tests"
seed = 5
frames = 4
frame_rate = "4 Hz"

[instrument]
preset = "smoke_wide"
rows = 128
cols = 128
pixel = "144 um"

[population]
candidates = 2000

[ground.astrometry]
lost_in_space = "never"

[output]
keep_frames_every = 1
"""


def tiny(folder: Path, extra: str = "") -> Path:
    """The scenario file in a folder."""
    path = folder / "tiny.toml"
    path.write_text(TINY + extra)
    return path


def request(path: Path, out: Path, *overrides: str, resume: bool = False, workers: int = 1, force: bool = False) -> RunRequest:
    """A run of a scenario file."""
    resolved = scenario.load(str(path), registry=Registry(), overrides=overrides)
    return RunRequest(scenario=resolved, out=out, resume=resume, workers=workers, force=force)


def products_only(asked: RunRequest) -> Run:
    """The chain without score and report."""
    directory = RunDirectory(path=asked.out)
    directory.prepare(resume=False, force=False)
    manifest = Manifest.of(directory.manifest, asked.scenario)
    made = Run(directory=directory, manifest=manifest, scenario=asked.scenario, workers=asked.workers)
    made.simulate_and_onboard()
    made.ground()
    return made


def digest(run_dir: Path, *folders: str) -> dict[str, str]:
    """SHA-256 of the downlink and of everything in products/ (and in other folders)."""
    paths = [run_dir / "downlink.bin"]
    for folder in ("products", *folders):
        paths += sorted(p for p in (run_dir / folder).rglob("*") if p.is_file())
    return {str(p.relative_to(run_dir)): hashlib.sha256(p.read_bytes()).hexdigest() for p in paths}


def command(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """`sboc` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "sboc_e2e", *arguments],
        env=os.environ | environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """An undisturbed run of the tiny scenario with one process; tests must not change it."""
    folder = tmp_path_factory.mktemp("finished")
    return run(request(tiny(folder), folder / "run"))
