"""The same scenario and seed give the same bytes: with more workers, another hash seed, and after being killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.run import run
from sboc_e2e.run.pipeline import Run
from tests.end_to_end.conftest import command, digest, request, tiny
from tests.processes import wait_for


@pytest.mark.slow
def test_two_workers_give_the_same_bytes_as_one(finished: Run, tmp_path: Path) -> None:
    expected = digest(finished.directory.path, "truth", "frames", "calibration")
    done = command("run", str(tiny(tmp_path)), "--out", str(tmp_path / "two"), "--workers", "2", PYTHONHASHSEED="77")
    assert done.returncode == 0, done.stderr
    assert digest(tmp_path / "two", "truth", "frames", "calibration") == expected


def killed_and_resumed(scenario_file: Path, out: Path, delay_s: float, extra: tuple[str, ...] = ()) -> bool:
    """Kill a run after a while and resume it; whether it was still running when killed."""
    arguments = [sys.executable, "-m", "sboc_e2e", "run", str(scenario_file), "--out", str(out), *extra]
    process = subprocess.Popen(arguments, stderr=subprocess.DEVNULL, start_new_session=True)
    wait_for(out / "manifest.json", process)
    time.sleep(delay_s)
    running = process.poll() is None
    if running:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if not (out / "manifest.json").exists():
        return running
    done = subprocess.run([*arguments, "--resume"], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return running


def check_kills(finished: Run, folder: Path, delays_s: list[float], workers: int) -> None:
    expected = digest(finished.directory.path, "truth", "frames", "calibration")
    scenario_file = tiny(folder)
    interrupted = 0
    for number, delay_s in enumerate(delays_s):
        out = folder / f"killed-{number}"
        interrupted += killed_and_resumed(scenario_file, out, delay_s, ("--workers", str(workers)))
        assert digest(out, "truth", "frames", "calibration") == expected
        assert not list(out.rglob("*.part"))
        assert not (out / ".work").exists()
    assert interrupted > 0


@pytest.mark.slow
def test_a_run_killed_at_twenty_points_ends_with_the_same_bytes(finished: Run, tmp_path: Path) -> None:
    delays_s = np.random.default_rng(20).uniform(0.0, 3.5, size=20)
    check_kills(finished, tmp_path, delays_s[:10].tolist(), workers=1)
    (tmp_path / "two").mkdir()
    check_kills(finished, tmp_path / "two", delays_s[10:].tolist(), workers=2)


@pytest.mark.slow
def test_a_run_that_stops_after_any_frame_goes_on_there(finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stops in this process, at every frame boundary, instead of where a signal happens to fall."""
    from sboc_e2e.run import onboard_stage

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
