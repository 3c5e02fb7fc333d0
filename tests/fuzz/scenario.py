"""Fuzz target: any text as a scenario file."""

from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import from_document, toml_files

REGISTRY = Registry()


def one_input(data: bytes) -> None:
    """A scenario or a UserError of one line."""
    try:
        tables = toml_files.parse(data.decode("utf-8", errors="replace"), "fuzz")
        document = toml_files.with_presets(tables, toml_files.FOLDER, "fuzz")
        from_document(document, name="fuzz", registry=REGISTRY, where="fuzz")
    except UserError as error:
        assert "\n" not in str(error)
