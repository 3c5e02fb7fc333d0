"""Waiting for what a process of its own does."""

import subprocess
import time
from pathlib import Path


def wait_for(path: Path, process: subprocess.Popen[bytes]) -> None:
    """Until the path is there or the process has ended; two minutes at most."""
    deadline = time.monotonic() + 120.0
    while not path.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
