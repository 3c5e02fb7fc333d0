"""A trail in two files of one exposure is found in both, as in each alone."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from tests.end_to_end.raw_camera import TRAIL, dusty, raw_frame, streaks_of
from tests.fuzz.outside import run

DARK_ADU = 300.0


def save(path: Path, image: np.ndarray, start: str | None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    hdu = fits.PrimaryHDU(image)
    hdu.header.update({"EXPTIME": 10.0, "GAIN": 1.0} | ({"DATE-OBS": start} if start else {}))
    hdu.writeto(path)


@pytest.mark.parametrize("later", [False, True], ids=["two files", "and two of another time"])
def test_a_raw_frame_and_its_calibrated_copy(tmp_path: Path, later: bool) -> None:
    flat, _ = pattern = dusty(1, rings=0)
    for k, start in enumerate(("2024-03-10T20:15:30.25", "2024-03-10T20:15:50.25")[: 1 + later]):
        raw = raw_frame(k, pattern, sky=1, trail_e_px=0.0 if k else 150.0)
        save(tmp_path / "frames" / f"light_{k}.fits", raw, start)
        save(tmp_path / "frames" / f"light_{k}_cal.fits", ((raw - DARK_ADU) / flat).astype(np.float32), start)
    run(tmp_path / "frames", tmp_path / "out")
    table, published = streaks_of(tmp_path / "out")
    frames = Table.read(tmp_path / "out" / "products" / "frames.ecsv", format="ascii.ecsv")
    assert ["same exposure as" in text for text in frames["notes"]] == ([True] * 4 if later else [False, True])
    assert table[published]["frame"].tolist() == [0, 1]
    ends = np.array([table[published][name] for name in ("row0", "col0", "row1", "col1")]).T
    assert np.abs(ends - np.array(TRAIL)).max() < 2.0


def test_a_file_twice_without_a_time(tmp_path: Path) -> None:
    path = tmp_path / "frames" / "a.fits"
    save(path, raw_frame(1, sky=1, trail_e_px=150.0), None)
    (tmp_path / "frames" / "a.fits.gz").write_bytes(gzip.compress(path.read_bytes()))
    run(tmp_path / "frames", tmp_path / "out")
    table, published = streaks_of(tmp_path / "out")
    assert table[published]["frame"].tolist() == [0, 1]
