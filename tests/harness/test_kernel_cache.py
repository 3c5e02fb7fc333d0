"""Compiled kernels belong to the sources they were compiled from."""

import os
from pathlib import Path

import pytest

from sboc_e2e import kernel_cache


def sources(root: Path, body: str) -> Path:
    for package in kernel_cache.PACKAGES:
        (root / package).mkdir(parents=True, exist_ok=True)
    (root / "ground" / "inlined.py").write_text(f"from numba import njit\n\n@njit\ndef f(x):\n    return {body}\n")
    (root / "ground" / "kernel.py").write_text("from numba import njit\n\n@njit\ndef g(x):\n    return f(x)\n")
    (root / "ground" / "words.py").write_text("text = 1\n")
    return root


def test_an_edit_of_an_inlined_function_changes_the_folder(tmp_path: Path) -> None:
    before = kernel_cache.source_digest(sources(tmp_path, "x"))
    (tmp_path / "ground" / "words.py").write_text("text = 2\n")
    assert kernel_cache.source_digest(tmp_path) == before
    assert kernel_cache.source_digest(sources(tmp_path, "x + 1")) != before


def test_old_folders_go_and_the_users_choice_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    root = tmp_path / "sboc-e2e" / "kernels"
    for k in range(5):
        (root / f"old{k}").mkdir(parents=True)
        os.utime(root / f"old{k}", (1000 + k, 1000 + k))
    kernel_cache.use_cache_of_these_sources()
    assert Path(os.environ["NUMBA_CACHE_DIR"]).is_dir()
    assert len(list(root.iterdir())) == kernel_cache.KEPT_DIGESTS
    monkeypatch.setenv("NUMBA_CACHE_DIR", "elsewhere")
    kernel_cache.use_cache_of_these_sources()
    assert os.environ["NUMBA_CACHE_DIR"] == "elsewhere"
