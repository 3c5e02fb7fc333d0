"""docs/steps.md from the code: every seam, its Protocol, the shipped steps with source, options, units and defaults.

``python -m sboc_e2e.step_pages docs/steps.md`` writes the page; a test holds it to the code.
"""

import argparse
import inspect
from pathlib import Path
from typing import Any

from sboc_e2e.registry import SEAMS, Registry, Seam, own_names
from sboc_e2e.scenario.option_models import option_fields, to_document

HEAD = """# Steps that can be swapped

Generated from the code by `python -m sboc_e2e.step_pages docs/steps.md`. A step is a frozen dataclass whose fields are the
options below; a scenario chooses it with a table such as

    [onboard.detector]
    use = "line_integral"
    n_sigma = 7.2

and a command line with `--use onboard.detector=my_lab.nets:StreakNet`. Entry-point groups are `sboc_e2e.<seam>`.
"""


def page() -> str:
    """The whole page."""
    registry = Registry()
    parts = [HEAD]
    for seam in SEAMS.values():
        parts.append(f"\n## {seam.name}\n\n{_summary(seam.protocol)}\n")
        parts.append("```python\n" + "\n".join(_signature(seam, method) for method in seam.methods) + "\n```\n")
        for name in own_names(seam.name):
            step = registry.resolve(seam.name, name)
            default = " (default)" if name == seam.default else ""
            parts.append(f"\n### `{name}`{default}\n\n{inspect.cleandoc(step.__doc__ or '')}\n\n{_options(step)}")
    return "".join(parts)


def _summary(thing: type) -> str:
    return inspect.cleandoc(thing.__doc__ or "").splitlines()[0]


def _signature(seam: Seam, method: str) -> str:
    function = getattr(seam.protocol, method)
    words = inspect.cleandoc(function.__doc__ or "").splitlines()
    names = inspect.signature(function).parameters
    return f"{method}({', '.join(names)})" + (f"  # {words[0]}" if words else "")


def _options(step: type) -> str:
    fields = option_fields(step)
    if not fields:
        return "No options.\n"
    defaults: dict[str, Any] = to_document(step())
    rows = ["| option | default | meaning |", "|---|---|---|"]
    for option in fields:
        default = defaults.get(option.key)
        shown = "none" if default is None else f"`{default}`".replace("|", "/")
        rows.append(f"| `{option.key}` | {shown} | {option.doc} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.step_pages", description="Write the page of steps.")
    parser.add_argument("page", type=Path, help="the page's file, docs/steps.md")
    parser.parse_args().page.write_text(page(), encoding="utf-8")
