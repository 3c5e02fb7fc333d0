"""What a command loads before it begins: half of the time of `sboc process` on a small frame is the start."""

import json
import subprocess
import sys

HEAVY = (
    "matplotlib", "scipy.stats", "scipy.signal", "scipy.optimize", "scipy.interpolate", "scipy.fft", "scipy.spatial",
    "astropy.timeseries", "astropy.samp", "astropy.wcs", "astropy.coordinates", "rich",
)  # fmt: skip
"""Some 1.7 CPU-seconds together, for particles, PSFs, solved fields, orbits, light curves, pictures, tools. Most need none."""


def test_processing_frames_does_not_wait_for_libraries_that_it_does_not_need() -> None:
    code = (
        "import json, sys\n"
        "import sboc_e2e.cli.main, sboc_e2e.outside.process, sboc_e2e.outside.found, sboc_e2e.outside.page\n"
        "print(json.dumps(sorted(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert not set(HEAVY) & set(json.loads(done.stdout))


def test_a_large_frame_alone_is_read_before_most_libraries_are_loaded() -> None:
    """A process is forked there, and both load what they need at the same time."""
    code = "import json, sys\nimport sboc_e2e.cli.main, sboc_e2e.outside.lone_frame\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    loaded = set(json.loads(done.stdout))
    assert not {*HEAVY, "numba", "scipy.special", "scipy.ndimage", "scipy.linalg", "pydantic", "astropy.table"} & loaded


def test_an_interrupt_while_libraries_load_is_one_line() -> None:
    code = (
        "import sys\n"
        "class Interrupts:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'typer':\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupts())\n"
        "from sboc_e2e.__main__ import main\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, text=True)
    assert (done.returncode, done.stderr) == (2, "sboc: interrupted before anything was done\n")
