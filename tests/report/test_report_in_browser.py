"""A person's way through the report, in a real headless Chromium."""

from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def tab(chromium: Any, reported_run: Path) -> Any:
    tab = chromium.new_context(viewport={"width": 1280, "height": 900}, offline=True).new_page()
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto((reported_run / "report.html").as_uri())
    tab.errors = errors
    return tab


@pytest.fixture
def page(tab: Any) -> Any:
    """The page anew: no test sees what another one clicked."""
    tab.mouse.move(0, 0)
    tab.reload()
    return tab


def test_frames_step_and_layers_toggle(page: Any) -> None:
    assert page.inner_text("#which").startswith("frame 0 ")
    page.focus("#viewer")
    page.keyboard.press("ArrowRight")
    assert page.inner_text("#which").startswith("frame 1 ")
    page.keyboard.press("ArrowLeft")
    shown = page.locator("#overlay polyline").count()
    assert shown > 0
    page.keyboard.press("t")
    assert page.locator("#overlay polyline").count() < shown
    page.keyboard.press("t")
    assert page.locator("#overlay polyline").count() == shown


def test_the_pointer_reads_place_and_brightness(page: Any) -> None:
    """The frame's noise of 3 ADU lies about 100 ADU: the grey under the pointer turns back into that."""
    page.locator("#viewer").scroll_into_view_if_needed()
    box = page.locator("#viewer").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    words = page.inner_text("#pointer")
    assert words.startswith("row 127.5, col 127.5")
    assert 80 < float(words.split(" · ")[-1].split()[0]) < 120


def test_frames_play_and_blink(page: Any) -> None:
    before = page.inner_text("#which")
    page.locator("#play").click()
    page.wait_for_function("(shown) => document.getElementById('which').innerText !== shown", arg=before)
    page.locator("#blink").click()
    assert page.get_attribute("#play", "aria-pressed") == "false"
    assert page.get_attribute("#blink", "aria-pressed") == "true"
    page.keyboard.press("b")
    assert page.get_attribute("#blink", "aria-pressed") == "false"
    while not page.inner_text("#which").startswith("frame 0 "):
        page.keyboard.press("ArrowLeft")


def test_the_legend_has_every_class_that_is_drawn(page: Any) -> None:
    shown = page.evaluate("[...document.querySelectorAll('.legend i')].map((i) => getComputedStyle(i).color)")
    assert len(shown) == len(set(shown)) == 8


def test_picture_is_there_and_zooms(page: Any) -> None:
    assert page.evaluate("document.getElementById('picture').naturalWidth") > 0
    page.focus("#viewer")
    page.keyboard.press("+")
    assert "scale(1.25)" in page.evaluate("document.getElementById('stage').style.transform")
    page.keyboard.press("-")


def test_a_miss_opens_with_its_reason(page: Any) -> None:
    page.locator('[data-cases="misses"] button').first.click()
    assert page.locator("#case").is_visible()
    words = page.inner_text("#case-body")
    assert "S/N 20" in words
    assert "not detected on board" in words or "did not arrive" in words
    assert page.evaluate("document.querySelector('#case-body img').naturalWidth") == 96
    page.keyboard.press("Escape")
    assert not page.locator("#case").is_visible()


def test_false_alarm_opens(page: Any) -> None:
    page.locator('[data-cases="false_alarms"] button').first.click()
    assert "no truth streak matches" in page.inner_text("#case-body")
    page.locator("#close").click()


def test_tables_sort(page: Any) -> None:
    column = "#figures table.sortable:first-of-type tbody td:first-child"
    page.locator("#figures table.sortable th").first.click()
    rising = page.locator(column).first.inner_text()
    page.locator("#figures table.sortable th").first.click()
    assert page.locator(column).first.inner_text() != rising


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1000, 1600])
def test_fits_phone_and_laptop_in_both_schemes(page: Any, scheme: str, width: int) -> None:
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert len(page.screenshot()) > 10_000
    page.set_viewport_size({"width": 1280, "height": 900})


def test_no_script_error(page: Any) -> None:
    assert page.errors == []
