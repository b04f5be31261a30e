"""`fluxbench plugins`, `procedures`, `effects` and `schema`: lists and file formats."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from orchestrator.interface.cli._output import say, say_document
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
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
    """List every installed plugin; one that does not load is shown as broken, with the error."""
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


def procedures(name: str | None, as_json: bool) -> int:
    """List the shipped procedures, or print one."""
    if name is None:
        from orchestrator.config import load_procedure

        _list({known: load_procedure(known).summary for known in shipped_procedures()}, as_json)
        return 0
    try:
        text = shipped_procedure(name).removesuffix("\n")
    except KeyError:
        raise ProcedureError(name, "", f"no such procedure; there are {', '.join(shipped_procedures())}") from None
    if as_json:
        from orchestrator.config import load_procedure

        text = load_procedure(name).model_dump_json(indent=2)
    say_document(text)
    return 0


def effects(as_json: bool) -> int:
    """List the physical effects that a diagnosis knows."""
    plugins = {info.name: load_plugin(PluginKind.EFFECTS, info.name) for info in installed(PluginKind.EFFECTS)}
    _list({name: str(getattr(plugin, "summary", "")) for name, plugin in plugins.items()}, as_json)
    return 0


def _list(summaries: Mapping[str, str], as_json: bool) -> None:
    if as_json:
        say_document(json.dumps([{"name": name, "summary": text} for name, text in summaries.items()], indent=2))
        return
    widest = max(map(len, summaries), default=0)
    for name, text in summaries.items():
        say(f"{name:<{widest}}  {text}")


def schema(name: str, plugin: str | None, as_table: bool) -> int:
    """Print the JSON Schema of a file format or of a drive's options; of those, a table in Markdown as well."""
    from orchestrator.stages import with_stages

    if name == "drive" and plugin is None:
        drives = ", ".join(info.name for info in installed(PluginKind.DRIVES))
        raise InputError("schema", name, f"expected a drive's name after it, one of {drives}")
    if name != "drive" and plugin is not None:
        raise InputError("schema", plugin, f"a name goes with `schema drive` alone; `schema {name}` needs none")
    model = _model(name) if plugin is None else load_plugin(PluginKind.DRIVES, plugin).Options
    if as_table:
        from orchestrator.formatting.options import options_table

        say_document(options_table(model))
    else:
        say_document(json.dumps(with_stages(model.model_json_schema()), indent=2))
    return 0


def _model(name: str) -> type[BaseModel]:
    from orchestrator.config import MotorFile
    from orchestrator.importing import ImportMapping
    from orchestrator.runs import RunRecord
    from protocols import EstimationReport

    models: dict[str, type[BaseModel]] = {
        "procedure": Procedure,
        "motor": MotorFile,
        "recording": Manifest,
        "mapping": ImportMapping,
        "run": RunRecord,
        "estimates": EstimationReport,
    }
    if name not in models:
        raise InputError("schema", name, f"expected one of {', '.join(models)}, or `drive NAME`")
    return models[name]
