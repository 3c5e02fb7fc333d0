"""What a run says last on the terminal: its headlines, and what of its published files is not as it should be."""

from collections.abc import Mapping
from typing import Any

from sboc_e2e.report.headlines import headline_rows
from sboc_e2e.report.published_files import missed


def closing_text(score: Mapping[str, Any]) -> str:
    """Lines without a newline at the end."""
    rows = headline_rows(score)
    width = max(len(label) for label, _, _ in rows)
    lines = [f"{label:<{width}}  {value}{f'  ({note})' if note else ''}" for label, value, note in rows]
    bad = missed(score)
    if bad:
        lines.append("Published files miss what they should be:")
        lines += [f"  {row.label}: {row.value}, should be {row.aim}" for row in bad]
    return "\n".join(lines)
