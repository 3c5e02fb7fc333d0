"""A run is one TOML file: models derived from the segments' option dataclasses, presets, overrides, JSON schema."""

from sboc_e2e.scenario.document import Component, OutputOptions, Scenario, available, bare, find, from_document, load, tables

__all__ = ["Component", "OutputOptions", "Scenario", "available", "bare", "find", "from_document", "load", "tables"]
