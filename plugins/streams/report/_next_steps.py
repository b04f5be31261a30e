"""What to do now, in two or three lines: with the map, with a changed model, and about what the model misses.

What is left to decide is the diagnosis's own section, so that the page advises nothing beside it.
"""

from __future__ import annotations

from collections.abc import Sequence

from orchestrator.formatting.deciding import NOTHING_TO_DECIDE, experiment_to_decide
from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import duration, in_degrees, operating_point, predicted_separation, quantity
from orchestrator.formatting.results import accuracy_words, by_import
from orchestrator.formatting.sentences import listed, typographic
from orchestrator.registry.plugins import PluginKind, load_plugin
from plugins.streams.report._collect import Material
from plugins.streams.report._content import Line, is_estimated, typed
from protocols import DiagnosisReport, DriveRecord, FoundEffect, PluginError, Usability, is_compensable


def next_steps(material: Material) -> list[Line]:
    """One line on the map, one on its accuracy, one on the diagnosis; between them the changes of the model since."""
    lines = [Line("The map", _about_map(material)), _about_model(material)]
    if material.estimates is not None and (accuracy := accuracy_words(material.estimates)):
        lines.insert(1, Line("Accuracy", f"{typographic(accuracy)}."))
    if material.model_changes:
        changes = ", ".join(material.model_changes)
        text = f"model.json was changed since the diagnosis: {changes}. R_s and the map are of model.json; ladder and "
        lines.insert(-1, Line("Changed", text + "effects are of the diagnosis."))
    return lines


def _about_map(material: Material) -> str:
    report, run = material.estimates, typed(material)
    if report is None:
        return f"none yet: `fluxbench estimate {run}` makes it."
    if report.usable and "flux_map" in report.files:
        return (
            f"use `results/{report.files['flux_map']}`; `fluxbench export {run}` writes it for other tools, "
            f"`fluxbench tune {run}` computes a drive's references, gains and compensation."
        )
    if report.usability is Usability.NOT_JUDGED:
        return f"not judged: `fluxbench diagnose {run}` decides whether it is usable."
    why = next((typographic(remark.text) for remark in report.remarks), "none could be made")
    if not is_estimated(material):
        return f"that of model.json is not to be relied on: {why}. `fluxbench estimate {run}` makes the estimators’."
    return f"do not rely on it: {why}."


def _about_model(material: Material) -> Line:
    """What to do about the model; the sizes of the causes that it advises on are a list below it."""
    text, causes = _advice(material)
    drive = None if material.manifest is None else material.manifest.drive
    return Line("The model", text, items=tuple(filter(None, (_sized(cause, drive) for cause in causes))))


def _advice(material: Material) -> tuple[str, Sequence[FoundEffect]]:
    """What to do about the model, and the causes that it says to compensate or to take from the model."""
    run = typed(material)
    if material.diagnosis is None:
        is_drawn = material.bare is not None or material.manifest is None
        draws = "" if is_drawn else f", `fluxbench report {run}` draws where it fails and names nothing"
        is_sealed = material.record is not None and bool(material.record.sealed)
        spoils = ", and gives most of what is hidden in this motor away" if is_sealed else ""
        return f"{_reached(material)}not diagnosed: `fluxbench diagnose {run}` names what it misses{spoils}{draws}.", ()
    report, decide = material.diagnosis.report, material.diagnosis.words.to_decide
    to_decide = typographic(decide).replace("`fluxbench diagnose RUN", f"`fluxbench diagnose {run}")
    proposed = report.next_experiment
    if report.convention is not None:
        return f"{to_decide}; then diagnose again.", ()
    if proposed is not None and decide == experiment_to_decide(proposed):
        first, second = map(plain, proposed.separates)
        takes, how_far = duration(60.0 * proposed.minutes), predicted_separation(proposed)
        measure = f"`fluxbench run --from {run}` measures {takes} more, to tell {first} from {second}{how_far}."
        if material.manifest is not None and material.record is None:
            measure = f"{takes} more tell {first} from {second}{how_far}: {by_import(run)}."
        certain = _certain(report)
        return (f"{_remedy(certain)}; then {measure}" if certain else measure), certain
    if report.verdict == "clean":
        return "nothing is missing in it.", ()
    if report.verdict not in ("explained", "explained_in_another_form"):
        return f"{to_decide}.", ()
    if twins := [effect for effect in report.effects if effect.twins]:
        names, present = (twins[0].name, *twins[0].twins), {effect.name for effect in (*report.effects, *report.minor)}
        if present.issuperset(names):
            known = f"how much is whose of {listed([plain(name) for name in names])}; model.json has them together"
        else:
            known = f"whether it is {' or '.join(plain(name) for name in names)}; model.json serves for either"
        return f"{to_decide}; compensate nothing until it is known {known}.", ()
    if any(remark.code == "fits_better_in_place" for remark in report.remarks):
        return f"{to_decide}; compensate nothing until then.", ()
    causes = [effect for effect in report.effects if effect.material is not False]
    small = [plain(effect.name) for effect in report.effects if effect.material is False]
    rest = f"; {listed(small)}, named too, {'is' if len(small) == 1 else 'are'} too small to matter" if small else ""
    decided = "nothing is left to measure" if decide == NOTHING_TO_DECIDE else to_decide
    return f"{decided}; {_remedy(causes)}{rest}.", causes


