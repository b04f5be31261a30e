"""`fluxbench plugins`, `procedures`, `effects` and `schema`: lists and file formats."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from orchestrator.formatting.quantities import number
from orchestrator.formatting.sentences import listed, text_table
from orchestrator.interface.cli._output import say, say_document, say_notes
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from orchestrator.validation.messages import suggestion
from protocols import (
    EffectLayer,
    InputError,
    Manifest,
    PluginError,
    Procedure,
    ProcedureError,
    is_compensable,
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


def effects(name: str | None, file: Path | None, as_json: bool) -> int:
    """List the physical effects of the library and of a file of one's own, or describe one."""
    library = _library(file)
    if name is not None:
        if name.replace(" ", "_") not in library:
            raise InputError("effects", name, f"no such effect; {suggestion(name, library)}")
        return _describe_effect(library[name.replace(" ", "_")], as_json)
    _list({name: str(getattr(effect, "summary", "")) for name, effect in library.items()}, as_json)
    return 0


def _library(file: Path | None) -> dict[str, Any]:
    """The installed effects, and those of a file, by name."""
    if file is None:
        return {info.name: load_plugin(PluginKind.EFFECTS, info.name) for info in installed(PluginKind.EFFECTS)}
    from orchestrator.interface.api import chosen_effects

    return {effect.name: effect for effect in chosen_effects(file)}


def _describe_effect(effect: Any, as_json: bool) -> int:
    """Print an effect's meaning, pattern and parameters, what tells it from others, and what to do about it."""
    from orchestrator.diagnosis.selection.contrasts import CONTRASTS

    rows = [
        (p.name, p.role.value, p.unit, number(p.typical, 3), f"{number(p.low, 3)} to {number(p.high, 3)}")
        for p in effect.Parameters.declared()
    ]
    if as_json:
        heads = ("name", "role", "unit", "typical", "range")
        text = {one: getattr(effect, one) for one in ("name", "summary", "signature", "gauge")}
        say_document(json.dumps({**text, "parameters": [dict(zip(heads, row, strict=True)) for row in rows]}, indent=2))
        return 0
    say(f"{effect.name}: {effect.summary}", "", *inspect.cleandoc(effect.__doc__ or "").splitlines(), "")
    say(f"how it shows: {effect.signature}")
    if effect.needs:
        say(f"what tells it from others: {listed([CONTRASTS[need].text for need in effect.needs])}")
    say(f"at the bench: {getattr(effect, 'at_the_bench', BENCH_ADVICE[effect.layer])}")
    compensated = "`fluxbench tune` compensates what follows current, angle and bus"
    say("in the drive: " + (compensated if is_compensable(effect) else "not to be compensated"))
    if effect.gauge:
        say(f"not determined: {effect.gauge}")
    say("", text_table(("parameter", "role", "unit", "typical", "range"), rows, numbers=False))
    say_notes(
        [
            "typical sizes and ranges are those of a 400 W machine at 540 V; `diagnose` and `explain` scale them to "
            "the motor and its bus, and state the scaled ones"
        ]
    )
    return 0


BENCH_ADVICE: Mapping[EffectLayer, str] = {
    EffectLayer.CURRENT_SENSORS: "compare the current readings with a reference ammeter, and without current",
    EffectLayer.DELAY: "look up when the drive samples, when its voltage takes effect, and its filters",
    EffectLayer.BUS: "measure the bus under load at the drive's terminals, and compare with its reading",
    EffectLayer.INVERTER: "measure between the motor's terminals under current, and compare with the commanded voltage",
    EffectLayer.RESISTANCE: "measure between the motor's terminals with four wires, cold and warm",
    EffectLayer.FRAME: "look at the coupling and brake of the locked rotor and at the encoder's offset; align again",
    EffectLayer.IRON: "nothing to mend where it is of the motor: it stays in its model",
}
"""What an engineer looks at, by the place where an effect acts; one with advice of its own has `at_the_bench`.

A line holds for any effect of its layer, also for one that is not the library's.
"""


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
        raise InputError("schema", name, suggestion(name, [*models, "drive NAME"]))
    return models[name]
