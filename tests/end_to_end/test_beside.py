"""Work beside: large frames give the same bytes whether or not there is a second processor."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits

from ground.chain import GroundChain
from onboard.detect.line_integral.detector import LineIntegralDetector
from sboc_e2e import scenario as scenarios
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.checks import synthetic_view
from sboc_e2e.icd.frame import Frame, FrameHeader
from sboc_e2e.outside import beside, fits_frames
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.limits import work_meter
from sboc_e2e.outside.process import base_document
from sboc_e2e.outside.rehearsal import rehearse
from sboc_e2e.registry import Registry
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


def test_the_small_frame_that_goes_ahead_comes_through_both_chains(monkeypatch: pytest.MonkeyPatch) -> None:
    """It holds a streak, or kernels that fit streaks would not be loaded; what fails in it is said nowhere else."""
    measured: list[int] = []
    finish = GroundChain.finish

    def noted(chain: GroundChain, frames: Any, products: Any, ingest: Any = None) -> Any:
        result = finish(chain, frames, products, ingest)
        measured.extend(len(each.streaks) for each in products)
        return result

    monkeypatch.setattr(GroundChain, "finish", noted)
    scenario = scenarios.bare("process", base_document("header"), registry=Registry())
    for dtype in (np.uint16, np.float32):
        pixels = np.random.default_rng(3).normal(300.0, 4.0, (1100, 1000)).astype(dtype)
        header = FrameHeader(frame=0, rows=1100, cols=1000, exposure_ns=1, line_time_ns=0, t_start_tai_ns=0)
        sourced = SourcedFrame(frame=Frame(header=header, pixels=pixels), file="a.fits", hdu=0, wcs=None, notes=())
        rehearse(scenario, sourced, StarCatalogue.embedded())
    assert measured == [1, 1]


def test_a_search_in_white_noise_gives_what_the_detector_gives_too() -> None:
    """Both judgements share one search: lines of a rippled frame, more of them where lines beside them do not count."""
    rng = np.random.default_rng(5)
    rows, cols = np.mgrid[:512, :512]
    residual = (rng.normal(0.0, 2.4, (512, 512)) + 1.2 * np.sin(0.11 * rows + 0.07 * cols)).astype(np.float32)
    view = replace(synthetic_view("noise", shape=residual.shape), residual_adu=residual)
    detector = LineIntegralDetector()
    in_white_noise, found = detector.detect_in_white_noise(replace(view, work=work_meter(residual.size)))
    again = detector.detect(replace(view, work=work_meter(residual.size)))
    assert found == again
    assert len(in_white_noise) > len(found)


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
