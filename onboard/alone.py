"""A process that runs nothing but the on-board software, as it would fly: what of its libraries it can do without.

Runs of `sboc` share their process with the simulator and the ground half, and do not use this.
"""

import sys
from typing import Final

from numba.core.registry import cpu_target

LINEAR_ALGEBRA: Final = "scipy.linalg.cython_blas"


def start_compiler() -> None:
    """Make numba ready before the first kernel without SciPy's linear algebra, which it would load if it can: 17 MB.

    Matrix products in kernels, of which there are none on board, are refused in this process from then on.
    """
    found = sys.modules.get(LINEAR_ALGEBRA)
    sys.modules[LINEAR_ALGEBRA] = None  # type: ignore[assignment] # how Python is told that there is no such module
    try:
        cpu_target.target_context.refresh()
    finally:
        del sys.modules[LINEAR_ALGEBRA]
        if found is not None:
            sys.modules[LINEAR_ALGEBRA] = found
