"""`sboc process` and `sboc score --truth` over frames and annotations in SatSim's layout, and over tables."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e import cli
from tests.end_to_end import satsim_frames


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of three frames with two satellites in each."""
    return satsim_frames.write(tmp_path_factory.mktemp("satsim"))


@pytest.fixture(scope="module")
def processed(frames: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its products; tests must not change them."""
    out = tmp_path_factory.mktemp("processed") / "run"
    assert cli.run(["process", str(frames / "ImageFiles"), "--out", str(out)]) == 0
    return out


@pytest.fixture
def copy(processed: Path, tmp_path: Path) -> Path:
    """Products that a test may change."""
    return Path(shutil.copytree(processed, tmp_path / "run"))


def scored(run: Path, truth: Path) -> dict[str, dict[str, dict[str, float]]]:
    assert cli.run(["score", str(run), "--truth", str(truth)]) == 0
    found: dict[str, dict[str, dict[str, float]]] = json.loads((run / "score.json").read_text())
    return found


def table_of_ends() -> Table:
    rows = [(f"sat {s}", n, *satsim_frames.ends(n, s)) for n in range(3) for s in range(2)]
    return Table(rows=rows, names=["object", "frame", "row0", "col0", "row1", "col1"])


def test_satsim_frames_are_scored_against_their_annotations(frames: Path, copy: Path) -> None:
    score = scored(copy, frames)
    ground, places = score["detection"]["ground"], score["astrometry"]
    assert (ground["n_truth"]["value"], ground["n_detected"]["value"], ground["false_per_frame"]["value"]) == (6, 6, 0)
    # Trails of 40 px at S/N 50 to 170: midpoints to a tenth of a pixel, which a shift by half a pixel would spoil fivefold.
    assert places["cross_rms_px"]["value"] < 0.15
    assert places["ends_rms_px"]["value"] < 0.4
    assert places["ends_attainable_ratio"]["value"] < 2.0
    assert score["photometry"]["rms_mag"]["value"] is None, "no zero point is known, so there is no magnitude to score"
    assert places["cross_rms_arcsec"]["value"] is None
    assert score["linking"]["n_objects"]["value"] == 2
    assert cli.run(["report", str(copy)]) == 0
    assert "NaN" not in (copy / "report.html").read_text().partition('id="data"')[2][:100_000]


def test_a_table_of_end_points_alone_is_truth(copy: Path, tmp_path: Path) -> None:
    table_of_ends().write(tmp_path / "truth.ecsv", format="ascii.ecsv")
    score = scored(copy, tmp_path / "truth.ecsv")
    ground = score["detection"]["ground"]
    assert (ground["n_truth"]["value"], ground["completeness"]["value"]) == (6, 1.0)
    assert ground["completeness_snr8"]["reason"] == "the truth gives neither S/N nor flux"
    assert score["astrometry"]["cross_rms_px"]["value"] < 0.15
    assert "no bounds" in score["astrometry"]["cross_crlb_ratio"]["reason"]  # type: ignore[operator]
    products = score["products"]
    assert "ra0_deg" in products["angles"]["cross_rms_arcsec"]["reason"]  # type: ignore[index]
    assert "products/*.oem" in products["observer"]["position_rms_m"]["reason"]  # type: ignore[index]
    for section in ("photometry", "orbit"):
        for name, figure in score[section].items():
            assert figure["value"] is None, name
            assert figure["reason"], name


def test_the_same_truth_by_file_name_gives_the_same_score(copy: Path, tmp_path: Path) -> None:
    table = table_of_ends()
    table.write(tmp_path / "numbers.ecsv", format="ascii.ecsv")
    table["file"] = [f"sat_00000.{n:04d}.fits" for n in table["frame"]]
    table.remove_column("frame")
    table.write(tmp_path / "files.csv", format="ascii.csv")
    one, other = scored(copy, tmp_path / "numbers.ecsv"), scored(copy, tmp_path / "files.csv")
    assert one == other


def test_what_is_not_there_is_missed_and_what_is_not_true_is_false(copy: Path, tmp_path: Path) -> None:
    table = table_of_ends()[2:]
    table.add_row(("ghost", 1, 20.0, 20.0, 20.0, 60.0))
    table.write(tmp_path / "truth.ecsv", format="ascii.ecsv")
    ground = scored(copy, tmp_path / "truth.ecsv")["detection"]["ground"]
    assert (ground["n_truth"]["value"], ground["n_detected"]["value"]) == (5, 4)
    assert ground["false_per_frame"]["value"] == pytest.approx(2 / 3)


def test_flux_gives_the_signal_to_noise_ratio(copy: Path, tmp_path: Path) -> None:
    table = table_of_ends()
    flux_e = np.array(satsim_frames.ELECTRONS_S) * satsim_frames.EXPOSURE_S
    table["flux_e"] = np.tile(flux_e, 3)
    table["psf_sigma_px"] = satsim_frames.SIGMA_PX
    table.write(tmp_path / "truth.ecsv", format="ascii.ecsv")
    bins = scored(copy, tmp_path / "truth.ecsv")["detection"]["ground"]["bins"]
    # Matched filter of a uniform trail: S^2 = F^2 / (noise^2 L 2 sqrt(pi) sigma); noise of sky and readout 9.8 e-.
    length = np.array([np.hypot(6.5, 39.5), np.hypot(9.2, 41.6)])
    noise_e = np.hypot(np.sqrt(satsim_frames.SKY_E), satsim_frames.READ_E)
    expected = flux_e / noise_e / np.sqrt(length * 2.0 * np.sqrt(np.pi) * satsim_frames.SIGMA_PX)
    counts = {(b["from"], b["to"]): b["detected"]["n"] for b in bins if b["quantity"] == "snr"}  # type: ignore[index, call-overload]
    for value in expected:
        assert sum(n for (low, high), n in counts.items() if low <= value < (high or np.inf)) >= 3


MALFORMED = {
    "{": "not readable JSON",
    "[]": 'has no table "data"',
    '{"data": 3}': 'has no table "data"',
    '{"data": {"file": {}, "objects": []}}': 'has no table "data.sensor"',
    '{"data": {"file": {}, "sensor": {"height": "x", "width": 2}, "objects": []}}': "data.sensor.height is x; expected a number",
    '{"data": {"file": {}, "sensor": {"height": 2, "width": 2}, "objects": [1]}}': "data.objects[0] is not an object",
    '{"data": {"file": {}, "sensor": {"height": 2, "width": 2}, "objects": [{}]}}': "data.objects[0].y_start is None",
    '{"data": {"file": {}, "sensor": {"height": 2, "width": 2}, "objects": [{"y_start": NaN}]}}': "y_start is nan",
}


@pytest.mark.parametrize("text", MALFORMED, ids=range(len(MALFORMED)))
def test_malformed_annotations_are_one_line(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    (tmp_path / "annotations").mkdir()
    (tmp_path / "annotations" / "sat_00000.0000.json").write_text(text)
    capsys.readouterr()
    assert cli.run(["score", str(copy), "--truth", str(tmp_path / "annotations")]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
    assert MALFORMED[text] in line
    assert not (copy / "score.json").exists()


WRONG = {
    "object,frame,row0,col0,row1\na,0,1,2,3\n": "lacks the columns col1",
    "object,row0,col0,row1,col1\na,1,2,3,4\n": "lacks the columns frame (or file)",
    "object,frame,row0,col0,row1,col1\na,7,1,2,3,4\n": "row 1: frame is 7; the run has frames 0 to 2",
    "object,frame,row0,col0,row1,col1\na,0.5,1,2,3,4\n": "row 1: frame is 0.5; expected a whole number",
    "object,frame,row0,col0,row1,col1\na,0,1,2,3,nan\n": "row 1: col1 is nan; expected a finite number",
    "object,frame,row0,col0,row1,col1\na,0,1,2,3,\nb,0,1,2,3,4\n": "row 1 has no col1",
    "object,frame,row0,col0,row1,col1\na,0,x,2,3,4\n": "column row0 holds texts; expected numbers",
    "object,frame,row0,col0,row1,col1,snr\na,0,1,2,3,4,-1\n": "row 1: snr is -1; expected a positive number",
    "object,file,row0,col0,row1,col1\na,b.fits,1,2,3,4\n": "no frame of the run came from 'b.fits'",
    "": "lacks the columns object",
    "object\na,b,c\n": "not a readable CSV table",
}


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_a_wrong_table_is_one_line(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    (tmp_path / "truth.csv").write_text(text)
    capsys.readouterr()
    assert cli.run(["score", str(copy), "--truth", str(tmp_path / "truth.csv")]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
    assert WRONG[text] in line


def test_missing_truth_is_one_line(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["score", str(copy), "--truth", str(tmp_path / "none.ecsv")]) == 2
    assert "not found; --truth takes a table" in capsys.readouterr().err
