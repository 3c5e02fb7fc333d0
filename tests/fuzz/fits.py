"""Fuzz target: any bytes as a FITS file; those that do not begin as one follow the start of a valid header."""

import os
import tempfile
from pathlib import Path

from sboc_e2e.icd.errors import UserError
from sboc_e2e.outside.fits_frames import FitsFolder

HEADER = "".join(
    f"{card:<80}"
    for card in (
        "SIMPLE  =                    T", "BITPIX  =                   16", "NAXIS   =                    2",
        "NAXIS1  =                   16", "NAXIS2  =                   16",
    )
).encode()  # fmt: skip
MAX_PIXELS = 1 << 20
_MEMORY = Path("/dev/shm")  # noqa: S108 - the name inside is random
_FOLDER = tempfile.TemporaryDirectory(prefix="sboc-fuzz-", dir=_MEMORY if os.access(_MEMORY, os.W_OK) else None)
"""A million files are written fast only where no disk is behind them."""


def one_input(data: bytes) -> None:
    """Frames of a file: frames or a UserError."""
    path = Path(_FOLDER.name) / "input.fits"
    path.write_bytes(data if data.startswith(HEADER[:8]) else HEADER + data)
    try:
        for sourced in FitsFolder(path=path, max_pixels=MAX_PIXELS).frames():
            assert sourced.frame.pixels.ndim == 2
    except UserError as error:
        assert "\n" not in str(error)
