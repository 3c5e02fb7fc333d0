"""Make the environment of the peers: ``python -m tests.benchmarks.peers.install`` (about 3 GB, TensorFlow comes with SatSim)."""

import subprocess
import sys
import venv

from tests.benchmarks.peers.environment import FOLDER, PYTHON

REQUIREMENTS = FOLDER.parent / "tests" / "benchmarks" / "peers" / "requirements.txt"


def main() -> None:
    """Create .peers/ beside the project's own environment and install what requirements.txt names."""
    if not PYTHON.exists():
        venv.create(FOLDER, with_pip=True)
    subprocess.run([str(PYTHON), "-m", "pip", "install", "--quiet", "-r", str(REQUIREMENTS)], check=True)
    sys.stdout.write(f"{PYTHON}\n")


if __name__ == "__main__":
    main()
