"""Compiled kernels belong to the sources they were compiled from."""

import ast
import os
import tempfile
from pathlib import Path

import pytest

from sboc_e2e import kernel_cache

ROOT = Path(kernel_cache.__file__).resolve().parents[1]


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


KERNEL = """\
import numba as nb

from ground.constants import (
    LEAST,  # written into the machine code
    PLAIN,
)
from ground.several import HANDED_ON, SUM
from sboc_e2e.icd import signals


@nb.njit(
    cache=True,
)
def kernel(x):
    return x > LEAST + HANDED_ON + signals.FIXED_POINT + _TWICE


_TWICE = 2 * SUM


def plain(x):
    return x > PLAIN
"""


@pytest.mark.parametrize(
    ("module", "old", "new", "matters"),
    [
        ("ground/constants.py", "LEAST: Final = 1", "LEAST: Final = 2", True),
        ("ground/origin.py", "HANDED_ON = 1", "HANDED_ON = 2", True),
        ("ground/parts.py", "def part", "def  part", True),
        ("sboc_e2e/icd/signals.py", "FIXED_POINT = 1", "FIXED_POINT = 2", True),
        ("ground/unused.py", "UNUSED = 1", "UNUSED = 2", False),
        ("sboc_e2e/icd/other.py", "OTHER = 1", "OTHER = 2", False),
    ],
)
def test_an_edit_of_a_constant_that_a_kernel_uses_changes_the_folder_and_no_other_edit_does(
    tmp_path: Path, module: str, old: str, new: str, matters: bool
) -> None:
    """numba writes constants of other modules into machine code, and does not look at these modules again."""
    files = {
        "ground/kernel.py": KERNEL,
        "ground/constants.py": "from ground.unused import UNUSED\n\nLEAST: Final = 1\nPLAIN = UNUSED\n",
        "ground/several.py": "from ground.origin import HANDED_ON\nfrom ground.parts import part\n\nSUM = part()\n",
        "ground/origin.py": "HANDED_ON = 1\n",
        "ground/parts.py": "def part():\n    return 1\n",
        "ground/unused.py": "UNUSED = 1\n",
        "sboc_e2e/icd/__init__.py": "",
        "sboc_e2e/icd/signals.py": "FIXED_POINT = 1\n",
        "sboc_e2e/icd/other.py": "OTHER = 1\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    before = kernel_cache.source_digest(tmp_path)
    (tmp_path / module).write_text(files[module].replace(old, new))
    assert (kernel_cache.source_digest(tmp_path) != before) == matters


def test_the_constants_of_the_projects_kernels_belong_to_their_sources() -> None:
    """And the pages of reports do not."""
    found = kernel_cache.constant_modules(ROOT)
    assert {
        "onboard/image/least_noise.py",
        "ground/link/hypotheses.py",
        "sboc_e2e/icd/signals.py",
        "simulator/radiation/energy_loss.py",
    } <= set(found)
    assert not [name for name in found if name.startswith(("sboc_e2e/report", "sboc_e2e/run", "sboc_e2e/score", "sboc_e2e/cli"))]


def test_imports_are_read_as_the_parser_reads_them() -> None:
    """The digest reads them with regular expressions, for speed: every project import of a module with kernels."""
    for package in kernel_cache.PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_bytes()
            if b"import numba" not in text and b"from numba" not in text:
                continue
            expected = {
                (alias.asname or alias.name).encode(): (node.module.encode(), alias.name.encode())
                for node in ast.parse(text).body
                if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] in kernel_cache.PACKAGES
                for alias in node.names
            }
            assert kernel_cache._Module(text).imported == expected, path
            assert b"\nimport ground" not in text
            assert b"\nimport onboard" not in text


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


def test_without_a_home_that_can_be_written_kernels_go_to_a_folder_of_this_user_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a container no command ran: numba refuses kernels that it can keep nowhere."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "below"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    kernel_cache.use_cache_of_these_sources()
    kept = Path(os.environ["NUMBA_CACHE_DIR"])
    assert kept.is_dir()
    assert kept.parent.parent == tmp_path
    assert kept.parent.stat().st_mode & 0o077 == 0
    kept.parent.chmod(0o777)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    kernel_cache.use_cache_of_these_sources()
    assert "NUMBA_CACHE_DIR" not in os.environ, "anyone could put machine code there"


def test_without_any_folder_that_can_be_written_the_program_is_still_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba then looks for places of its own; Python names no folder of temporary files, and finds no home."""

    def none() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found")

    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    monkeypatch.setattr(tempfile, "gettempdir", none)
    kernel_cache.use_cache_of_these_sources()
    assert "NUMBA_CACHE_DIR" not in os.environ
