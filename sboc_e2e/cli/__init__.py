"""Command line: thin commands over the harness, exit codes, progress."""

from sboc_e2e.cli.main import main, run

__all__ = ["main", "run"]
