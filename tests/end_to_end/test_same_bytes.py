"""The same scenario and seed give the same bytes: with more workers, another hash seed, and after being killed."""

from pathlib import Path

import pytest

from sboc_e2e.run import run
from sboc_e2e.run.pipeline import Run
from tests.end_to_end.conftest import command, digest, request, tiny
from tests.processes import Nursery, nursery, points

SBOC = "tests.end_to_end.killed_runs:quick"
FEWER_DRAWS = "products/population.ecsv"
"""The only bytes in which quick runs differ from ordinary ones."""


@pytest.mark.slow
def test_two_workers_give_the_same_bytes_as_one(finished: Run, tmp_path: Path) -> None:
    expected = digest(finished.directory.path, "truth", "frames", "calibration")
    done = command("run", str(tiny(tmp_path)), "--out", str(tmp_path / "two"), "--workers", "2", PYTHONHASHSEED="77")
    assert done.returncode == 0, done.stderr
    assert digest(tmp_path / "two", "truth", "frames", "calibration") == expected


def check_kills(finished: Run, folder: Path, processes: Nursery, *, kills: int, workers: int) -> None:
    """Kill runs at random changes of their files and resume them, by one process."""
    undisturbed = [*arguments(folder, "undisturbed"), "--workers", str(workers)]
    changes = processes.call(SBOC, undisturbed).changes
    expected = digest(folder / "undisturbed", "truth", "frames", "calibration")
    ordinary = digest(finished.directory.path, "truth", "frames", "calibration")
    assert {name for name in expected | ordinary if expected.get(name) != ordinary.get(name)} == {FEWER_DRAWS}
    for kill_at in points(changes, kills, seed=20):
        asked, out = arguments(folder, f"killed-{kill_at}"), folder / f"killed-{kill_at}"
        assert processes.call(SBOC, [*asked, "--workers", str(workers)], kill_at=kill_at).killed
        if (out / "manifest.json").exists():
            assert not processes.call(SBOC, [*asked, "--resume", "--workers", "1"]).killed
            assert digest(out, "truth", "frames", "calibration") == expected, kill_at
            assert not list(out.rglob("*.part"))
            assert not (out / ".work").exists()


def arguments(folder: Path, name: str) -> list[str]:
    return ["run", str(folder / "tiny.toml"), "--out", str(folder / name)]


@pytest.mark.slow
def test_a_run_killed_at_twenty_points_ends_with_the_same_bytes(finished: Run, tmp_path: Path) -> None:
    """Most with one process: with two, each run starts others that have to import everything."""
    tiny(tmp_path)
    (tmp_path / "two").mkdir()
    tiny(tmp_path / "two")
    with nursery() as processes:
        processes.call(SBOC, arguments(tmp_path, "warm"), fork=False)
        check_kills(finished, tmp_path, processes, kills=16, workers=1)
        check_kills(finished, tmp_path / "two", processes, kills=4, workers=2)


@pytest.mark.slow
def test_a_run_that_stops_after_any_frame_goes_on_there(finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stops in this process, at every frame boundary, instead of where a signal happens to fall."""
    from sboc_e2e.report import plots
    from sboc_e2e.run import onboard_stage

    monkeypatch.setattr(plots, "svg", lambda _: "<svg></svg>")  # the report is not compared
    expected = digest(finished.directory.path, "truth", "frames")
    scenario_file = tiny(tmp_path)
    original = onboard_stage.write_bytes
    for last in range(4):
        out = tmp_path / f"stopped-{last}"

        def stop(path: Path, data: bytes, last: int = last) -> None:
            original(path, data)
            if path.name == f"{last:06d}.bin":
                raise KeyboardInterrupt

        monkeypatch.setattr(onboard_stage, "write_bytes", stop)
        with pytest.raises(KeyboardInterrupt):
            run(request(scenario_file, out))
        monkeypatch.setattr(onboard_stage, "write_bytes", original)
        run(request(scenario_file, out, resume=True))
        assert digest(out, "truth", "frames") == expected
