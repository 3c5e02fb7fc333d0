"""The on-board software alone in a process."""

import subprocess
import sys

PROGRAM = """
import sys
import numpy as np
from onboard.alone import start_compiler
from onboard.image.nearest import nearest
start_compiler()
distance, _ = nearest(np.array([[1.0, 2.0]]), np.array([[1.0, 3.0]]), 2.0)
assert distance[0] == 1.0
assert "scipy.linalg" not in sys.modules
import scipy.linalg.cython_blas
"""


def test_kernels_do_without_linear_algebra() -> None:
    """Kernels run, SciPy's linear algebra is not loaded for them, and can be loaded afterwards."""
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)
