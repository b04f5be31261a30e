"""Parse a procedure's entries into stages; each entry's plugin validates its settings. Adds no values."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from pydantic import ValidationError

from orchestrator.registry.plugins import Installed, PluginKind
from orchestrator.validation.messages import first_problem, suggestion
from protocols import PluginError, Procedure, ProcedureError, ProposingStage, SegmentStage, Stage, StageEntry


def parse_stages(procedure: Procedure, appended: Sequence[StageEntry] = ()) -> tuple[Stage, ...]:
    """All stages of a procedure and of the appended entries.

    Raises
    ------
    ProcedureError
        A stage is not installed, or a setting of it is wrong; in one line, with the nearest valid name.
    PluginError
        A stage's plugin is broken.
    """
    plugins = _Plugins()
    entries = enumerate((*procedure.stages, *appended))
    return tuple(plugins.parse(entry, procedure.name, f"stages.{index}") for index, entry in entries)


def parse_stage(raw: Mapping[str, Any], where: str, field: str) -> Stage:
    """The stage of one entry; errors, as in `parse_stages`, name its origin `where` and the `field`."""
    try:
        entry = StageEntry.model_validate(dict(raw))
    except ValidationError as error:
        wrong = first_problem(error, StageEntry, raw)
        raise ProcedureError(where, f"{field}.{wrong.field}".rstrip("."), wrong.text) from None
    return _Plugins().parse(entry, where, field)


class _Plugins:
    """The installed stage plugins; each is loaded once."""

    def __init__(self) -> None:
        self._installed = Installed(PluginKind.STAGES)
        self._names = {info.name for info in self._installed.plugins}
        self._loaded: dict[str, type[Stage]] = {}

    def parse(self, entry: StageEntry, where: str, field: str) -> Stage:
        if entry.kind not in self._names:
            problem = f"no stage plugin {entry.kind!r} is installed; {suggestion(entry.kind, self._names)}"
            raise ProcedureError(where, f"{field}.kind", problem)
        if entry.kind not in self._loaded:
            self._loaded[entry.kind] = self._installed.load(entry.kind)
        plugin, settings = self._loaded[entry.kind], entry.settings
        try:
            # JSON mode is strict about types ("5" and true are no numbers) and still takes lists for tuples.
            return plugin.model_validate_json(json.dumps(settings), strict=True)
        except ValidationError as error:
            wrong = first_problem(error, plugin, settings)
            raise ProcedureError(where, f"{field}.{wrong.field}".rstrip("."), wrong.text) from None


def spelled_out(procedure: Procedure) -> Procedure:
    """The same procedure, every setting of its stages validated and written out, defaults included."""
    return procedure.model_copy(update={"stages": tuple(stage.entry() for stage in parse_stages(procedure))})


def installed_stages() -> list[type[Stage]]:
    """All installed stages that load, in the order in which the recording format names what they measure."""
    order = list(SegmentStage)
    stages = Installed(PluginKind.STAGES)
    found: list[type[Stage]] = []
    for info in stages.plugins:
        with suppress(PluginError):  # reported when a procedure names the stage
            found.append(stages.load(info.name))
    return sorted(found, key=lambda p: (order.index(p.records_as) if p.records_as else len(order), p.name))


def proposing_stage(stages: Iterable[Stage]) -> ProposingStage:
    """The last of these stages that proposes experiments, or else an installed one with its defaults.

    Raises
    ------
    PluginError
        None is installed.
    """
    last = next((stage for stage in reversed(list(stages)) if isinstance(stage, ProposingStage)), None)
    if last is not None:
        return last
    plugin = next((plugin for plugin in installed_stages() if issubclass(plugin, ProposingStage)), None)
    if plugin is None:
        raise PluginError(PluginKind.STAGES.value, "", "none that is installed proposes experiments")
    return plugin()
