"""`sboc view`: region files, VOTables, messages to a hub, and the page in a real headless Chromium."""

import base64
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.cli.outside import folder_of
from sboc_e2e.icd.errors import UserError
from sboc_e2e.view import Hub, RunFrames, send, write_files, write_page
from sboc_e2e.view.page import picture_of
from tests.browser import SCHEMES, WIDTHS, excess_and_errors

SAMP = pytest.importorskip("astropy.samp", reason="this astropy has no SAMP")

ENDS = (30.0, 20.0, 90.0, 140.0)
"""row0, col0, row1, col1 of the trail in frame 0; in frame 1 it is mirrored, since what stays is no trail."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    frames = folder / "frames of a telescope"
    frames.mkdir()
    row, col = np.mgrid[:120, :160].astype(float)
    for number in range(2):
        rng = np.random.default_rng(number)
        image = rng.normal(200.0, 5.0, row.shape)
        for share in np.linspace(0.0, 1.0, 400):
            r, c = ENDS[0] + 60 * share, ENDS[1] + 120 * share
            image += 12.0 * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / 1.44)
        image = image[:, :: 1 - 2 * number]
        image[5, 7] = 1234.0 + number
        fits.PrimaryHDU(np.round(image).astype(np.uint16)).writeto(frames / f"f{number}.fits")
    assert cli.run(["process", str(frames), "--out", str(folder / "run")]) == 0
    assert cli.run(["view", str(folder / "run"), "--no-samp", "--browser", "--no-open"]) == 0
    return folder / "run"


def test_regions_and_tables_lie_beside_each_frame_and_count_from_one(run: Path) -> None:
    streaks = Table.read(run / "products" / "streaks.ecsv", format="ascii.ecsv")
    for number in range(2):
        text = (run / "view" / f"{number:06d}.reg").read_text()
        lines = [line for line in text.splitlines() if line.startswith("line(")]
        mine = streaks[streaks["frame"] == number]
        assert len(lines) == len(mine) > 0
        ends = np.array([float(v) for v in lines[0].partition(")")[0].removeprefix("line(").split(",")])
        s = mine[0]
        assert np.allclose(ends, np.array([s["col0"], s["row0"], s["col1"], s["row1"]]) + 1.0, atol=1e-3)
        table = Table.read(run / "view" / f"{number:06d}.streaks.vot", format="votable")
        assert np.allclose(table["fits_x0"], mine["col0"] + 1.0)
        assert len(Table.read(run / "view" / f"{number:06d}.stars.vot", format="votable")) >= 0


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("m31.fits", "m31"), ("m31.r.fits", "m31.r"), ("m31.g.FITS", "m31.g"), ("m31.fits.fz", "m31"), ("m31.fit.gz", "m31"),
        ("2024.03.01.fts.xz", "2024.03.01"), ("m31.fits.bz2", "m31"), ("m31", "m31"), (".fits", ".fits"),
        ("x" * 250 + ".fits", "x" * 60),
    ],
)  # fmt: skip
def test_a_file_s_run_has_its_name_without_the_endings_of_fits(file: str, name: str) -> None:
    assert re.fullmatch(f"view-{re.escape(name)}-[0-9a-f]{{8}}", folder_of(Path("frames") / file).name)
    assert folder_of(Path("frames") / file) == folder_of(Path("frames").absolute() / file)


def test_files_that_differ_in_any_part_of_their_path_are_viewed_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """m31.r.fits and m31.g.fits went into one folder, the later over the earlier."""
    monkeypatch.chdir(tmp_path)
    paths = [Path("m31.r.fits"), Path("m31.g.fits"), Path("other") / "m31.g.fits"]
    (tmp_path / "other").mkdir()
    for number, path in enumerate(paths):
        fits.PrimaryHDU(np.random.default_rng(number).normal(100.0, 5.0, (48, 48)).astype(np.float32)).writeto(path)
        for _ in range(2):  # a file that is looked at again has the same run
            assert cli.run(["view", str(path), "--no-samp"]) == 0
    assert sorted(p.name.rpartition("-")[0] for p in (tmp_path / "runs").iterdir()) == ["view-m31.g", "view-m31.g", "view-m31.r"]
    for path in paths:
        table = Table.read(folder_of(path) / "products" / "frames.ecsv", format="ascii.ecsv")
        assert list(table["file"]) == [path.name]


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A hub of astropy's own on this machine."""
    monkeypatch.setenv("SAMP_HUB", f"std-lockurl:{(tmp_path / 'samp').as_uri()}")
    server = SAMP.SAMPHubServer(web_profile=False, mode="multiple", lockfile=str(tmp_path / "samp"), addr="127.0.0.1")
    server.start()
    try:
        yield server
    finally:
        if server.is_running:
            server.stop()


