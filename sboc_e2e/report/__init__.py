"""The report of a run: one self-contained HTML page for people, one short Markdown page for a CI job summary."""
