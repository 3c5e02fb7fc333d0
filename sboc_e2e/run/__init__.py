"""A run: stages over a run directory, streamed frame by frame, to be resumed after any interruption."""

from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.pipeline import RunRequest, run

__all__ = ["RunDirectory", "RunRequest", "run"]
