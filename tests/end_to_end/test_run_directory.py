"""A run from scenario to report: files, contents, isolation of ground, stages by themselves, and what is refused."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import cli, provenance, scenario
from sboc_e2e.files import frame_fits
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.run import RunDirectory, run
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.run.manifest import VERSIONED
from sboc_e2e.run.pipeline import Run
from sboc_e2e.run.workers import simulation_processes, worker_count
from sboc_e2e.truth import TABLES
from tests.end_to_end.conftest import command, digest, request, tiny

PRODUCTS = ("frames.ecsv", "stars.ecsv", "streaks.ecsv", "tracklets.ecsv", "orbits.ecsv", "ingest.json")
STREAK_COLUMNS = [
    "frame",
    "streak_id",
    "row0",
    "col0",
    "row1",
    "col1",
    "row_mid",
    "col_mid",
    "length_px",
    "angle_deg",
    "flux_e",
    "flux_err_e",
    "snr",
    "ra_mid_deg",
    "dec_mid_deg",
    "sigma_along_arcsec",
    "sigma_cross_arcsec",
    "t_mid_utc",
    "mag",
    "mag_err",
    "tracklet_id",
    "flags",
]


@pytest.fixture
def copy(finished: Run, tmp_path: Path) -> Path:
    """A copy of the finished run that a test may change."""
    return Path(shutil.copytree(finished.directory.path, tmp_path / "run"))


def test_few_pixels_are_simulated_by_one_process_unless_asked_otherwise(tmp_path: Path) -> None:
    few = scenario.load(str(tiny(tmp_path)), registry=Registry())
    many = scenario.load("sso_antisun", registry=Registry())
    assert simulation_processes(0, few) == 1
    assert simulation_processes(3, few) == simulation_processes(3, many) == 3
    assert simulation_processes(0, many) == worker_count(0) == len(os.sched_getaffinity(0))
    with pytest.raises(UserError, match="--workers: expected 0"):
        simulation_processes(-1, few)


def test_a_run_leaves_the_documented_files_and_nothing_else(finished: Run) -> None:
    path = finished.directory.path
    assert {p.name for p in path.iterdir()} == {
        "manifest.json", "calibration", "frames", "truth", "downlink.bin", "products", "score.json", "report.html", "report.md",
    }  # fmt: skip
    assert set(PRODUCTS) <= {p.name for p in (path / "products").iterdir()}
    assert {p.stem for p in (path / "truth").glob("*.ecsv")} == set(TABLES)
    assert len(list((path / "frames").glob("*.fits"))) == 4


def test_tables_have_the_documented_columns_with_units(finished: Run) -> None:
    streaks = Table.read(finished.directory.products / "streaks.ecsv", format="ascii.ecsv")
    assert set(STREAK_COLUMNS) <= set(streaks.colnames)
    assert str(streaks["row0"].unit) == "pix"
    for name, columns in TABLES.items():
        table = Table.read(finished.directory.truth / f"{name}.ecsv", format="ascii.ecsv")
        assert table.colnames == [c.name for c in columns]
    frames = Table.read(finished.directory.truth / "frames.ecsv", format="ascii.ecsv")
    assert list(frames["frame"]) == [0, 1, 2, 3]


def test_the_manifest_says_what_was_run(finished: Run) -> None:
    manifest = json.loads(finished.directory.manifest.read_text())
    assert {stage: record["state"] for stage, record in manifest["stages"].items()} == dict.fromkeys(
        ("simulate", "onboard", "ground", "score", "report"), "done"
    )
    assert manifest["components"]["onboard.detector"]["use"] == "line_integral"
    assert manifest["scenario"]["document"]["shutter"]["exposure"] == "0.2 s"
    assert manifest["versions"]["numpy"] == np.__version__
    for stage in ("simulate", "onboard", "ground"):
        assert manifest["stages"][stage]["cpu_s"] > 0
        assert 0 < manifest["stages"][stage]["median_frame_cpu_s"] <= manifest["stages"][stage]["cpu_s"]


def test_a_kept_frame_gives_its_header_back(finished: Run) -> None:
    frame = frame_fits.read(finished.directory.frame_file(2))
    assert frame.pixels.dtype == np.uint16
    assert frame.header.frame == 2
    assert frame.header.attitude is not None
    with fits.open(finished.directory.frame_file(2)) as hdus:
        assert hdus[0].header["DATE-OBS"].startswith("2027-01-29T00:00:00.5")
        assert hdus[0].header["EXPTIME"] == 0.2
        assert "CRVAL1" not in hdus[0].header


def test_ground_needs_nothing_but_downlink_calibration_and_catalogue(finished: Run, copy: Path) -> None:
    expected = digest(copy)
    for gone in ("truth", "frames", "products"):
        shutil.rmtree(copy / gone)
    for gone in ("manifest.json", "score.json", "report.html", "report.md"):
        (copy / gone).unlink()
    directory = finished.directory.__class__(path=copy)
    manifest = finished.manifest.__class__.of(directory.manifest, finished.scenario)
    Run(directory=directory, manifest=manifest, scenario=finished.scenario, workers=1).ground()
    assert digest(copy) == expected


@pytest.mark.slow
def test_stages_one_by_one_give_the_same_bytes(copy: Path) -> None:
    expected = digest(copy, "truth", "frames", "calibration")
    opened = Run.open(copy, Registry())
    opened.simulate()
    opened.onboard()
    opened.ground()
    assert digest(copy, "truth", "frames", "calibration") == expected
    assert not (copy / ".work").exists()


def test_a_stage_whose_inputs_were_not_kept_names_the_key(copy: Path) -> None:
    (copy / "frames" / "000001.fits").unlink()
    with pytest.raises(UserError, match=r"not kept; .*: sboc run SCENARIO --out .* --force --set output.keep"):
        Run.open(copy, Registry()).onboard()


def test_a_run_is_not_replaced_by_accident(copy: Path, tmp_path: Path) -> None:
    scenario_file = tiny(tmp_path)
    with pytest.raises(UserError, match="--resume goes on with it, --force replaces it"):
        run(request(scenario_file, copy))
    with pytest.raises(UserError, match=r"belongs to another run \(document.seed was 5 and is 6\)"):
        run(request(scenario_file, copy, "seed=6", resume=True))
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.txt").write_text("years of work")
    with pytest.raises(UserError, match="holds no run"):
        run(request(scenario_file, other, force=True))
    assert (other / "chapter.txt").read_text() == "years of work"
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is a file"):
        run(request(scenario_file, tmp_path / "file"))


def test_resuming_a_finished_run_does_nothing(copy: Path, tmp_path: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in copy.rglob("*") if p.is_file()}
    run(request(tiny(tmp_path), copy, resume=True))
    assert {p: p.stat().st_mtime_ns for p in copy.rglob("*") if p.is_file()} == before


def test_damaged_files_of_a_run_are_one_line(copy: Path) -> None:
    (copy / "calibration" / "dark.fits").write_bytes(b"no FITS")
    with pytest.raises(UserError, match=r"dark.fits: missing or damaged calibration map"):
        Run.open(copy, Registry()).ground()
    (copy / "frames" / "000000.fits").write_bytes(b"no FITS")
    with pytest.raises(UserError, match=r"dark.fits|000000.fits: not a frame of a run"):
        Run.open(copy, Registry()).onboard()
    (copy / "downlink.bin").unlink()
    (copy / "calibration" / "camera.json").write_text("{}")
    with pytest.raises(UserError, match=r"camera.json: not a camera file"):
        Run.open(copy, Registry()).ground()
    whole = json.loads((copy / "manifest.json").read_text())
    for damaged in ("{", "[]", json.dumps(whole | {"scenario": {}}), json.dumps(whole | {"stages": {"ground": 1}})):
        (copy / "manifest.json").write_text(damaged)
        with pytest.raises(UserError, match=r"manifest.json: not a manifest of this program"):
            Run.open(copy, Registry())


@pytest.mark.parametrize("name", ["truth/streaks.ecsv", "truth/objects.ecsv", "products/streaks.ecsv", "products/frames.ecsv"])
def test_a_table_that_is_cut_short_is_one_line(copy: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = (copy / name).read_bytes()
    rows = text.index(b"schema")
    for end in (0, rows // 2, rows, len(text) - len(text.rstrip().rpartition(b" ")[2]) - 2):
        (copy / name).write_bytes(text[:end])
        assert cli.run(["score", str(copy)]) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
        assert f"{copy / name}: " in line


def test_each_stage_says_by_which_code_it_was_made_and_other_code_does_not_go_on_with_it(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    before = json.loads((copy / "manifest.json").read_text())["stages"]
    assert before["ground"]["made_by"]["code"] == provenance.code_digest("ground")
    assert before["ground"]["made_by"]["versions"]["numpy"] == np.__version__
    expected = digest(copy)
    with monkeypatch.context() as patch:
        patch.setattr(provenance, "code_digest", lambda stage: f"edited {stage}")
        patch.setattr(provenance, "commit", lambda: "later")
        assert cli.run(["ground", str(copy)]) == 0
    after = json.loads((copy / "manifest.json").read_text())["stages"]
    assert after["simulate"] == before["simulate"]
    assert (after["ground"]["made_by"]["code"], after["ground"]["made_by"]["commit"]) == ("edited ground", "later")
    with pytest.raises(UserError, match=r"another run \(stages.ground.code was 'edited ground'"):
        run(request(tiny(tmp_path), copy, resume=True))
    # An interrupted attempt by the edited code, with a state that the present one could not go on from.
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["stages"]["ground"]["state"] = "running"
    (copy / "manifest.json").write_text(json.dumps(manifest))
    (copy / ".work" / "ground").mkdir(parents=True)
    (copy / ".work" / "ground" / "000002.state").write_bytes(b"of other code")
    capfd.readouterr()
    assert cli.run(["ground", str(copy)]) == 0
    assert (
        "stage ground begins anew; an attempt by other code was interrupted (code was 'edited ground'" in capfd.readouterr().err
    )
    assert digest(copy) == expected


def test_calibration_of_other_code_is_made_again_with_the_frames(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The manifest would say that this code made it."""
    dark = copy / "calibration" / "dark.fits"
    made = dark.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(provenance, "code_digest", lambda stage: f"edited {stage}")
        assert cli.run(["simulate", str(copy)]) == 0
    with fits.open(dark, mode="update") as hdus:
        hdus[0].data += 50  # as the edited code would have made it
    assert cli.run(["simulate", str(copy)]) == 0
    assert dark.read_bytes() == made
    dark.write_bytes(made[:-2880] + bytes(2880))
    other = dark.read_bytes()
    assert cli.run(["simulate", str(copy)]) == 0
    assert dark.read_bytes() == other, "of the same code it stays as it is"


