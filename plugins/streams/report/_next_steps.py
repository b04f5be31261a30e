"""What to do now, in two lines: with the map, and about what the model misses."""

from __future__ import annotations

import shlex

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import duration
from orchestrator.formatting.sentences import listed, typographic
from plugins.streams.report._collect import Material
from plugins.streams.report._content import Line


def next_steps(material: Material) -> list[Line]:
    """One line on the map, one on the diagnosis."""
    return [Line("The map", _about_map(material)), Line("The model", _about_model(material))]


def _typed(material: Material) -> str:
    """The run as a command of a shell takes it: by the path that was given."""
    return shlex.quote(str(material.directory))


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
        case "explained":
            causes = listed([plain(effect.name) for effect in report.effects])
            return (
                f"nothing is left to measure; compensate {causes} in the drive, or use model.json, which includes that."
            )
        case _:
            return f"{typographic(material.diagnosis.words.to_decide)}."
