"""Work beside: large frames give the same bytes whether or not there is a second processor."""

import os
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from sboc_e2e.outside import beside, fits_frames
from tests.fuzz.outside import run


def test_a_forked_call_gives_what_the_call_gives() -> None:
    assert beside.forked(sorted, [3, 1, 2])() == [1, 2, 3]


def test_a_call_that_fails_beside_fails_here() -> None:
    with pytest.raises(ZeroDivisionError):
        beside.forked(divmod, 1, 0)()


def test_a_call_whose_process_is_ended_is_made_here() -> None:
    here = os.getpid()

    def other_than_here() -> int:
        if os.getpid() != here:
            os._exit(1)
        return 7

    assert beside.forked(other_than_here)() == 7


def test_products_do_not_depend_on_what_is_done_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame of a megapixel with stars, a bright trail and a dark one; it is read once."""
    rng = np.random.default_rng(7)
    image = rng.normal(500.0, 8.0, (1024, 1100))
    rows, cols = np.mgrid[-9:10, -9:10]
    image_of_star = np.exp(-0.5 * (rows**2 + cols**2) / 1.5**2)
    places = [(*rng.uniform(10, 1010, 2), 40.0 + 2000.0 * rng.random() ** 4) for _ in range(300)]
    along = np.linspace(0.0, 1.0, 900)
    for height, (row0, col0), (row1, col1) in ((14.0, (200, 150), (420, 330)), (-14.0, (600, 700), (820, 560))):
        places += [(row0 + t * (row1 - row0), col0 + t * (col1 - col0), height) for t in along]
    for row, col, height in places:
        r, c = int(row), int(col)
        image[r - 9 : r + 10, c - 9 : c + 10] += height * image_of_star
    (tmp_path / "in").mkdir()
    fits.PrimaryHDU(np.rint(image.clip(0, 65535)).astype(np.uint16)).writeto(tmp_path / "in" / "a.fits")
    read: list[int] = []
    read_frame = fits_frames.read_frame
    monkeypatch.setattr(fits_frames, "read_frame", lambda *given, **more: (read.append(given[1]), read_frame(*given, **more))[1])
    ingest = {}
    for worth in (True, False):
        monkeypatch.setattr(beside, "is_worth", lambda n_pixels, worth=worth: worth and n_pixels >= beside.LEAST_PX)
        ingest[worth] = run(tmp_path / "in", tmp_path / f"{worth}")
    assert read == [0, 0]
    assert ingest[True] == ingest[False]
    assert ingest[True]["outside"]["frames"][0]["look_alikes"]["all"] > 0
    names = sorted(path.relative_to(tmp_path / "True") for path in (tmp_path / "True").rglob("*") if path.is_file())
    assert len(names) > 10
    for name in names:
        if name.name != "manifest.json":  # it has times
            assert (tmp_path / "True" / name).read_bytes() == (tmp_path / "False" / name).read_bytes(), name
