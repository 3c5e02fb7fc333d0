"""Pages in a headless Chromium, as phones and wide screens show them."""

from pathlib import Path
from typing import Any, Final

WIDTHS: Final = (400, 1000, 1600)
SCHEMES: Final = ("light", "dark")


def excess_and_errors(chromium: Any, page: Path, width: int, scheme: str) -> tuple[int, list[str]]:
    """Pixels by which a page is wider than the window, and what its scripts complained of."""
    tab = chromium.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(page.as_uri())
    excess = max(0, int(tab.evaluate("document.documentElement.scrollWidth")) - width)
    tab.close()
    return excess, errors
