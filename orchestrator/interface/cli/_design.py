"""`fluxbench design`: the shortest procedure that separates a set of effects, written to a file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from orchestrator.config import LoadedProcedure, check_plan, make_plan, read_procedure
from orchestrator.diagnosis.fitting.candidates import MAP_RUNGS, require_known
from orchestrator.engine import UsedPlugins, connected_drive
from orchestrator.experiment_design.design import ProcedureDesign, design, other_stages
from orchestrator.formatting.quantities import duration, number, percent, plural
from orchestrator.formatting.sentences import columns, listed
from orchestrator.interface.api import chosen_effects
from orchestrator.interface.cli._check import RehearsalOptions
from orchestrator.interface.cli._output import say, say_document
from orchestrator.stages import parse_stages
from protocols import InputError, PluginError


def write_design(
    source: str,
    names: Sequence[str],
    out: Path,
    rehearsal: RehearsalOptions,
    as_json: bool,
    *,
    size: float,
    drive: str | None,
    motor: Path | None,
    overrides: Sequence[str],
) -> int:
    """Design a procedure, check it against limits and drive, write it, and print its isolability."""
    if out.exists():
        raise InputError(str(out), "--out", "exists already and is not overwritten: name another file")
    if not out.parent.is_dir():
        raise InputError(str(out), "--out", f"{out.parent} is not a directory")
    loaded = read_procedure(source, overrides=overrides, drive=drive, motor=motor)
    UsedPlugins(parse_stages(loaded.procedure))
    library = chosen_effects(rehearsal.effects or ())
    require_known(names, library)
    for name in set(names) & set(MAP_RUNGS):
        raise PluginError("effects", name, "belongs to the map: every procedure that maps the plane shows it")
    wanted = [effect for effect in library if effect.name in names]
    with loaded.locating_errors(), connected_drive(loaded.procedure, private=None) as (_, capabilities):
        plan = make_plan(loaded.procedure, capabilities)
        machine = rehearsal.machine(plan, capabilities)
        designed = design(plan, capabilities, machine, wanted, size=size, noise_a=rehearsal.noise_a)
        before, after = check_plan(plan, capabilities), check_plan(designed.plan, capabilities)
    out.write_text(_as_yaml(loaded, plan_places=other_stages(plan), designed=designed), encoding="utf-8")
    if as_json:
        say_document(json.dumps(_as_json(designed, out, before.duration_s, after.duration_s), indent=2))
    else:
        _print_summary(designed, out, before.duration_s, after.duration_s)
    return 0


def _as_yaml(loaded: LoadedProcedure, plan_places: tuple[list[int], list[int]], designed: ProcedureDesign) -> str:
    data, (before, after) = loaded.document.data, plan_places
    written, effects = data["stages"], listed(designed.isolability.names)
    stages = [*(written[k] for k in before), *designed.stages, *(written[k] for k in after)]
    whole = {
        **data,
        "name": f"{data['name']}-designed",
        "summary": f"the shortest that separates {effects}",
        "stages": stages,
    }
    head = f"# Designed by `fluxbench design` from {data['name']}: detects and separates {effects}.\n"
    return head + yaml.safe_dump(whole, sort_keys=False, default_flow_style=None, width=100, allow_unicode=True)


def _as_json(designed: ProcedureDesign, out: Path, before_s: float, after_s: float) -> dict[str, Any]:
    result, best = designed.isolability, designed.approximate
    return {
        "out": str(out),
        "points": len(designed.plan.points),
        "duration_s": after_s,
        "duration_before_s": before_s,
        "found_at": {name: result.detection[name] for name in result.names},
        "parted_at": [{"effect": a, "from": b, "size": size} for (a, b), size in result.separation.items()],
        "offered_points": designed.offered,
        "largest_derivative": best.largest,
        "bound": best.bound,
    }


def _print_summary(designed: ProcedureDesign, out: Path, before_s: float, after_s: float) -> None:
    result, best = designed.isolability, designed.approximate
    points, base = plural(len(designed.plan.points), "point"), designed.plan.procedure.name
    say(f"{points}, {duration(after_s)} in all; {base} takes {duration(before_s)}")
    rows = [(name, "", percent(100.0 * result.detection[name])) for name in result.names]
    rows += [(a, b, percent(100.0 * size)) for (a, b), size in result.separation.items()]
    say(*columns([("effect", "separated from", "at this part of its typical size"), *rows]))
    say(
        f"time shared among {plural(designed.offered, 'point')}: largest directional derivative",
        f"{number(best.largest)}, bound {number(best.bound)}: no other share is better by more than "
        + percent(100.0 * max(best.excess, 0.0)),
        f"written to {out}",
    )
