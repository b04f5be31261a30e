"""What to do now, in two or three lines: with the map, with a changed model, and about what the model misses.

What is left to decide is the diagnosis's own section, so that the page advises nothing beside it.
"""

from __future__ import annotations

from orchestrator.diagnosis.reporting.advice import Advice, advice_on
from orchestrator.formatting.deciding import map_advice
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import quantity
from orchestrator.formatting.results import accuracy_words
from orchestrator.formatting.sentences import listed, typographic
from plugins.streams.report._collect import Material
from plugins.streams.report._content import Line, typed


def next_steps(material: Material) -> list[Line]:
    """One line on the map, one on its accuracy, one on the diagnosis; between them the changes of the model since."""
    advice = _about_model(material)
    lines = [
        Line("The map", map_advice(material.estimates, typed(material))),
        Line("The model", advice.text, items=advice.items),
    ]
    if material.estimates is not None and (accuracy := accuracy_words(material.estimates)):
        lines.insert(1, Line("Accuracy", f"{typographic(accuracy)}."))
    if material.model_changes:
        changes = ", ".join(material.model_changes)
        text = f"model.json was changed since the diagnosis: {changes}. R_s and the map are of model.json; ladder and "
        lines.insert(-1, Line("Changed", text + "effects are of the diagnosis."))
    return lines


def _about_model(material: Material) -> Advice:
    """What to do about the diagnosed model, or the command that diagnoses it."""
    run = typed(material)
    if material.diagnosis is not None:
        drive = None if material.manifest is None else material.manifest.drive
        is_imported = material.manifest is not None and material.record is None
        return advice_on(material.diagnosis.report, material.diagnosis.words, drive, run, is_imported=is_imported)
    is_drawn = material.bare is not None or material.manifest is None
    draws = "" if is_drawn else f", `fluxbench report {run}` draws where it fails and names nothing"
    is_sealed = material.record is not None and bool(material.record.sealed)
    spoils = ", and gives most of what is hidden in this motor away" if is_sealed else ""
    text = f"{_reached(material)}not diagnosed: `fluxbench diagnose {run}` names what it misses{spoils}{draws}."
    return Advice(text, ())


def _reached(material: Material) -> str:
    """The error of effects that were added by hand, beside the noise; empty where there are none."""
    step = material.present
    if step is None:
        return ""
    error, noise = quantity(step.rms_v, "V"), quantity(step.noise_rms_v, "V")
    return f"with {listed([plain(name) for name in step.effects])} the error is {error}, noise alone leaves {noise}; "
