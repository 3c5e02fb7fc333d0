"""Known objects and biases through the command line, on the files that the user guide gives."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e.cli.main import run as command
from tests.docs.documents import blocks
from tests.end_to_end.conftest import tiny

GOOD_ELEMENTS = """0 VANGUARD 1
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""
OEM_HEAD = (
    "CCSDS_OEM_VERS = 2.0\nMETA_START\nOBJECT_NAME = A\nCENTER_NAME = EARTH\nREF_FRAME = {frame}\nTIME_SYSTEM = UTC\nMETA_STOP\n"
)


@pytest.fixture(scope="module")
def products(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Products of the guide's scenario."""
    folder = tmp_path_factory.mktemp("known")
    for block in blocks("docs/user-guide.md"):
        if block.file in ("known.3le", "precise.oem", "known.toml"):
            (folder / block.file).write_text(block.text)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert command(["run", "known.toml", "--out", "run"]) == 0
    return folder / "run"


def test_known_and_unknown_tracklets(products: Path) -> None:
    """Both satellites are found by name, the third object is unknown; residuals are those of the late clock."""
    known = Table.read(products / "products" / "known.ecsv")
    tracklets = Table.read(products / "products" / "tracklets.ecsv")
    assert list(known["tracklet_id"]) == list(tracklets["tracklet_id"])
    names = {str(row["name"]): row for row in known if row["known"]}
    assert set(names) == {"ALPHA", "DELTA"}
    assert {int(row["number"]) for row in names.values()} == {90054, 90005}
    assert (~np.asarray(known["known"])).sum() >= 1
    truth, frames = (Table.read(products / "truth" / f"{name}.ecsv") for name in ("streaks", "frames"))
    late_s = (frames["t_start_clock_tai_ns"][0] - frames["t_start_true_tai_ns"][0]) * 1e-9
    assert late_s == pytest.approx(0.02, abs=1e-5)
    for row in names.values():
        assert abs(row["cross_arcsec"]) < 10.0
        # 7 km/s for 20 ms are 140 m, at least 12 arcsec at 2,350 km; at 747 km 39
        assert -45.0 < row["along_arcsec"] < -5.0
        assert row["n_candidates"] == 1
    assert len(np.unique(truth["object_id"])) == 3


def test_biases_are_within_their_sigma(products: Path) -> None:
    """The clock's 20 ms, and no bias of a pointing that stars give, within three sigma; these are small enough to say so."""
    bias = json.loads((products / "products" / "bias.json").read_text())
    truth = {"time_s": 0.02, "east_arcsec": 0.0, "north_arcsec": 0.0}
    for name, value in truth.items():
        assert abs(bias[name]["value"] - value) < 3.0 * bias[name]["sigma"], name
    assert bias["time_s"]["sigma"] < 0.005
    assert bias["east_arcsec"]["sigma"] < 5.0
    assert bias["n_used"] >= 10


@pytest.mark.parametrize(
    ("option", "content", "words"),
    [
        ("known_objects_file", None, "No such file or directory; give a readable file or an empty string"),
        ("known_objects_file", b"", "expected two-line element sets, found none"),
        ("known_objects_file", b"\xff\xfe\x00", "not a text file; give a readable file"),
        ("known_objects_file", GOOD_ELEMENTS.rsplit("\n", 2)[0].encode(), "line 2: half an element set"),
        ("precise_orbits_file", None, "No such file or directory; give a readable file or an empty string"),
        ("precise_orbits_file", b"", "expected at least one segment with states, got none"),
        ("precise_orbits_file", OEM_HEAD.format(frame="MOON").encode(), "line 7: expected REF_FRAME of EME2000, GCRF, ICRF"),
        ("precise_orbits_file", OEM_HEAD.format(frame="GCRF").encode() + b"here", "line 8: expected an epoch and six numbers"),
        ("catalogue_file", None, "no such file; make one with `sboc catalogue build`"),
        ("catalogue_file", b"no catalogue", "make it again with `sboc catalogue build`"),
    ],
)
@pytest.mark.parametrize("verb", ["run", "process"])
def test_a_bad_file_is_one_line_before_the_run_starts(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    verb: str,
    option: str,
    content: bytes | None,
    words: str,
) -> None:
    """File, what is wrong and what is allowed, with exit code 2; nothing is made, not even the run's folder."""
    path, out = tmp_path / "given.txt", tmp_path / "run"
    if content is not None:
        path.write_bytes(content)
    if verb == "process":
        fits.PrimaryHDU(np.zeros((64, 64), dtype=np.uint16)).writeto(tmp_path / "frame.fits")
        source = tmp_path / "frame.fits"
    else:
        source = tiny(tmp_path)
    assert command([verb, str(source), "--out", str(out), "--set", f"ground.{option}={path}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"sboc: ground.{option}: ")
    assert str(path) in line
    assert words in line
    assert not out.exists()
