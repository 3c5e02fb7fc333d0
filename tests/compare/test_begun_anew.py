"""What `--force` of a comparison forgets: its own runs, and nothing else in the folder."""

from pathlib import Path

from sboc_e2e import scenario
from sboc_e2e.registry import Registry
from sboc_e2e.run import shared as shared_runs
from sboc_e2e.run.shared import SharedRuns
from tests.end_to_end.conftest import digest, tiny

OWN = (
    "frames/0123456789abcdef/manifest.json",
    "frames/0123456789abcdef/frames/000000.fits",
    "downlinks/00112233445566ff/downlink.bin",
    "downlinks/00112233445566ff/stage.json",
    "runs/fedcba9876543210/manifest.json",
    "runs/fedcba9876543210/manifest.json.7.part",
)
STRANGERS = (
    "frames/000000.fits",
    "frames/2026-03-01/light.fits",
    "downlinks/pass-7/downlink.bin",
    "downlinks/0123456789abcdef/thesis.tex",
    "runs/smoke/manifest.json",
    "runs/compare-smoke/runs/0123456789abcdef/manifest.json",
    "runs/0123456789abcdeF/manifest.json",
    "runs/0123456789abcdee",
)
"""As in a folder of work where a user says ``--out .``."""


def test_only_what_comparisons_made_is_forgotten(tmp_path: Path) -> None:
    for name in (*OWN, *STRANGERS):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "runs" / "bbbbbbbbbbbbbbbb").mkdir()
    SharedRuns(out=tmp_path).clear()
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == set(STRANGERS)
    assert not (tmp_path / "runs" / "bbbbbbbbbbbbbbbb").exists()
    assert not (tmp_path / "frames" / "0123456789abcdef").exists()


def test_links_follow_a_folder_that_is_moved_and_dead_ones_are_made_again(tmp_path: Path) -> None:
    """Links were absolute, and a comparison that was moved could not be run again."""
    shared, run = tmp_path / "out" / "frames" / "a", tmp_path / "out" / "runs" / "b"
    shared.mkdir(parents=True)
    run.mkdir(parents=True)
    (shared / "0.fits").write_text("pixels")
    shared_runs._link(shared, run / "frames")
    (tmp_path / "out").rename(tmp_path / "moved")
    moved = tmp_path / "moved"
    assert (moved / "runs" / "b" / "frames" / "0.fits").read_text() == "pixels"
    dead = moved / "runs" / "b" / "dead"
    dead.symlink_to(tmp_path / "out" / "frames" / "a")
    shared_runs._link(moved / "frames" / "a", dead)
    assert (dead / "0.fits").read_text() == "pixels"


def test_a_finished_run_whose_links_lead_nowhere_gets_them_again(tmp_path: Path) -> None:
    """A comparison with absolute links, of an earlier state, was moved: its runs were done, without truth to judge them by."""
    wanted = scenario.load(str(tiny(tmp_path)), registry=Registry(), overrides=("output.keep_frames_every=1",))
    made = SharedRuns(out=tmp_path / "old", workers=1).ground(wanted)
    products = digest(made.directory.path)
    for name in shared_runs.LINKED:
        link = made.directory.path / name
        there = link.resolve()
        link.unlink()
        link.symlink_to(there)
    (tmp_path / "old").rename(tmp_path / "moved")
    again = SharedRuns(out=tmp_path / "moved", workers=1).ground(wanted)
    assert digest(again.directory.path) == products
    assert again.evaluation().n_frames == again.manifest.n_frames
    for name in shared_runs.LINKED:
        assert not (again.directory.path / name).readlink().is_absolute()
