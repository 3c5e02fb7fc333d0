"""Work beside: large frames give the same bytes whether or not there is a second processor."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from ground.chain import GroundChain
from ground.products import tables
from onboard.detect.line_integral.detector import LineIntegralDetector
from sboc_e2e import scenario as scenarios
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.checks import synthetic_view
from sboc_e2e.icd.errors import SbocError, UserError
from sboc_e2e.outside import fits_frames, second_processor
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.ground_rehearsal import rehearse
from sboc_e2e.outside.limits import work_meter
from sboc_e2e.outside.lone_frame import LoneFrame, begun
from sboc_e2e.outside.look_alikes import CountingChain
from sboc_e2e.outside.process import base_document
from sboc_e2e.registry import Registry
from tests.fuzz.outside import run


def test_a_forked_call_gives_what_the_call_gives() -> None:
    assert second_processor.forked(sorted, [3, 1, 2])() == [1, 2, 3]


def test_a_call_that_fails_beside_fails_here() -> None:
    with pytest.raises(ZeroDivisionError):
        second_processor.forked(divmod, 1, 0)()


def test_a_call_whose_process_is_ended_is_made_here() -> None:
    here = os.getpid()

    def other_than_here() -> int:
        if os.getpid() != here:
            os._exit(1)
        return 7

    assert second_processor.forked(other_than_here)() == 7


def counted(end: int) -> Iterator[int]:
    yield from range(end)
    raise UserError("no more")


def doubled(heard: Callable[[], int]) -> Iterator[int]:
    while True:
        yield 2 * heard()


def ended(_heard: Callable[[], object]) -> Iterator[int]:
    yield 1
    os.kill(os.getpid(), signal.SIGKILL)


class Stubborn(Exception):
    """Cannot go from process to process."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")
        self.held = lambda: None  # no function without a name is pickled, whatever other libraries teach pickle of exceptions


def stubborn(_heard: Callable[[], object]) -> Iterator[int]:
    yield 1
    raise Stubborn(1, 2)


def test_a_companion_replies_to_what_it_is_told() -> None:
    with second_processor.companion(doubled) as other:
        other.tell(3)
        other.tell(4)
        assert [other.reply(), other.reply()] == [6, 8]
    assert not multiprocessing.active_children()


def test_what_goes_wrong_in_a_companion_goes_wrong_here_with_its_traceback() -> None:
    with second_processor.companion(lambda _heard: counted(2)) as other:
        assert [other.reply(), other.reply()] == [0, 1]
        with pytest.raises(UserError, match=r"^no more") as caught:
            other.reply()
    assert "in counted" in "".join(caught.value.__notes__)


@pytest.mark.parametrize(("function", "said"), [(stubborn, "^Stubborn: 1 and 2$"), (ended, "ended from outside .exit code -9")])
def test_a_companion_that_cannot_say_what_went_wrong_is_an_error_of_one_line(function: Any, said: str) -> None:
    with second_processor.companion(function) as other:
        assert other.reply() == 1
        other.tell("go on")
        with pytest.raises(SbocError, match=said):
            other.reply()


def test_a_companion_ends_with_the_process_that_waits_for_it(tmp_path: Path) -> None:
    """Killed without a word, that process leaves none behind."""
    child = multiprocessing.get_context("fork").Process(target=_left_alone, args=(tmp_path / "pid",))
    child.start()
    until(lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text().endswith("\n"))
    child.kill()
    child.join()
    until(lambda: not Path(f"/proc/{int((tmp_path / 'pid').read_text())}").exists())


def _left_alone(path: Path) -> None:
    with second_processor.companion(_silent, path) as other:
        other.reply()


def _silent(_heard: Callable[[], object], path: Path) -> Iterator[int]:
    path.write_text(f"{os.getpid()}\n")
    time.sleep(600.0)
    yield 1


def until(holds: Callable[[], bool]) -> None:
    """Wait until something holds, a minute at most."""
    deadline = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_the_small_frame_that_goes_ahead_comes_through_both_chains(monkeypatch: pytest.MonkeyPatch) -> None:
    """It holds a streak, or kernels that fit streaks would not be loaded; what fails in it is said nowhere else."""
    detected: list[int] = []
    measured: list[int] = []
    judge, finish = CountingChain.judge, GroundChain.finish

    def judged(chain: CountingChain, state: Any, prepared: Any) -> Any:
        after, result = judge(chain, state, prepared)
        detected.append(len(result.detections))
        return after, result

    def noted(chain: GroundChain, frames: Any, products: Any, ingest: Any = None) -> Any:
        result = finish(chain, frames, products, ingest)
        measured.extend(int(np.sum(table["snr"] > 50.0)) for table in tables.streaks_tables(result))
        return result

    monkeypatch.setattr(CountingChain, "judge", judged)
    monkeypatch.setattr(GroundChain, "finish", noted)
    scenario = scenarios.bare("process", base_document("header"), registry=Registry())
    rehearse(scenario, StarCatalogue.embedded())
    assert (detected, measured) == ([1], [1])


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


@pytest.mark.parametrize("with_wcs", [False, True])
def test_products_do_not_depend_on_what_is_done_beside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, with_wcs: bool
) -> None:
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
    hdu = fits.PrimaryHDU(np.rint(image.clip(0, 65535)).astype(np.uint16))
    if with_wcs:
        hdu.header["DATE-OBS"] = "2024-05-06T07:08:09.123"
        for axis, kind, value, scale in ((1, "RA---TAN", 123.456789012345, -1.2345678901e-3), (2, "DEC--TAN", -12.3, 1.2345e-3)):
            hdu.header[f"CTYPE{axis}"], hdu.header[f"CRPIX{axis}"] = kind, 500.123456789
            hdu.header[f"CRVAL{axis}"], hdu.header[f"CDELT{axis}"] = value, scale
    hdu.writeto(tmp_path / "in" / "a.fits")
    read: list[int] = []
    read_frame = fits_frames.read_frame
    monkeypatch.setattr(fits_frames, "read_frame", lambda *given, **more: (read.append(given[1]), read_frame(*given, **more))[1])
    ingest = {}
    for worth in (True, False):
        monkeypatch.setattr(
            second_processor, "is_worth", lambda n_pixels, worth=worth: worth and n_pixels >= second_processor.LEAST_PX
        )
        ingest[worth] = run(tmp_path / "in", tmp_path / f"{worth}")
    assert read == [0, 0]
    monkeypatch.setattr(second_processor, "is_worth", lambda n_pixels: n_pixels >= second_processor.LEAST_PX)
    with begun(FitsFolder(path=tmp_path / "in"), alone=True, guessed=True) as first:
        assert isinstance(first, LoneFrame)
        run(tmp_path / "in", tmp_path / "alone", first)
    assert read == [0, 0]
    assert ingest[True] == ingest[False]
    assert ingest[True]["outside"]["frames"][0]["look_alikes"]["all"] > 0
    names = sorted(path.relative_to(tmp_path / "True") for path in (tmp_path / "True").rglob("*") if path.is_file())
    assert len(names) > 10
    for name in names:
        if name.name != "manifest.json":  # it has times
            content = (tmp_path / "True" / name).read_bytes()
            assert content == (tmp_path / "False" / name).read_bytes(), name
            assert content == (tmp_path / "alone" / name).read_bytes(), name
    streaks = Table.read(tmp_path / "alone" / "products" / "streaks.ecsv", format="ascii.ecsv")
    assert np.isfinite(streaks["dec_mid_deg"]).all() == with_wcs
