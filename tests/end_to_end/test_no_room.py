"""Disk full, read-only and locked folders: one line, exit code 2, earlier results intact, nothing half-written."""

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import pytest

from sboc_e2e import cli
from sboc_e2e.bench import run_bench
from sboc_e2e.campaign import engine, read_campaign
from sboc_e2e.campaign.worker import Outcome
from sboc_e2e.files import atomic
from sboc_e2e.run import RunDirectory, onboard_stage, states
from sboc_e2e.run.pipeline import Run
from tests.end_to_end.conftest import command, digest, tiny


class _Full:
    """A file on a disk that has no more room."""

    def __init__(self, stream: IO[bytes], disk: "Disk") -> None:
        self._stream, self._disk = stream, disk

    def __enter__(self) -> "_Full":
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def write(self, data: bytes) -> int:
        room = self._disk.room
        self._disk.room -= len(data)
        if len(data) > room:
            self._stream.write(data[: max(room, 0)])
            raise OSError(self._disk.reason, os.strerror(self._disk.reason))
        return self._stream.write(data)


class Disk:
    """Lets this many bytes be written through `sboc_e2e.files.atomic`, then says no."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, room: int, reason: int = errno.ENOSPC) -> None:
        self.room, self.reason = room, reason
        original = Path.open

        def opened(path: Path, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
            stream = original(path, mode, *args, **kwargs)
            return _Full(stream, self) if path.name.endswith(atomic.TEMPORARY_SUFFIX) else stream  # type: ignore[arg-type]

        monkeypatch.setattr(Path, "open", opened)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str], words: str = "No space left on device; free space") -> None:
    """The command ends with code 2 and one line, which names a place."""
    capsys.readouterr()
    assert cli.run(arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
    assert words in line
    assert "/" in line.partition(words)[0]


def leftovers(folder: Path) -> list[Path]:
    return list(folder.rglob(f"*{atomic.TEMPORARY_SUFFIX}"))


@pytest.fixture
def copy(finished: Run, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished.directory.path, tmp_path / "copy"))


@pytest.mark.slow
@pytest.mark.parametrize("room", [30_000, 400_000])
def test_a_run_on_a_full_disk_goes_on_to_the_same_bytes(
    finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], room: int
) -> None:
    out = tmp_path / "run"
    arguments = ["run", str(tiny(tmp_path)), "--out", str(out), "--workers", "1"]
    with monkeypatch.context() as patch:
        Disk(patch, room)
        refused(arguments, capsys)
    assert leftovers(out) == []
    assert cli.run([*arguments, "--resume"] if (out / "manifest.json").exists() else arguments) == 0
    assert digest(out, "truth", "frames") == digest(finished.directory.path, "truth", "frames")


@pytest.mark.parametrize("again", [False, True], ids=["resumed", "simulated again"])
@pytest.mark.parametrize("where", ["join", "keep"])
def test_a_run_whose_downlink_did_not_fit_goes_on_to_the_same_bytes(
    finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], where: str, again: bool
) -> None:
    """The truth of its frames may be joined already: at the end of the simulation, or by `sboc simulate` in between."""
    out = tmp_path / "run"
    arguments = ["run", str(tiny(tmp_path)), "--out", str(out), "--workers", "1"]
    original = getattr(onboard_stage, where)

    def full(run: RunDirectory, position: int, *rest: Any) -> None:
        if where == "join" or position == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(run.downlink))
        original(run, position, *rest)

    monkeypatch.setattr(states, "WORK_PER_COST", 0.0)
    with monkeypatch.context() as patch:
        patch.setattr(onboard_stage, where, full)
        refused(arguments, capsys)
    if again:
        assert cli.run(["simulate", str(out), "--workers", "1"]) == 0
    assert cli.run([*arguments, "--resume"]) == 0
    assert digest(out, "truth", "frames", "calibration") == digest(finished.directory.path, "truth", "frames", "calibration")
    assert not (out / ".work").exists()


@pytest.mark.parametrize("stage", ["ground", "score", "report", "onboard"])
@pytest.mark.slow
def test_a_stage_on_a_full_disk_leaves_its_earlier_results(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], stage: str
) -> None:
    before = {path: path.read_bytes() for path in copy.rglob("*") if path.is_file() and path.name != "manifest.json"}
    with monkeypatch.context() as patch:
        Disk(patch, 2 * (copy / "manifest.json").stat().st_size + 500)
        refused([stage, str(copy)], capsys)
    assert leftovers(copy) == []
    assert {path: path.read_bytes() for path in before} == before
    assert json.loads((copy / "manifest.json").read_text())["stages"].get(stage, {}).get("state") != "done"
    assert cli.run([stage, str(copy)]) == 0


def test_processing_on_a_full_disk_leaves_nothing_half_written(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with monkeypatch.context() as patch:
        Disk(patch, 20_000)
        refused(["process", str(copy / "frames"), "--out", str(tmp_path / "out")], capsys)
    assert leftovers(tmp_path) == []
    assert not (tmp_path / "out" / "products").exists()


def test_a_mistake_in_the_command_costs_no_earlier_products(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Replacing begins after everything that can be checked is right."""
    before = digest(copy)
    frames = str(copy / "frames")
    for extra in (["--camera", "nonsuch"], ["--wcs", "maybe"], ["--set", "sed=1"]):
        assert cli.run(["process", frames, "--out", str(copy), "--force", *extra]) == 2
    (copy / "empty").mkdir()
    assert cli.run(["process", str(copy / "empty"), "--out", str(copy), "--force"]) == 2
    assert digest(copy) == before


