"""What a run says last on the terminal: its headlines, and what of its published files is not as it should be."""

from collections.abc import Mapping
from typing import Any, Final

from sboc_e2e.report.headlines import headline_rows
from sboc_e2e.report.published_files import missed

LEAST_COMPILATION_S: Final = 1.0
"""Least compilation time that is reported."""


def closing_text(score: Mapping[str, Any], stages: Mapping[str, Mapping[str, Any]]) -> str:
    """Lines without a newline at the end. stages : what the manifest says of each stage."""
    rows = headline_rows(score)
    width = max(len(label) for label, _, _ in rows)
    lines = [f"{label:<{width}}  {value}{f'  ({note})' if note else ''}" for label, value, note in rows]
    bad = missed(score)
    if bad:
        lines.append("Published files miss what they should be (see docs/products.md):")
        lines += [f"  {row.label}: {row.value}, should be {row.aim}" for row in bad]
    compiled_s = sum(stage.get("compile_cpu_s", 0.0) for stage in stages.values())
    if compiled_s > LEAST_COMPILATION_S:
        lines.append(f"Compiling numerical kernels took {compiled_s:.0f} CPU-s, once; no figure above holds it.")
    return "\n".join(lines)
