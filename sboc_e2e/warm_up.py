"""Compile the numerical kernels once, by running the smoke scenario into a folder that is then removed.

numba keeps what it compiled (`sboc_e2e.kernel_cache`), so that the first real run and benchmarks do not pay for it.
"""

import sys
import tempfile
import time
from pathlib import Path

from sboc_e2e.cli.main import run


def main() -> int:
    """Run the smoke scenario and print how long it took: a minute where all is to be compiled, seconds where nothing is."""
    with tempfile.TemporaryDirectory(prefix="sboc-warm-up-") as folder:
        start = time.perf_counter()
        code = run(["run", "smoke", "--out", str(Path(folder) / "run"), "--workers", "1"])
    if code == 0:
        print(f"warm-up: {time.perf_counter() - start:.1f} s")
    return code


if __name__ == "__main__":
    sys.exit(main())
