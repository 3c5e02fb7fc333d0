"""Figures as words: the one way in which reports print a value with its interval."""

import math
from typing import Any, Final

ZERO: Final = 1e-9
"""Numbers below this share of the larger end of their interval are shown as zero."""

Row = tuple[str, str, str]
"""Name, value with interval, n or reason."""


def number(value: float) -> str:
    """Four significant digits, thousands grouped, no needless exponent."""
    if not math.isfinite(value):
        return "-"
    if value == int(value) and abs(value) < 1e15:
        return f"{int(value):,}"
    if 1e-3 <= abs(value) < 1e6:
        digits = max(0, 3 - math.floor(math.log10(abs(float(f"{value:.4g}")))))
        return f"{value:,.{digits}f}"
    return f"{value:.3g}"


def is_figure(item: Any) -> bool:
    """Whether a node of score.json is a figure."""
    return isinstance(item, dict) and "value" in item and "n" in item


def figure_words(figure: dict[str, Any]) -> tuple[str, str]:
    """Value with interval, and n or the reason of its absence."""
    if figure["value"] is None:
        return "-", figure.get("reason", "no reason was recorded")
    # Beside its ends a digit that far behind the comma is what arithmetic left of a zero.
    least = ZERO * max(abs(figure["low"]), abs(figure["high"]))
    low, high, value = (0.0 if abs(figure[name]) < least else figure[name] for name in ("low", "high", "value"))
    text = number(value)
    if low != high:
        text += f"  [{number(low)}, {number(high)}]"
    return text, f"n = {figure['n']:,}" if figure["n"] else ""


def section_rows(section: dict[str, Any], prefix: str = "") -> list[Row]:
    """All figures of a section, nested names joined by a dot; lists and plain dictionaries of numbers left out."""
    rows: list[Row] = []
    for name, item in section.items():
        if is_figure(item):
            rows.append((prefix + name, *figure_words(item)))
        elif isinstance(item, dict) and any(isinstance(v, dict) for v in item.values()):
            rows += section_rows(item, f"{prefix}{name}.")
    return rows
