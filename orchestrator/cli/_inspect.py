"""`fluxbench plugins`, `procedures` and `schema`: what there is."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel

from orchestrator.cli._output import say, say_document
from orchestrator.registry import PluginKind, installed, load_plugin
from protocols import (
    InputError,
    Manifest,
    PluginError,
    Procedure,
    ProcedureError,
    shipped_procedure,
    shipped_procedures,
)


def plugins(as_json: bool) -> int:
    """List every installed plugin; one that does not load is said to be broken, and why."""
    rows = [_row(kind, info.name) | info.model_dump(mode="json") for kind in PluginKind for info in installed(kind)]
    if as_json:
        say_document(json.dumps(rows, indent=2))
        return 0
    for row in rows:
        state = "ok" if row["loads"] else f"broken: {row['problem']}"
        say(f"{row['kind']:<11} {row['name']:<14} {row['distribution']} {row['version']}  {row['module']}  {state}")
    return 0


def _row(kind: PluginKind, name: str) -> dict[str, Any]:
    try:
        plugin = load_plugin(kind, name)
    except PluginError as error:
        return {"kind": kind.value, "loads": False, "problem": str(error), "summary": None}
    return {"kind": kind.value, "loads": True, "problem": None, "summary": getattr(plugin, "summary", None)}


def procedures(name: str | None) -> int:
    """List the shipped procedures, or print one."""
    if name is None:
        from orchestrator.config import load_procedure

        for known in shipped_procedures():
            say(f"{known:<8} {load_procedure(known).summary}")
        return 0
    try:
        say_document(shipped_procedure(name).removesuffix("\n"))
    except KeyError:
        raise ProcedureError(name, "", f"no such procedure; there are {', '.join(shipped_procedures())}") from None
    return 0


def schema(name: str) -> int:
    """Print the JSON Schema of a file format."""
    from orchestrator.runs import RunRecord
    from orchestrator.stages import with_stages
    from protocols import EstimationReport

    models: dict[str, type[BaseModel]] = {
        "procedure": Procedure,
        "recording": Manifest,
        "run": RunRecord,
        "estimates": EstimationReport,
    }
    if name not in models:
        raise InputError("schema", name, f"expected one of {', '.join(models)}")
    say_document(json.dumps(with_stages(models[name].model_json_schema()), indent=2))
    return 0
