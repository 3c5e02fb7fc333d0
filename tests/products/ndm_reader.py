"""Messages as an independent reader, ccsds-ndm, understands them; tests that import this are skipped without it."""

import warnings
from pathlib import Path
from typing import Any

import pytest

ndm_io = pytest.importorskip("ccsds_ndm.ndm_io", reason="the conformance reader ccsds-ndm is not installed")


def read(text: str, tmp_path: Path) -> Any:
    """The message as ccsds-ndm understands it."""
    path = tmp_path / "message.kvn"
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the reader's own dependencies warn
        return ndm_io.NdmIo().from_path(path)