@pytest.mark.slow
def test_a_comparison_on_a_full_disk_goes_on_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "versus"
    arguments = ["compare", str(tiny(tmp_path)), "--seam", "onboard.detector", "--use", "threshold", "--use", "difference"]
    arguments += ["--out", str(out), "--workers", "1"]
    with monkeypatch.context() as patch:
        Disk(patch, 250_000)
        refused(arguments, capsys)
    assert leftovers(out) == []
    assert not (out / "compare.json").exists()
    assert cli.run(arguments) == 0


def test_a_sweep_stops_when_its_disk_is_full_and_keeps_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny(tmp_path)
    (tmp_path / "campaign.toml").write_text(f'scenario = "{tmp_path / "tiny.toml"}"\nreplicas = 4\n')
    done = []

    def job(asked: Any) -> tuple[Outcome, ...]:
        if len(done) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), f"{asked.out}/shards/a.ecsv")
        done.append(asked.tasks[0].task.number)
        return tuple(Outcome(fingerprint=task.fingerprint, shard="a table") for task in asked.tasks)

    @contextmanager
    def executor(workers: int, scheduler: str | None, *, here: bool = False) -> Iterator[tuple[ThreadPoolExecutor, int]]:
        with ThreadPoolExecutor(1) as pool:
            yield pool, 1

    monkeypatch.setattr(engine, "run_job", job)
    monkeypatch.setattr(engine, "executor", executor)
    out = tmp_path / "sweep"
    refused(["sweep", str(tmp_path / "campaign.toml"), "--out", str(out)], capsys)
    assert len(list((out / "shards").glob("*.ecsv"))) == 2
    assert list((out / "failed").iterdir()) == []
    assert len(read_campaign(tmp_path / "campaign.toml").tasks()) == 4


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        (errno.EROFS, "Read-only file system; choose an --out that can be written"),
        (errno.EACCES, "Permission denied; choose an --out that can be written"),
        (errno.EFBIG, "File too large; allow larger files (ulimit -f)"),
    ],
)
@pytest.mark.parametrize("kind", ["run", "process", "sweep", "compare", "bench"])
@pytest.mark.slow
def test_a_place_that_cannot_be_written_is_found_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kind: str, reason: int, words: str
) -> None:
    scenario, out = str(tiny(tmp_path)), str(tmp_path / "out")
    (tmp_path / "campaign.toml").write_text(f'scenario = "{scenario}"\n')
    arguments = {
        "run": ["run", scenario],
        "process": ["process", str(_frame(tmp_path))],
        "sweep": ["sweep", str(tmp_path / "campaign.toml")],
        "compare": ["compare", scenario, "--seam", "onboard.detector", "--use", "threshold", "--use", "lsd"],
        "bench": ["bench", "--quick"],
    }[kind]

    def no_replace(path: Path, target: object) -> None:
        raise OSError(reason, os.strerror(reason), str(path))

    monkeypatch.setattr(Path, "replace", no_replace)
    monkeypatch.setattr(engine, "executor", None)
    monkeypatch.setattr(sys.modules[run_bench.__module__], "_child", None)
    refused([*arguments, "--out", out], capsys, words)
    assert [path for path in Path(out).rglob("*") if path.is_file()] == []


def _frame(folder: Path) -> Path:
    import numpy as np
    from astropy.io import fits

    path = folder / "frame.fits"
    fits.PrimaryHDU(np.random.default_rng(1).normal(100, 3, (64, 64)).astype(np.uint16)).writeto(path)
    return path


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("mount") is None, reason="only the superuser can mount a small disk")
def test_a_real_full_disk_and_a_real_read_only_one(tmp_path: Path) -> None:
    disk, scenario = tmp_path / "disk", tiny(tmp_path)
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)], capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip("this machine does not let the superuser mount a small disk")
    try:
        (disk / "ballast").write_bytes(bytes(700_000))
        full = command("run", str(scenario), "--out", str(disk / "run"))
        assert full.returncode == 2
        assert full.stderr.splitlines()[-1].startswith("sboc: ")
        assert "free" in full.stderr.splitlines()[-1]
        assert leftovers(disk) == []
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        for arguments in (["run", str(scenario), "--out"], ["process", str(_frame(tmp_path)), "--out"]):
            locked = command(*arguments, str(disk / "new"))
            assert locked.returncode == 2
            assert "Read-only file system; choose an --out that can be written" in locked.stderr.splitlines()[-1]
    finally:
        subprocess.run(["umount", str(disk)], check=True)
