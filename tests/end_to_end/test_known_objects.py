"""Known objects and biases through the command line, on the files that the user guide gives."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.cli.main import run as command
from tests.docs.documents import blocks


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
