"""Compile the numerical kernels once, by running the smoke scenario into a folder that is then removed.

numba keeps what it compiled beside the modules, so that the first real run does not pay for it.
"""

import sys
import tempfile
import time
from pathlib import Path

from sboc_e2e.cli.main import run


def main() -> int:
    """Run the smoke scenario twice and print the cold and the warm time."""
    for word in ("cold", "warm"):
        with tempfile.TemporaryDirectory(prefix="sboc-warm-up-") as folder:
            start = time.perf_counter()
            code = run(["run", "smoke", "--out", str(Path(folder) / "run"), "--workers", "1"])
            if code:
                return code
            print(f"warm-up: smoke, {word}: {time.perf_counter() - start:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
