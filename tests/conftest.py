"""Settings that hold for every test: one thread per process, no network, offline time tables."""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

from sboc_e2e.kernel_cache import use_cache_of_these_sources

use_cache_of_these_sources()

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from astropy.utils import iers
from hypothesis import HealthCheck, settings

iers.conf.auto_download = False
iers.conf.auto_max_age = None
iers.conf.iers_degraded_accuracy = "ignore"

settings.register_profile("house", deadline=None, derandomize=True, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("house")

LONGEST = ("tests/docs/test_commands.py", "tests/end_to_end/test_shipped_scenarios.py")
"""Files of many minutes: where tests run on several cores they begin first, so that none of them is left for the end alone."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first, the longest before them; within a file as written."""
    slow = {item.nodeid.partition("::")[0] for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: _rank(item.nodeid.partition("::")[0], slow))


def _rank(file: str, slow: set[str]) -> int:
    return LONGEST.index(file) if file in LONGEST else len(LONGEST) + (file not in slow)


SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of reference data that is not part of the project; tests that need it are skipped without it."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"reference data not present: {folder}")
    return folder


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A headless Chromium for one module; tests skip without it. Its event loop ends with it, as tests of dask need."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no Chromium installed (package chromium)")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    flags = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run"]
    with api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=flags)
        yield browser
        browser.close()
