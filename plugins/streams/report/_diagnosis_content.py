"""The diagnosis in words and tables: verdict, five slots, ladder, effects, look-alikes, the next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import duration, number, percent, predicted_separation, quantity
from orchestrator.formatting.results import joint_bound, mutual_twins, parameter_rows, trace_words
from orchestrator.formatting.results import ladder_rows as rungs
from orchestrator.formatting.sentences import listed, typographic
from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from protocols import DiagnosisStep, PluginError

if TYPE_CHECKING:
    from orchestrator.diagnosis import SavedDiagnosis
    from orchestrator.discovery import Discovery


@dataclass(frozen=True)
class Experiment:
    """What to measure next."""

    yaml: str
    reason: str


Rows = list[tuple[str, ...]]


def squared(text: str) -> str:
    """The text in the page's typography, with chi squared as a symbol."""
    return typographic(text).replace("chi2", "χ²")


def heading(verdict: str) -> str:
    """The heading of the diagnosis; it says that something is missing only where something is."""
    if verdict == "clean":
        return "Where the model was compared"
    if verdict in ("explained", "explained_in_another_form"):
        return "Where the model failed, and what explains it"
    return "Where the model fails, and what is missing in it"


def ladder_rows(diagnosis: SavedDiagnosis, learned: Discovery | None = None, changes: Sequence[str] = ()) -> Rows:
    """The error after each added effect; the last line is the noise floor. None where nothing was fitted.

    A learned law that was added to the model since the diagnosis has a line of its own.
    """
    if diagnosis.report.convention is not None:
        return []
    floor = diagnosis.report.noise_floor
    held_out = floor.rms_v if floor.heldout_rms_v is None else floor.heldout_rms_v
    alone = "noise floor", "1", quantity(floor.rms_v, "V"), quantity(held_out, "V"), ""
    return [*rungs(diagnosis.report.ladder), *_learned_rows(learned, changes), alone]


def _learned_rows(learned: Discovery | None, changes: Sequence[str]) -> Rows:
    laws = learned.laws if learned is not None else ()
    if learned is None or not laws or not all(f"+ {plain(law.name)}" in changes for law in laws):
        return []
    names = listed([plain(law.name) for law in laws])
    held_out = "" if learned.after_rms_v is None else quantity(learned.after_rms_v, "V")
    return [(f"+ {names} (learned)", number(learned.chi2_after), "", held_out, "")]


def step_errors(step: DiagnosisStep, *, with_noise: bool = True) -> str:
    """The error of one model, beside the noise that its windows of the recording leave."""
    error, noise = quantity(step.rms_v, "V"), f", noise floor {quantity(step.noise_rms_v, 'V')}" if with_noise else ""
    held_out = "" if step.heldout_rms_v is None else f" ({quantity(step.heldout_rms_v, 'V')} held out)"
    return f"error {error} rms{held_out}{noise}, χ² {number(step.chi2)} per degree of freedom"


def signature_rows() -> Rows:
    """Each installed effect: its name for a command, what it is, and what it leaves in a residual.

    One that cannot be loaded is left out, as the page does not need it.
    """
    rows: Rows = []
    for info in installed(PluginKind.EFFECTS):
        try:
            plugin = load_plugin(PluginKind.EFFECTS, info.name)
        except PluginError:
            continue
        rows.append((info.name, *(str(getattr(plugin, name, "")) for name in ("summary", "signature"))))
    return rows


def effect_rows(diagnosis: SavedDiagnosis) -> Rows:
    """Every parameter of every effect with value and interval, and the effects that fit as well in its place."""
    rows: Rows = []
    every = (*diagnosis.report.effects, *diagnosis.report.minor)
    for effect in every:
        name = plain(effect.name) + (" (immaterial)" if effect in diagnosis.report.minor else "")
        twins = listed([plain(twin) for twin in mutual_twins(every)[effect.name]]) or "none"
        rows += [
            (name if k == 0 else "", *row, twins if k == 0 else "") for k, row in enumerate(parameter_rows(effect))
        ]
    return rows


def alike_rows(diagnosis: SavedDiagnosis, sure_z: float = 4.0) -> Rows:
    """What looks alike in this data set: ties in the search, and where search and joint fit (|z|) disagree."""
    rows: Rows = [
        (plain(effect.name), ", ".join(map(plain, effect.twins)), "fits as well in its place")
        for effect in diagnosis.report.effects
        if effect.twins
    ]
    known = {effect.name for effect in (*diagnosis.report.effects, *diagnosis.report.minor)}
    joint_only = {e.name: e for e in diagnosis.report.joint if e.name not in known and abs(e.z or 0.0) >= sure_z}
    for entry in joint_only.values():
        bound = joint_bound(entry)
        size = f"{bound} (95 %) beside what was added; " if bound else ""
        sigmas = f"{number(abs(entry.z or 0.0), 3)} standard deviations from zero with all effects fitted at once"
        rows.append((plain(entry.name), "–", f"not added: {size}{sigmas}, but {_too_little(diagnosis, entry.name)}"))
    for effect in diagnosis.report.minor:
        reason = f"in the model, no cause: {percent(100.0 * (effect.share or 0.0))} of the error"
        rows.append((plain(effect.name), "–", reason))
    rest = [name for name in diagnosis.report.traces if name not in joint_only]
    if traces := trace_words(diagnosis.report.model_copy(update={"traces": rest})):
        rows.append((", ".join(traces), "–", "detected, but too small to be named"))
    return rows


def _too_little(diagnosis: SavedDiagnosis, name: str) -> str:
    """Why an effect that the joint fit detects was not added: the last gain that the search found, and what is needed.

    The search needs more than the joint fit, as the best of many absent effects is large by chance.
    """
    screens = [e for e in diagnosis.report.search if e.move == "screen" and e.data == "whole" and name in e.effects]
    last = screens[-1] if screens else None
    if last is None or last.score is None or last.threshold is None:
        return "adding it improves the fit too little"
    gain, needed = number(last.score, 3), number(last.threshold, 3)
    chance = "the best of all absent effects lowers it by nearly that much by chance"
    return f"adding it lowers the summed χ² by {gain}, and {needed} are needed (step {last.step}), as {chance}"


def leftover_text(diagnosis: SavedDiagnosis) -> str:
    """How much of the error is left."""
    fraction = diagnosis.report.unexplained.fraction
    return "" if fraction is None else f"{percent(100.0 * fraction)} of the first error is left beyond the noise."


def experiment(diagnosis: SavedDiagnosis) -> Experiment | None:
    """The next experiment as a stage of a procedure."""
    import yaml

    proposal = diagnosis.report.next_experiment
    if proposal is None:
        return None
    text = yaml.safe_dump({"stages": [proposal.stage]}, sort_keys=False, default_flow_style=None, width=60)
    first, second = map(plain, proposal.separates)
    takes, how_far = duration(60.0 * proposal.minutes), predicted_separation(proposal)
    return Experiment(text, f"Tells {first} from {second}, {takes}{how_far}.")
