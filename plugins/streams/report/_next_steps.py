"""What to do now, in two or three lines: with the map, with a changed model, and about what the model misses."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import duration
from orchestrator.formatting.sentences import listed, typographic
from orchestrator.registry.plugins import PluginKind, load_plugin
from plugins.streams.report._collect import Material
from plugins.streams.report._content import Line
from protocols import PluginError, is_compensable


def next_steps(material: Material) -> list[Line]:
    """One line on the map, one on the diagnosis; between them the changes of the model since."""
    lines = [Line("The map", _about_map(material)), Line("The model", _about_model(material))]
    if material.model_changes:
        changes = ", ".join(material.model_changes)
        text = f"model.json was changed since the diagnosis: {changes}. R_s and the map are of model.json; ladder and "
        lines.insert(1, Line("Changed", text + "effects are of the diagnosis."))
    return lines


def _typed(material: Material) -> str:
    """The run as a command takes it from this folder; the name of one elsewhere, as a page does not tell its place."""
    place, here = material.directory.resolve(), Path.cwd()
    return shlex.quote(str(place.relative_to(here)) if place.is_relative_to(here) else place.name)


def _about_map(material: Material) -> str:
    report, run = material.estimates, _typed(material)
    if report is None:
        return f"none yet: fluxbench estimate {run} makes it."
    if report.usable and "flux_map" in report.files:
        return f"use results/{report.files['flux_map']}; fluxbench export {run} writes it for a drive or a simulation."
    why = next((typographic(remark.text) for remark in report.remarks), "none could be made")
    return f"do not rely on it: {why}."


def _about_model(material: Material) -> str:
    run = _typed(material)
    if material.diagnosis is None:
        return f"not diagnosed: fluxbench diagnose {run} names what it misses."
    report = material.diagnosis.report
    if report.convention is not None:
        return f"{typographic(report.convention.correction.text)}; then diagnose again."
    if report.next_experiment is not None:
        proposed = report.next_experiment
        first, second = map(plain, proposed.separates)
        takes = duration(60.0 * proposed.minutes)
        return f"fluxbench run --from {run} measures {takes} more, to tell {first} from {second}."
    match report.verdict:
        case "clean":
            return "nothing is missing in it."
        case "explained" | "explained_in_another_form":
            if twins := [effect for effect in report.effects if effect.twins]:
                names = " or ".join(plain(name) for name in (twins[0].name, *twins[0].twins))
                return f"compensate nothing until it is known whether it is {names}; model.json serves for either."
            causes = [effect.name for effect in report.effects if effect.material is not False]
            return f"nothing is left to measure; {_remedy(causes)}."
        case _:
            return f"{typographic(material.diagnosis.words.to_decide)}."


def _remedy(causes: Sequence[str]) -> str:
    """Compensation in the drive for those causes that allow it, and the model for all."""
    if not causes:
        return "no effect is large enough to be compensated; model.json includes them"
    in_drive = [plain(name) for name in causes if _is_compensable(name)]
    others = [plain(name) for name in causes if not _is_compensable(name)]
    if not others:
        return f"compensate {listed(in_drive)} in the drive, or use model.json, which includes that"
    rest = f"use model.json for {listed(others)}, which no drive compensates"
    return f"compensate {listed(in_drive)} in the drive, and {rest}" if in_drive else rest


def _is_compensable(name: str) -> bool:
    """As the installed effect states it; not of one's own effect, nor of a part of the map."""
    try:
        return is_compensable(load_plugin(PluginKind.EFFECTS, name))
    except PluginError:
        return False
