"""Exit codes of the command line where output has no reader, and where a path is of the wrong kind."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from sboc_e2e import cli
from sboc_e2e.outside import make_camera
from tests.element_lines import with_checksums

SBOC = f'"{sys.executable}" -m sboc_e2e'
ELEMENTS = with_checksums(
    "\n".join(
        f"1 2554{k}U 98067A   22022.50000000  .00000000  00000-0  00000-0 0  9990\n"
        f"2 2554{k}  51.6400 1{k}0.0000 0005000  90.0000 270.0000 15.49000000    10"
        for k in (4, 5)
    )
)


def shell(line: str, folder: Path) -> list[str]:
    """The words that a line of bash prints."""
    environment = os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[2])}
    done = subprocess.run(["bash", "-c", line], capture_output=True, check=False, text=True, cwd=folder, env=environment)
    assert "Traceback" not in done.stderr
    return done.stdout.split()


def test_a_reader_that_has_enough_is_no_failed_check(tmp_path: Path) -> None:
    assert shell(f'{SBOC} scenarios | true; echo "${{PIPESTATUS[0]}}"', tmp_path) == ["0"]
    assert list(tmp_path.iterdir()) == []


def test_a_closed_standard_error_leaves_the_exit_code(tmp_path: Path) -> None:
    """Python has no stream then."""
    assert shell(f"{SBOC} run nonsense 2>&-; echo $?", tmp_path) == ["2"]
    assert shell(f"{SBOC} run smoke --nonsense 2>&-; echo $?", tmp_path) == ["2"]
    code = "from sboc_e2e.cli.progress import make_progress; make_progress().note('one')"
    assert shell(f'"{sys.executable}" -c "{code}" 2>&-; echo $?', tmp_path) == ["0"]


def test_a_pipe_that_breaks_within_the_program_is_an_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as that to a process which has ended too early."""

    def broken(**_: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.modules["sboc_e2e.cli.main"], "app", broken)
    assert cli.run(["scenarios"]) == 3
    assert "Broken pipe" in capsys.readouterr().err


def made(*_: object, **__: object) -> make_camera.MadeCamera:
    return make_camera.MadeCamera(
        rows=64, cols=64, psf_sigma_px=None, transfer=None, saturation_adu=None, focal_px=None, scale_from=""
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["figure", "7", "--out", "FILE"], "FILE: File exists; a folder is needed there"),
        (["figure", "7", "--out", "FILE/below"], "FILE/below: Not a directory; choose an --out below a folder"),
        (["conjunctions", "screen", "ELEMENTS", "--start", "2022-01-22T00:00:00", "--days", "0.01", "--out", "FOLDER"],
         "FOLDER: Is a directory; a file is needed there"),
        (["camera", "make", "FILE", "--out", "FOLDER"], "FOLDER: Is a directory; a file is needed there"),
    ],
)  # fmt: skip
def test_an_out_of_the_wrong_kind_is_one_line(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(make_camera, "made_camera", made)
    (tmp_path / "FOLDER").mkdir()
    (tmp_path / "FILE").write_text("a file")
    (tmp_path / "ELEMENTS").write_text(ELEMENTS)
    assert cli.run(arguments) == 2
    assert f"sboc: {words}" in capsys.readouterr().err
    assert (tmp_path / "FILE").read_text() == "a file"
    assert not list((tmp_path / "FOLDER").iterdir())


def test_an_interrupted_command_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The parser turns the exception of Ctrl-C into a code of its own, 130, without a word."""

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sboc_e2e.scenario.available", interrupted)
    assert cli.run(["scenarios"]) == 2
    assert capsys.readouterr().err == "sboc: interrupted\n", "it has no --resume"
    monkeypatch.setattr("sboc_e2e.scenario.load", interrupted)
    assert cli.run(["run", "smoke", "--out", "none"]) == 2
    assert capsys.readouterr().err == "sboc: interrupted; --resume goes on after the last complete frame\n"


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fits.PrimaryHDU(np.random.default_rng(1).normal(100.0, 3.0, (40, 40))).writeto(tmp_path / "a.fits")
    assert cli.run(["process", str(tmp_path / "a.fits"), "--out", "/proc/none"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "sboc: /proc/none: cannot be made; choose another --out"


def test_a_command_names_only_options_that_it_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fits.PrimaryHDU(np.random.default_rng(1).normal(100.0, 3.0, (40, 40))).writeto(tmp_path / "a.fits")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "manifest.json").write_text("{}")
    assert cli.run(["process", str(tmp_path / "a.fits"), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"sboc: {tmp_path / 'out'}: holds a run; --force replaces it"
