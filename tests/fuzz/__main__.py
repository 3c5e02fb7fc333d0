"""``python -m tests.fuzz TARGET [-runs=N ...]``: a target under atheris, with the parsers instrumented for coverage.

An input that breaks the promise is left in the working folder as crash-*, timeout-* or oom-*; after the mend it belongs
into tests/fuzz/found/TARGET, where the tests run it for ever.
"""

import importlib
import sys
import tempfile
from pathlib import Path

import atheris

TARGETS = {
    "packets": ["ground.ingest"],
    "codecs": ["ground.ingest"],
    "fits": [
        *(f"sboc_e2e.outside.{name}" for name in ("fits_frames", "header_times", "header_values", "header_scale")),
        "astropy.io.fits",
    ],
    "scenario": ["sboc_e2e.scenario", "sboc_e2e.registry", "tomllib"],
}
"""Each target and the modules that are instrumented for it."""

COMPILED = ["ground.ingest.rans"]
"""Never instrumented: numba cannot compile what atheris has changed."""

HANG_S = 10

if __name__ == "__main__":
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if name not in TARGETS:
        sys.exit(f"tests.fuzz: expected one of {', '.join(TARGETS)}, got {name!r}")
    with atheris.instrument_imports(include=TARGETS[name], exclude=COMPILED):
        target = importlib.import_module(f"tests.fuzz.{name}")
    seeds = importlib.import_module("tests.fuzz.seeds")
    limits = importlib.import_module("tests.fuzz.limits")
    with tempfile.TemporaryDirectory(prefix="sboc-fuzz-") as folder:
        sys.argv += [f"-timeout={HANG_S}", *seeds.write(name, Path(folder))]
        limits.fuzz(target.one_input)
