"""Downlinks as archives hold them: packets of several runs in one file, or of none."""

import binascii
import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.faults import split_packets
from sboc_e2e.icd.layout import CRC_START, HEADER_BYTES, ITEM, Apid
from sboc_e2e.run.pipeline import Run
from tests.end_to_end.conftest import digest
from tests.onboard import small_run

RUN_ID_OFFSET = HEADER_BYTES - ITEM.size + 2
OTHER = 4242
CAMERA_COLUMNS = {"focal_px", "focal_err_px", "center_row", "center_col", "k1", "k2", "p1", "p2", "mirrored"}


@pytest.fixture
def copy(finished: Run, tmp_path: Path) -> Path:
    """A copy of the finished run that a test may change."""
    return Path(shutil.copytree(finished.directory.path, tmp_path / "run"))


def of_run(packets: list[bytes], run_id: int) -> list[bytes]:
    """Intact packets of another run with the same content."""
    bodies = [packet[:RUN_ID_OFFSET] + struct.pack(">I", run_id) + packet[RUN_ID_OFFSET + 4 : -2] for packet in packets]
    return [body + struct.pack(">H", binascii.crc_hqx(body, CRC_START)) for body in bodies]


def test_ground_takes_the_packets_of_its_own_run_and_says_what_it_left_out(copy: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A foreign run with three times the packets, and another size of frames, changes no product."""
    expected = digest(copy)
    own = (copy / "downlink.bin").read_bytes()
    foreign = small_run.short_run(12, run_id=OTHER).downlink
    assert len(split_packets(foreign)) > len(split_packets(own))
    (copy / "downlink.bin").write_bytes(foreign + own)
    assert cli.run(["ground", str(copy)]) == 0
    assert f"packets of other runs were left out: {OTHER} ({len(split_packets(foreign))} packets)" in capfd.readouterr().err
    changed = {name for name, content in digest(copy).items() if content != expected[name]}
    assert changed == {"downlink.bin", "products/ingest.json"}
    report = json.loads((copy / "products" / "ingest.json").read_text())
    assert report["run_id"] == json.loads((copy / "manifest.json").read_text())["run_id"]
    assert report["foreign_runs"] == {str(OTHER): len(split_packets(foreign))}
    assert cli.run(["score", str(copy)]) == 0


@pytest.mark.slow
def test_another_run_of_a_downlink_can_be_chosen_and_is_scored_as_chosen(copy: Path) -> None:
    """Packets of two frames under another id, told apart by their number."""
    own = split_packets((copy / "downlink.bin").read_bytes())
    two = [packet for packet in own if ITEM.unpack_from(packet, HEADER_BYTES - ITEM.size)[3] < 2]
    (copy / "downlink.bin").write_bytes(b"".join([*own, *of_run(two, OTHER)]))
    assert cli.run(["ground", str(copy), "--run-id", str(OTHER)]) == 0
    report = json.loads((copy / "products" / "ingest.json").read_text())
    assert (report["run_id"], report["frames_complete"]) == (OTHER, [0, 1])
    assert cli.run(["score", str(copy)]) == 0
    of_two = json.loads((copy / "score.json").read_text())
    assert cli.run(["ground", str(copy)]) == 0
    assert cli.run(["score", str(copy)]) == 0
    assert json.loads((copy / "products" / "ingest.json").read_text())["frames_complete"] == [0, 1, 2, 3]
    assert json.loads((copy / "score.json").read_text())["detection"]["onboard"] != of_two["detection"]["onboard"]


def test_a_downlink_of_other_runs_only_is_one_line(copy: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Products of before stay, and the manifest says so."""
    before = digest(copy) | {"manifest": (copy / "manifest.json").read_text()}
    own = split_packets((copy / "downlink.bin").read_bytes())
    (copy / "downlink.bin").write_bytes(b"".join(of_run(own, OTHER)))
    assert cli.run(["ground", str(copy)]) == 2
    assert f"only of others: {OTHER} ({len(own)} packets); --run-id NUMBER takes one of them" in capfd.readouterr().err
    after = digest(copy) | {"manifest": (copy / "manifest.json").read_text()}
    assert after | {"downlink.bin": ""} == before | {"downlink.bin": ""}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"no packets " * 900, "9900 bytes without an intact packet"),
        (bytes(5000), "5000 bytes without an intact"),
    ],
    ids=["empty", "garbage", "zeros"],
)
def test_a_downlink_without_packets_is_one_line(
    copy: Path, capfd: pytest.CaptureFixture[str], content: bytes, words: str
) -> None:
    """Products of before stay, and the manifest says so."""
    before = digest(copy) | {"manifest": (copy / "manifest.json").read_text()}
    (copy / "downlink.bin").write_bytes(content)
    assert cli.run(["ground", str(copy)]) == 2
    stderr = capfd.readouterr().err
    assert f"sboc: {copy}/downlink.bin: {words}" in stderr
    assert "Warning" not in stderr
    after = digest(copy) | {"manifest": (copy / "manifest.json").read_text()}
    assert after | {"downlink.bin": ""} == before | {"downlink.bin": ""}


