"""What a command of many shards wrote down about its folder, by which it knows later that the folder is its own."""

import json
from collections.abc import Set
from pathlib import Path
from typing import Any

from sboc_e2e.icd.errors import UserError


def identity_in(path: Path, keys: Set[str], maker: str) -> dict[str, Any] | None:
    """The content of an identity file; None without the file. keys : those that every one has; maker : as in "a campaign".

    UserError for a file that is nobody's.
    """
    if not path.exists():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: not readable; --out goes elsewhere") from error
    if not isinstance(found, dict) or keys - set(found):
        raise UserError(f"{path}: was not written by {maker}; --out goes elsewhere")
    return found


def refuse_strangers(out: Path, folders: tuple[str, ...], identity: str, kind: str) -> None:
    """UserError where folders hold files without the identity that tells whose they are: even --force leaves them alone."""
    for name in folders:
        if (folder := out / name).is_dir() and any(folder.iterdir()):
            raise UserError(
                f"{folder}: holds files of an unknown {kind} or of something else (no {identity}); --out goes elsewhere"
            )
