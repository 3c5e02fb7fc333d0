"""Benchmarks, each a module to run. They use the kernels of the present sources, as every command and test does."""

import os

if "NUMBA_CACHE_DIR" not in os.environ:  # a process whose memory is measured is given the folder, and loads nothing for it
    from sboc_e2e.kernel_cache import use_cache_of_these_sources

    use_cache_of_these_sources()
