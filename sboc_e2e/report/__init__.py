"""The report of a run: one self-contained HTML page for people, one short Markdown page for a CI job summary."""

from sboc_e2e.report.write import write_report

__all__ = ["write_report"]
