"""What to do about a diagnosed model: what to measure next, to compensate in the drive, or to take from model.json."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from orchestrator.formatting.deciding import DISCOVER_FIRST, NOTHING_TO_DECIDE, experiment_to_decide
from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import duration, in_degrees, operating_point, predicted_separation, quantity
from orchestrator.formatting.results import by_import
from orchestrator.formatting.sentences import listed, typographic
from orchestrator.registry.plugins import PluginKind, load_plugin
from protocols import (
    DiagnosisReport,
    DiagnosisWords,
    DriveRecord,
    FoundEffect,
    NextExperiment,
    PluginError,
    is_compensable,
)


class Advice(NamedTuple):
    """A sentence on what to do, and a line with its size for each cause that it advises on."""

    text: str
    items: tuple[str, ...]


def advice_on(
    report: DiagnosisReport, words: DiagnosisWords, drive: DriveRecord | None, run: str, *, is_imported: bool = False
) -> Advice:
    """What to do about the model.

    Parameters
    ----------
    drive : DriveRecord or None
        That of the recording, whose PWM frequency and bus voltage the sizes hold at.
    run : str
        The run as a command takes it.
    is_imported : bool
        Whether no run measured the recording, so that none continues it.
    """
    text, causes = _advice(report, words, run, is_imported=is_imported)
    return Advice(text, tuple(filter(None, (_sized(cause, drive) for cause in causes))))


def _advice(
    report: DiagnosisReport, words: DiagnosisWords, run: str, *, is_imported: bool
) -> tuple[str, Sequence[FoundEffect]]:
    """What to do about the model, and the causes that it says to compensate or to take from the model."""
    discover_first = f"{DISCOVER_FIRST}; "
    first = discover_first if words.to_decide.startswith(discover_first) else ""
    text, causes = _beside_discovery(report, words.to_decide.removeprefix(first), run, is_imported=is_imported)
    return f"{first.replace('fluxbench discover RUN', f'fluxbench discover {run}')}{text}", causes


def _beside_discovery(
    report: DiagnosisReport, decide: str, run: str, *, is_imported: bool
) -> tuple[str, Sequence[FoundEffect]]:
    to_decide = typographic(decide).replace("`fluxbench diagnose RUN", f"`fluxbench diagnose {run}")
    proposed = report.next_experiment
    if report.convention is not None:
        return f"{to_decide}; then diagnose again.", ()
    # Earlier versions saved these words with identifiers.
    if proposed is not None and plain(decide).startswith(experiment_to_decide(proposed)):
        certain, also = _certain(report), plain(to_decide).removeprefix(typographic(experiment_to_decide(proposed)))
        measure = f"{_measurement(proposed, run, is_imported=is_imported)}{also}"
        # The experiment comes first: its stage joins the recording, whose drive has no compensation yet.
        return (f"{measure}; then {_remedy(certain)}." if certain else f"{measure}."), certain
    if report.verdict == "clean":
        return "nothing is missing in it.", ()
    if report.verdict == "unknown_remains":
        return f"{to_decide}.", ()
    if report.verdict == "mostly_explained":
        return f"{to_decide}; `fluxbench discover {run}` looks for the law that is missing.", ()
    if report.verdict == "cannot_tell":
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
    undecided = "" if decide == NOTHING_TO_DECIDE else f"{to_decide}; "
    return f"{undecided}{_remedy(causes)}{rest}.", causes


def _measurement(proposed: NextExperiment, run: str, *, is_imported: bool) -> str:
    """The proposed experiment with the command that makes it."""
    first, second = map(plain, proposed.separates)
    takes, how_far = duration(60.0 * proposed.minutes), predicted_separation(proposed)
    if is_imported:
        return f"{takes} more tell {first} from {second}{how_far}: {by_import(run)}"
    return f"`fluxbench run --from {run}` measures {takes} more, to tell {first} from {second}{how_far}"


def _certain(report: DiagnosisReport) -> list[FoundEffect]:
    """The causes that no other effect may stand for, about which something can be done already."""
    if report.verdict != "explained":
        return []
    doubtful = {str(one.values.get("effect")) for one in report.remarks if one.code == "fits_better_in_place"}
    return [e for e in report.effects if not e.twins and e.material is not False and e.name not in doubtful]


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