def test_a_refused_run_number_or_a_missing_downlink_leaves_finished_results(copy: Path) -> None:
    before = (copy / "manifest.json").read_text()
    assert cli.run(["ground", str(copy), "--run-id", "7"]) == 2
    assert (copy / "manifest.json").read_text() == before
    (copy / "downlink.bin").unlink()
    assert cli.run(["ground", str(copy)]) == 2
    assert (copy / "manifest.json").read_text() == before


def test_packets_without_any_header_give_empty_products_and_a_score_of_absent_numbers(
    copy: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Tables of the same columns and kinds without rows, no message of a date nobody knows, a report.

    What only a frame can say is not there: the camera model's columns, and the companion of a message that is not written.
    """
    columns = {path.name: _kinds(path) for path in sorted((copy / "products").glob("*.ecsv"))}
    columns["frames.ecsv"] = [kind for kind in columns["frames.ecsv"] if kind[0] not in CAMERA_COLUMNS]
    del columns["tdm_angles.ecsv"]
    packets = split_packets((copy / "downlink.bin").read_bytes())
    kept = [packet for packet in packets if int.from_bytes(packet[:2], "big") & 0x7FF != Apid.HEADER]
    (copy / "downlink.bin").write_bytes(b"".join(kept))
    assert cli.run(["ground", str(copy)]) == 0
    stderr = capfd.readouterr().err
    assert "no intact header packet, without which none of 4 frames can be built" in stderr
    assert "Warning" not in stderr
    assert json.loads((copy / "products" / "ingest.json").read_text())["frames_unusable"] == [0, 1, 2, 3]
    assert {path.name: _kinds(path) for path in sorted((copy / "products").glob("*.ecsv"))} == columns
    tables = {path.name: Table.read(path, format="ascii.ecsv") for path in (copy / "products").glob("*.ecsv")}
    flux = tables.pop("population.ecsv")
    assert {name: len(table) for name, table in tables.items()} == dict.fromkeys(tables, 0)
    assert flux.meta["lacks"]
    assert not np.isfinite(np.ma.filled(flux["flux"], np.nan)).any()
    assert sorted(path.name for path in (copy / "products").iterdir()) == sorted([*columns, "ingest.json"])
    assert cli.run(["score", str(copy)]) == 0
    assert cli.run(["report", str(copy)]) == 0
    ground = json.loads((copy / "score.json").read_text())["detection"]["ground"]
    assert ground["completeness"]["value"] == 0.0
    assert ground["ideal_threshold"]["value"] > 3.0


def _kinds(path: Path) -> list[tuple[str, str]]:
    """Name and kind of each column; texts differ in length only."""
    table = Table.read(path, format="ascii.ecsv")
    return [(name, table[name].dtype.kind) for name in table.colnames]
