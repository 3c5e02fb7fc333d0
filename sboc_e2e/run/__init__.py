"""A run: stages over a run directory, streamed frame by frame, to be resumed after any interruption."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sboc_e2e.run.directory import RunDirectory
    from sboc_e2e.run.pipeline import RunRequest, run

__all__ = ["RunDirectory", "RunRequest", "run"]

_HOMES: Final = {"RunDirectory": "directory", "RunRequest": "pipeline", "run": "pipeline"}


def __getattr__(name: str) -> Any:
    """Import on first use: processes that make frames need a module of this package, not the report and its plots."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