def test_frames_of_other_code_do_not_count_once_their_calibration_is_being_replaced(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Interrupted there, the manifest said that the frames were done, and `sboc onboard` took them with maps of the new code."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(provenance, "code_digest", lambda stage: f"edited {stage}")
        patch.setattr("sboc_e2e.run.pipeline.calibration_files.write", interrupted)
        assert cli.run(["simulate", str(copy)]) == 2
    assert json.loads((copy / "manifest.json").read_text())["stages"] == {}
    assert cli.run(["onboard", str(copy)]) == 2
    assert "stage simulate is not done" in capfd.readouterr().err


def test_a_run_that_is_begun_over_another_has_a_calibration_of_its_own(tmp_path: Path) -> None:
    """Campaigns and comparisons go on in a folder, and begin anew over a run of another scenario: its maps must not stay."""
    for seed in (1, 2):
        wanted = scenario.load(str(tiny(tmp_path)), registry=Registry(), seed=seed)
        begin_or_continue(tmp_path / "over", wanted, workers=1).simulate()
    begin_or_continue(tmp_path / "new", wanted, workers=1).simulate()
    for name in ("dark.fits", "flat.fits", "defects.fits", "camera.json"):
        assert (tmp_path / "over" / "calibration" / name).read_bytes() == (tmp_path / "new" / "calibration" / name).read_bytes()


def test_libraries_that_decide_bytes_have_their_versions_in_the_manifest() -> None:
    """Every library that the three segments import, but those of the object catalogue and of pictures."""
    distributions = {"cv2": "opencv-contrib-python-headless", "erfa": "pyerfa", "skimage": "scikit-image"}
    others = {"matplotlib", "pyarrow", "satkit", "sqlalchemy"}
    root = Path(provenance.ROOT)
    found = {"sep"}  # of `sboc process`
    for segment in provenance.SEGMENTS:
        for path in (root / segment).rglob("*.py"):
            found |= provenance._imports(path)
    foreign = found - set(sys.stdlib_module_names) - {"sboc_e2e", *provenance.SEGMENTS} - others
    assert {distributions.get(name, name).replace("_", "-") for name in foreign} <= {*VERSIONED}
    assert {"sgp4", "photutils", "scikit-image", "pyerfa", "sep", "tetra3rs"} <= {*VERSIONED}


def test_a_run_is_replaced_where_it_lies(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The working folder and the target of a link stay; what a link inside points to is not touched."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept").write_text("kept")
    (copy / "link").symlink_to(elsewhere)
    monkeypatch.chdir(copy)
    RunDirectory(path=Path()).prepare(resume=False, force=True)
    assert list(copy.iterdir()) == []
    assert (elsewhere / "kept").read_text() == "kept"
    (copy / "manifest.json").write_text("{}")
    (tmp_path / "linked").symlink_to(copy)
    RunDirectory(path=tmp_path / "linked").prepare(resume=False, force=True)
    assert (tmp_path / "linked").is_symlink()
    assert list(copy.iterdir()) == []


def test_calibration_files_that_are_missing_or_damaged_are_made_again(copy: Path) -> None:
    expected = digest(copy, "calibration", "truth")
    (copy / "calibration" / "flat.fits").unlink()
    (copy / "calibration" / "dark.fits").write_bytes(b"no FITS")
    assert cli.run(["simulate", str(copy), "--workers", "1"]) == 0
    assert digest(copy, "calibration", "truth") == expected


def test_no_disk_space_is_said_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"needs about .* MB, .* MB are free"):
        run(request(tiny(tmp_path), tmp_path / "run", "frames=1000000", "instrument.rows=16384", "instrument.cols=16384"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nonsuch"], 'there is no scenario "nonsuch"'),
        (["run", "smoke", "--set", "sed=1"], 'unknown key "sed"'),
        (["run", "smoke", "--use", "nose=x"], "--use: expected SEAM=NAME"),
        (["run", "smoke", "--workers", "-1", "--out", "x"], "--workers: expected 0"),
        (["run", "smoke", "--colour"], "No such option"),
        (["ground", "/nonexistent"], "holds no run"),
        (["process", "/nonexistent", "--out", "/nonexistent/out"], "no such folder of FITS files"),
        (["process", "/nonexistent", "--out", "x", "--wcs", "maybe"], "expected one of header, solve, none"),
        (["nonsuch"], "No such command"),
    ],
)
def test_the_command_line_answers_mistakes_with_one_line_and_code_2(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(arguments) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert list(tmp_path.iterdir()) == []
    assert lines[0].startswith("sboc: ")
    assert words in lines[0]


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_folder_without_permission_is_one_line(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    done = command("run", str(tiny(tmp_path)), "--out", str(locked / "run"))
    assert done.returncode == 2
    assert "Permission denied; choose an --out that can be written" in done.stderr
