"""Text files that a user names, read with one-line errors."""

from pathlib import Path
from typing import Final

from sboc_e2e.icd.errors import UserError

_LARGEST_BYTES: Final = 400_000_000
"""Chosen, not measured: all objects of the public catalogue (some 30,000) with 10 kB each fit; a larger file is no text of
messages."""


def text_of(path: Path) -> str:
    """The text of a file; UserError where there is none, or no text."""
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise UserError(f"{path}: larger than {_LARGEST_BYTES / 1e6:.0f} MB; expected a message or a catalogue")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise UserError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise UserError(f"{path}: is a folder; a file is expected") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: no text file; messages are expected as KVN in UTF-8") from error
