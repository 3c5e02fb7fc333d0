"""Run one benchmark module and leave its result as JSON: ``python -m tests.benchmarks.driver bench_codecs quick OUT``."""

import importlib
import inspect
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """NumPy scalars and arrays as JSON knows them."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


def main(module: str, size: str, out: str) -> None:
    """Call the module's ``main(quick=...)`` and write what it returns."""
    bench = importlib.import_module(f"tests.benchmarks.{module}").main
    quick = {"quick": size == "quick"} if "quick" in inspect.signature(bench).parameters else {}
    Path(out).write_text(json.dumps(bench(**quick), default=plain, indent=1))


if __name__ == "__main__":
    main(*sys.argv[1:])