MTYPES = ("image.load.fits", "table.load.votable", "ds9.set")


def listening(name: str, take: Callable[[str, dict[str, str]], dict[str, Any] | None]) -> Any:
    """A client that plays DS9: `take` gets type and parameters of each message and gives the answer, or None for none."""
    client = SAMP.SAMPIntegratedClient(name=name)
    client.connect()

    def called(_key: str, _sender: str, message: str, mtype: str, params: dict[str, str], _extra: object) -> None:
        if (answer := take(mtype, params)) is not None:
            client.reply(message, answer)

    for mtype in MTYPES:
        client.bind_receive_call(mtype, called)
    return client


def test_a_listening_tool_has_images_tables_and_regions_when_the_sender_leaves(run: Path, hub: Any) -> None:
    heard: list[tuple[str, dict[str, str]]] = []

    def take(mtype: str, params: dict[str, str]) -> dict[str, Any]:
        heard.append((mtype, params))
        return {"samp.status": "samp.ok", "samp.result": {}}

    ds9 = listening("ds9", take)
    with Hub() as connected:
        send(connected, write_files(RunFrames(path=run), run / "view"))
    assert (connected.taken, connected.remarks) == (6, [])
    ds9.disconnect()
    assert sorted(mtype for mtype, _ in heard) == ["ds9.set"] * 2 + ["image.load.fits"] * 2 + ["table.load.votable"] * 2
    image = next(params for mtype, params in heard if mtype == "image.load.fits")
    assert image["url"].startswith("file:///")
    assert "%20" in image["url"]


