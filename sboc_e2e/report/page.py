"""Small self-contained pages in the report's dress: comparisons, benchmarks, campaigns."""

from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from typing import Any


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A sortable table of escaped cells."""
    top = "".join(f"<th>{escape(str(c))}</th>" for c in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table class="sortable"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def simple_page(title: str, body: Iterable[str]) -> str:
    """A page from pieces of HTML."""
    folder = resources.files("sboc_e2e.report")
    css = (folder / "page.css").read_text(encoding="utf-8")
    js = (folder / "sort.js").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{css}</style></head><body><header><h1>{escape(title)}</h1></header><main>"
        + "\n".join(body)
        + f"</main><script>{js}</script></body></html>\n"
    )
