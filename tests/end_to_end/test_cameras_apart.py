"""Frames of several cameras in one folder: each is treated as it is without the others."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.outside import cameras_apart

SIDE_PX = 128
ENDS = (40.0, 30.0, 88.0, 95.0)
"""Rows and columns of both ends of the trail."""
LENGTH_PX = np.hypot(ENDS[2] - ENDS[0], ENDS[3] - ENDS[1])
SIGMA_PX = 1.4
LATER = {"frame", "streak_id", "notes"}
"""Columns that follow a frame's number, beside the times that it has where none are told."""


def image(seed: int, noise: float) -> np.ndarray:
    """A trail whose ridge is ten times the noise."""
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX].astype(float)
    light = np.zeros((SIDE_PX, SIDE_PX))
    for share in (np.arange(300) + 0.5) / 300:
        r, c = ENDS[0] + share * (ENDS[2] - ENDS[0]), ENDS[1] + share * (ENDS[3] - ENDS[1])
        light += np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / SIGMA_PX**2)
    light *= LENGTH_PX / 300 / (np.sqrt(2.0 * np.pi) * SIGMA_PX)
    return np.random.default_rng(seed).normal(100.0 * noise, noise, light.shape) + 10.0 * noise * light


def coarse(path: Path, seed: int) -> None:
    """Of camera A, in whole numbers with a noise of 20 and a gain of 1.5."""
    header = fits.Header({"INSTRUME": "A", "GAIN": 1.5, "EXPTIME": 1.0})
    fits.PrimaryHDU(np.round(image(seed, 20.0)).astype(np.uint16), header).writeto(path)


def fine(path: Path, seed: int, *, mirrored: bool = False) -> None:
    """Of camera B, whose noise is 0.005 and whose gain nobody tells. mirrored : what stays is no trail."""
    header = fits.Header({"INSTRUME": "B", "EXPTIME": 1.0})
    pixels = image(seed, 0.005)[:, :: -1 if mirrored else 1]
    fits.PrimaryHDU(pixels.astype(np.float32), header).writeto(path)


def processed(folder: Path, *extra: str) -> dict[str, Table]:
    out = folder.parent / f"out-{folder.name}"
    assert cli.run(["process", str(folder), "--out", str(out), *extra]) == 0
    return {name: Table.read(out / "products" / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "streaks", "stars")}


def same_frames(one: dict[str, Table], other: dict[str, Table], name: str) -> bool:
    """Whether frames whose files' names end so have the same rows in two runs, to 1e-9, without what follows their number."""
    for kind, table in one.items():
        mine, theirs = (
            found[kind][
                np.isin(np.asarray(found[kind]["frame"]), [f["frame"] for f in found["frames"] if str(f["file"]).endswith(name)])
            ]
            for found in (one, other)
        )
        columns = [c for c in table.colnames if c not in LATER and "utc" not in c and "tai" not in c]
        if len(mine) != len(theirs):
            return False
        for c in columns:
            x, y = np.asarray(mine[c]), np.asarray(theirs[c])
            if not (np.allclose(x, y, rtol=1e-9, equal_nan=True) if x.dtype.kind == "f" else np.array_equal(x, y)):
                return False
    return True


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("cameras")
    for name in ("first", "alone", "both", "turns", "series"):
        (root / name).mkdir()
    coarse(root / "both" / "a.fits", 1)
    fine(root / "both" / "b.fits", 2)
    os.link(root / "both" / "b.fits", root / "alone" / "b.fits")
    for k in range(2):  # in the order of times, and none before 3 of a camera calibrate each other
        coarse(root / "turns" / f"{k}a.fits", 10 + k)
        fine(root / "turns" / f"{k}b.fits", 20 + k, mirrored=k == 1)
        os.link(root / "turns" / f"{k}b.fits", root / "series" / f"{k}b.fits")
    return root


def test_a_frame_after_one_of_another_camera_is_what_it_is_alone(folders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The gain of A makes a noise of 0.0075 e- of B's 0.005; 5 e- make 1,000 e-/ADU. Ends within half a pixel of truth."""
    both, alone = processed(folders / "both"), processed(folders / "alone")
    assert same_frames(both, alone, "b.fits")
    (streak,) = both["streaks"][both["streaks"]["frame"] == 1]
    ends = np.array([float(streak[name]) for name in ("row0", "col0", "row1", "col1")])
    assert np.abs(ends - ENDS).max() < 0.5
    light_e = 10.0 * 5.0 * np.sqrt(2.0 * np.pi) * SIGMA_PX * LENGTH_PX  # a ridge of ten times the noise, which counts as 5 e-
    assert float(streak["flux_e"]) == pytest.approx(light_e, rel=0.1)
    camera = json.loads((folders / "out-both" / "calibration" / "camera.json").read_text())
    assert [each["frames"] for each in camera["cameras"]] == [[0], [1]]
    assert camera["camera"]["gain_e_adu"] == camera["cameras"][0]["camera"]["gain_e_adu"] == 1.5
    assert camera["cameras"][1]["camera"]["gain_e_adu"] == pytest.approx(1000.0, rel=0.05)
    assert "another camera than the first frame's" in str(both["frames"]["notes"][1])
    assert "1 of 2 frames: another camera than the first frame's" in capsys.readouterr().err


@pytest.mark.parametrize("waiting_px", [cameras_apart.MOST_WAITING_PX, SIDE_PX**2])
def test_cameras_that_take_turns_have_their_own_frames_before_them(
    folders: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, waiting_px: int
) -> None:
    """Frames of B with one of A before each are what they are as a series, also where the first of A may not wait any longer."""
    monkeypatch.setattr(cameras_apart, "MOST_WAITING_PX", waiting_px)
    (tmp_path / "turns").mkdir()
    for path in (folders / "turns").iterdir():
        os.link(path, tmp_path / "turns" / path.name)
    turns, series = processed(tmp_path / "turns"), processed(folders / "series", "--force")
    assert list(turns["frames"]["frame"]) == [0, 1, 2, 3]
    assert len(series["streaks"]) == 2
    assert same_frames(turns, series, "b.fits")


def test_a_camera_that_is_given_counts_for_all(folders: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.toml"
    assert cli.run(["camera", "make", str(folders / "both" / "a.fits"), "--out", str(camera)]) == 0
    (tmp_path / "both").mkdir()
    for name in "ab":
        os.link(folders / "both" / f"{name}.fits", tmp_path / "both" / f"{name}.fits")
    found = processed(tmp_path / "both", "--camera", str(camera))
    assert "cameras" not in json.loads((tmp_path / "out-both" / "calibration" / "camera.json").read_text())
    assert not any("another camera" in str(notes) for notes in found["frames"]["notes"])
