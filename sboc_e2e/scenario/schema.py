"""JSON schema of scenario files, for editors; the committed copy is scenarios/schema.json."""

import json
from typing import Any, Final

from sboc_e2e.registry import SEAMS, Registry, own_names
from sboc_e2e.scenario import option_models, toml_files
from sboc_e2e.scenario.document import PRESET_TABLES, scenario_model

COMMITTED: Final = toml_files.FOLDER / "schema.json"


def schema() -> dict[str, Any]:
    """Schema of a scenario: all tables, and for each seam the options of the steps that this project ships."""
    tables = scenario_model().model_json_schema(by_alias=True)
    definitions: dict[str, Any] = tables.setdefault("$defs", {})
    registry = Registry()
    for seam in SEAMS.values():
        segment, _, key = seam.name.partition(".")
        arms: list[dict[str, Any]] = []
        known = own_names(seam.name)
        for name in known:
            step = option_models.model_of(registry.resolve(seam.name, name)).model_json_schema(by_alias=True)
            definitions |= step.pop("$defs", {})
            use = {"const": name, "description": f"step of {seam.name}"}
            if name == seam.default:
                use["default"] = name
            step["properties"] = {"use": use, **step.get("properties", {})}
            step["title"] = f"{seam.name}: {name}"
            if name != seam.default:
                step["required"] = ["use", *step.get("required", [])]
            arms.append(step)
        foreign = {"type": "string", "not": {"enum": list(known)}, "description": "an installed or trusted plug-in"}
        arms.append({"type": "object", "properties": {"use": foreign}, "required": ["use"], "title": f"{seam.name}: plug-in"})
        _table(tables, segment)["properties"][key] = {"anyOf": arms, "description": (seam.protocol.__doc__ or "").strip()}
    for table_name in PRESET_TABLES:
        _table(tables, table_name)["properties"].setdefault(
            "preset",
            {"type": "string", "description": "fragment of scenarios/presets that lies under this scenario's own keys"},
        )
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **tables}


def text() -> str:
    """The schema as it is committed."""
    return json.dumps(schema(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _table(tables: dict[str, Any], name: str) -> dict[str, Any]:
    """Definition behind a property that is a reference."""
    found: dict[str, Any] = tables["properties"][name]
    reference = found.get("$ref") or next((arm["$ref"] for arm in found.get("allOf", ()) if "$ref" in arm), None)
    return tables["$defs"][reference.rpartition("/")[2]] if reference else found
