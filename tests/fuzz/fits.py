"""Fuzz target: any bytes as a FITS file, alone and as the tail of a valid header."""

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
_FOLDER = tempfile.TemporaryDirectory(prefix="sboc-fuzz-")


def one_input(data: bytes) -> None:
    """Frames of a file with these bytes: frames or a UserError."""
    for content in (data, HEADER + data):
        path = Path(_FOLDER.name) / "input.fits"
        path.write_bytes(content)
        try:
            for sourced in FitsFolder(path=path, max_pixels=MAX_PIXELS).frames():
                assert sourced.frame.pixels.ndim == 2
        except UserError as error:
            assert "\n" not in str(error)