def test_a_tool_that_refuses_a_file_or_does_not_answer_is_named(
    run: Path, hub: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sboc_e2e.view.samp.ANSWER_S", 1)
    refusal = {"samp.status": "samp.error", "samp.error": {"samp.errortxt": "no room for tables"}}
    topcat = listening("topcat", lambda mtype, _: refusal if mtype == "table.load.votable" else {"samp.status": "samp.ok"})
    mute = listening("mute", lambda *_: None)
    assert cli.run(["view", str(run)]) == 0
    topcat.disconnect()
    mute.disconnect()
    lines = capsys.readouterr().out.splitlines()
    assert "SAMP: 4 messages taken" in lines
    assert lines.count("topcat refused table.load.votable: no room for tables") == 2
    assert lines.count("mute did not answer image.load.fits within 1 s, and got nothing more") == 1


def test_a_hub_that_stops_while_files_are_sent_is_one_line(run: Path, hub: Any) -> None:
    """As when a user closes the tool that is the hub; leaving it is no error then."""
    written = write_files(RunFrames(path=run), run / "view")
    with Hub() as connected:
        hub.stop()
        with pytest.raises(UserError, match="the hub stopped while files were sent; 0 messages were taken"):
            send(connected, written)


def test_without_a_hub_one_line_says_so(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setenv("SAMP_HUB", f"std-lockurl:{(tmp_path / 'none').as_uri()}")
    assert cli.run(["view", str(run)]) == 0
    assert "no SAMP hub runs" in capsys.readouterr().out


def test_what_is_no_run_is_refused(tmp_path: Path, capsys: Any) -> None:
    assert cli.run(["view", str(tmp_path)]) == 2
    assert "manifest.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("file", "kept", "words"),
    [
        ("products/streaks.ecsv", 3000, "damaged table"),
        ("products/streaks.ecsv", 0, "damaged table"),
        ("products/stars.ecsv", "2/3", "damaged table"),
        ("products/frames.ecsv", "2/3", "damaged table"),
        ("manifest.json", 100, "not a manifest of this program"),
    ],
)
def test_a_damaged_file_of_a_run_is_one_line_with_its_name(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], file: str, kept: int | str, words: str
) -> None:
    """kept : bytes from its beginning."""
    damaged = tmp_path / "run"
    shutil.copytree(run, damaged)
    whole = (damaged / file).read_bytes()
    (damaged / file).write_bytes(whole[: 2 * len(whole) // 3 if kept == "2/3" else int(kept)])
    capsys.readouterr()
    assert cli.run(["view", str(damaged), "--no-samp"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{damaged / file}: {words}" in line


def read(picture: dict[str, Any]) -> np.ndarray:
    """Numbers of a picture of the page, NaN where it has none."""
    image = cv2.imdecode(np.frombuffer(base64.b64decode(picture["png"]), dtype=np.uint8), cv2.IMREAD_COLOR).astype(int)
    levels = image[..., 2] * 256 + image[..., 1]
    at = picture["bottom"] + (levels - 1) * picture["step"]
    return np.where(levels > 0, at if picture["soft"] is None else picture["middle"] + picture["soft"] * np.sinh(at), np.nan)


def test_levels_of_a_picture_give_the_numbers_back() -> None:
    """16-bit frames exactly; NaN as level 0; one absurd pixel costs the sky no more than 1/100 of its noise."""
    rng = np.random.default_rng(0)
    sky = rng.normal(500.0, 10.0, (64, 64)).round()
    full = sky.astype(np.uint16)
    full[1, 2] = 65500
    assert np.array_equal(read(picture_of(full)), full)
    sky[3, 4] = np.nan
    assert np.isnan(read(picture_of(sky))[3, 4])
    sky[3, 4] = -1e9
    assert np.abs(read(picture_of(sky)) - sky)[5:].max() < 0.1


@pytest.mark.parametrize("unit", [1.0, 1e-20])
@pytest.mark.parametrize("star", [1e3, 1e20, -1e9])
def test_a_bright_pixel_and_the_sky_are_both_kept(unit: float, star: float) -> None:
    """The sky to a twentieth of its noise of 0.001, the pixel to 1 %, in any unit."""
    sky = np.random.default_rng(1).normal(0.2, 1e-3, (64, 64))
    sky[10, 10] = star
    given = (sky * unit).astype(np.float32)
    picture = picture_of(given)
    back = read(picture) / unit
    sky = given.astype(np.float64) / unit
    assert abs(back[10, 10] / sky[10, 10] - 1.0) < 0.01
    assert np.abs(back - sky)[20:].max() < 5e-5
    assert picture["low"] / unit == pytest.approx(0.2 - 2.6e-3, abs=2e-4)
    assert picture["high"] / unit == pytest.approx(0.2 + 2.6e-3, abs=2e-4)


@pytest.mark.parametrize("level", [0.0, 1e9, 1e-20, -3.0])
def test_a_frame_of_one_number_has_one_level(level: float) -> None:
    picture = picture_of(np.full((32, 32), level, dtype=np.float32))
    assert np.all(read(picture) == np.float32(level))
    assert picture["high"] > picture["low"]


@pytest.fixture(scope="module")
def tab(chromium: Any, run: Path) -> Any:
    tab = chromium.new_context(viewport={"width": 1000, "height": 700}, offline=True).new_page()
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto((run / "view" / "index.html").as_uri())
    tab.errors = errors
    return tab


@pytest.fixture
def page(tab: Any) -> Any:
    """The page anew: no test sees what another one clicked."""
    tab.reload()
    tab.wait_for_function("document.getElementById('which').textContent.startsWith('frame 0 ')")
    return tab


def grey(page: Any, row: int, col: int) -> int:
    """What is shown at a pixel of a frame of 120 rows."""
    return int(
        page.evaluate(f"document.getElementById('picture').getContext('2d').getImageData({col}, {119 - row}, 1, 1).data[0]")
    )


def test_frames_are_there_at_full_resolution_and_step(page: Any) -> None:
    assert page.evaluate("[document.getElementById('picture').width, document.getElementById('picture').height]") == [160, 120]
    assert grey(page, 5, 7) == 255
    assert grey(page, 60, 80) > grey(page, 100, 20)
    page.focus("#stage")
    page.keyboard.press("ArrowRight")
    page.wait_for_function("document.getElementById('which').textContent.startsWith('frame 1 ')")
    page.keyboard.press("ArrowLeft")
    page.wait_for_function("document.getElementById('which').textContent.startsWith('frame 0 ')")
    assert page.errors == []


def test_zoom_stretch_and_layers(page: Any) -> None:
    page.focus("#stage")
    page.keyboard.press("0")
    before = page.evaluate("view.zoom")
    page.keyboard.press("+")
    assert page.evaluate("view.zoom") == pytest.approx(1.25 * before)
    dark = grey(page, 100, 20)
    page.select_option("#stretch", "log")
    assert grey(page, 100, 20) > dark
    page.select_option("#stretch", "linear")
    lines = page.locator("#overlay line").count()
    assert lines >= 2
    page.uncheck("input[value=published]")
    assert page.locator("#overlay line").count() < lines
    page.check("input[value=published]")
    page.click("#tosky")
    assert page.locator("#sky").is_visible()
    page.click("#tosky")
    assert page.errors == []


def test_the_trail_lies_between_its_lines_and_the_pixel_says_its_value(page: Any) -> None:
    """Ends of the lines drawn 6 px beside the trail, in picture coordinates whose rows grow downwards."""
    ends = json.loads(
        page.evaluate(
            "JSON.stringify([...document.querySelectorAll('#overlay line.published')].slice(0, 2)"
            ".map((l) => ['x1', 'y1', 'x2', 'y2'].map((n) => Number(l.getAttribute(n)))))"
        )
    )
    x0, y0, x1, y1 = np.mean(ends, axis=0)
    assert np.abs(np.array([119.5 - y0, x0 - 0.5, 119.5 - y1, x1 - 0.5]) - ENDS).max() < 2.0
    page.focus("#stage")
    page.keyboard.press("0")
    place = page.evaluate("document.getElementById('stage').getBoundingClientRect().toJSON()")
    zoom, x, y = page.evaluate("[view.zoom, view.x, view.y]")
    page.mouse.move(place["left"] + x + 7.5 * zoom, place["top"] + y + (119 - 5 + 0.5) * zoom)
    assert page.inner_text("#status") == "row 5, col 7: 1234"


def test_blink_goes_through_the_frames(page: Any) -> None:
    page.click("#blink")
    page.wait_for_function("document.getElementById('which').textContent.startsWith('frame 1 ')", timeout=5000)
    page.click("#blink")
    assert page.errors == []


@pytest.mark.parametrize(("scale", "offset", "spot"), [(1e-20, 0.0, 1.234e-17), (2e-4, -0.04, 1e20)])
def test_the_trail_is_seen_in_any_unit_and_beside_an_absurd_pixel(
    chromium: Any, run: Path, tmp_path: Path, scale: float, offset: float, spot: float
) -> None:
    """The frames times a number, with one pixel of their own: the trail is brighter than the sky; the pixel says its value."""
    copied, frames = tmp_path / "run", tmp_path / "frames"
    shutil.copytree(run, copied, ignore=shutil.ignore_patterns("view"))
    frames.mkdir()
    manifest = json.loads((copied / "manifest.json").read_text())
    for path in Path(manifest["sources"]["frames"]).iterdir():
        image = fits.getdata(path) * scale + offset
        image[5, 7] = spot
        fits.PrimaryHDU(image.astype(np.float32)).writeto(frames / path.name)
    manifest["sources"]["frames"] = str(frames)
    (copied / "manifest.json").write_text(json.dumps(manifest))
    tab = chromium.new_page(viewport={"width": 1000, "height": 700})
    tab.goto(write_page(RunFrames(path=copied), tmp_path / "view").as_uri())
    tab.wait_for_function("document.getElementById('which').textContent.startsWith('frame 0 ')")
    assert grey(tab, 5, 7) == 255
    assert grey(tab, 60, 80) > 100 > grey(tab, 100, 20)
    told = tab.evaluate("words(loaded.get('000000'), loaded.get('000000').levels[5 * 160 + 7])")
    assert told == pytest.approx(spot, rel=1e-3)
    tab.close()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["view/index.html", "report.html"])
@pytest.mark.slow
def test_viewer_and_report_of_outside_frames_fit(chromium: Any, run: Path, name: str, width: int, scheme: str) -> None:
    assert excess_and_errors(chromium, run / name, width, scheme) == (0, [])
