"""JSON Schema of a procedure's entries: one of the installed stages, each with its settings."""

from __future__ import annotations

from typing import Any

from orchestrator.stages._parsing import installed_stages
from protocols import Stage, StageEntry


def with_stages(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema of a file with `StageEntry` in it, the installed stages in its place."""
    definitions = schema.get("$defs", {})
    if StageEntry.__name__ not in definitions:
        return schema
    stages = {plugin.name: plugin for plugin in installed_stages()}
    references = {name: {"$ref": f"#/$defs/{plugin.__name__}"} for name, plugin in stages.items()}
    for plugin in stages.values():
        own = _schema_of(plugin)
        definitions |= own.pop("$defs", {}) | {plugin.__name__: own}
    definitions[StageEntry.__name__] = {
        "oneOf": list(references.values()),
        "discriminator": {"propertyName": "kind", "mapping": {name: r["$ref"] for name, r in references.items()}},
    }
    return schema


def _schema_of(plugin: type[Stage]) -> dict[str, Any]:
    schema = plugin.model_json_schema()
    schema["properties"] = {"kind": {"const": plugin.name, "type": "string"}, **schema.get("properties", {})}
    schema["required"] = ["kind", *schema.get("required", [])]
    return schema