def _certain(report: DiagnosisReport) -> list[FoundEffect]:
    """The causes that no other effect may stand for, about which something can be done already."""
    if report.verdict != "explained":
        return []
    doubtful = {str(one.values.get("effect")) for one in report.remarks if one.code == "fits_better_in_place"}
    return [e for e in report.effects if not e.twins and e.material is not False and e.name not in doubtful]


def _reached(material: Material) -> str:
    """The error of effects that were added by hand, beside the noise; empty where there are none."""
    step = material.present
    if step is None:
        return ""
    error, noise = quantity(step.rms_v, "V"), quantity(step.noise_rms_v, "V")
    return f"with {listed([plain(name) for name in step.effects])} the error is {error}, noise alone leaves {noise}; "


def _remedy(causes: Sequence[FoundEffect]) -> str:
    """Compensation in the drive for those causes that allow it, and the model for all."""
    if not causes:
        return "no effect is large enough to be compensated; model.json includes them"
    in_drive = [plain(cause.name) for cause in causes if _is_compensable(cause.name)]
    others = [plain(cause.name) for cause in causes if not _is_compensable(cause.name)]
    if not others:
        return f"compensate {listed(in_drive)} in the drive, or use model.json, which includes that"
    rest = f"use model.json for {listed(others)}, which few drives compensate"
    return f"compensate {listed(in_drive)} in the drive, and {rest}" if in_drive else rest


def _sized(cause: FoundEffect, drive: DriveRecord | None) -> str:
    """A cause with what to set or check; empty of one for the model that states neither."""
    detail = _size(cause, drive) if _is_compensable(cause.name) else _for_the_model(cause)
    return f"{plain(cause.name)}: {detail}" if detail else ""


def _size(cause: FoundEffect, drive: DriveRecord | None) -> str:
    """What the drive's compensation is set to: the first quantity as on a data sheet, else parameters of one unit.

    Beside the former, the parameters are stated with the PWM frequency and bus voltage that they hold at. The inverter
    may have a setting of the same name, such as the dead time that protects its switches: that one stays.
    """
    sizes = {name: p for name, p in cause.parameters.items() if not p.bends_form}
    unit = next((p.unit for p in sizes.values()), "")
    shown = {
        parameter_words(name): quantity(p.value, p.unit, 4) + in_degrees(p.value, p.unit)
        for name, p in sizes.items()
        if p.unit == unit
    }
    first = next(iter(cause.derived.items()), None)
    if first is not None and (entered := quantity(first[1].value, first[1].unit, 4)) not in shown.values():
        where = "" if drive is None else f" at {operating_point(drive)}"
        same = ", ".join(f"{name} {size}" for name, size in shown.items())
        return f"enter {entered} as compensation, or {same}{where}; leave the inverter's own {plain(first[0])} as it is"
    return "; ".join(
        filter(None, [", ".join(f"{name} {size}" for name, size in shown.items()), _stated(cause.name, "remedy")])
    )


def _for_the_model(cause: FoundEffect) -> str:
    """An effect that the model is for, with what its sizes mean or what checks them, where the effect states that."""
    remedy = _stated(cause.name, "remedy")
    if bench := _stated(cause.name, "at_the_bench"):
        remedy = "; ".join(filter(None, [remedy, f"to check it, {bench}"]))
    sizes = [
        f"{parameter_words(name)} {quantity(p.value, p.unit, 4)}{in_degrees(p.value, p.unit)}"
        for name, p in cause.parameters.items()
        if not p.bends_form
    ]
    return f"{', '.join(sizes)}; {remedy}" if remedy else ""


def _stated(name: str, attribute: str) -> str:
    """What the installed effect says of how its size is used, or checked; empty where it says nothing."""
    try:
        return str(getattr(load_plugin(PluginKind.EFFECTS, name), attribute, ""))
    except PluginError:
        return ""


def _is_compensable(name: str) -> bool:
    """As the installed effect states it; not of one's own effect, nor of a part of the map."""
    try:
        return is_compensable(load_plugin(PluginKind.EFFECTS, name))
    except PluginError:
        return False
