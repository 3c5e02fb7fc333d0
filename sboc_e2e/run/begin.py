"""A run directory for a scenario, continued when it holds the same run: for comparisons and campaigns."""

from pathlib import Path

from sboc_e2e.run.decoders import require_decoder
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.ground_stage import require_files
from sboc_e2e.run.manifest import Manifest
from sboc_e2e.run.pipeline import Run
from sboc_e2e.run.progress import Progress, Silent
from sboc_e2e.run.workers import simulation_processes
from sboc_e2e.scenario import Scenario


def begin_or_continue(
    path: Path, scenario: Scenario, *, keyed: bool = False, workers: int = 0, progress: Progress | None = None
) -> Run:
    """The run at `path`; stages that an earlier attempt of the same scenario and versions finished count as done.

    keyed : the folder's name is a digest of everything that determines its content. An earlier run in it is then always used.
    """
    require_files(scenario)
    require_decoder(scenario)
    directory = RunDirectory(path=path)
    wanted = Manifest.of(directory.manifest, scenario)
    manifest = wanted
    if directory.manifest.is_file():
        found = Manifest.read(directory.manifest)
        if keyed or found.difference(wanted) is None:
            manifest = found
    path.mkdir(parents=True, exist_ok=True)
    manifest.save()
    return Run(
        directory=directory,
        manifest=manifest,
        scenario=scenario,
        workers=simulation_processes(workers, scenario),
        progress=progress or Silent(),
        present=wanted,
    )
