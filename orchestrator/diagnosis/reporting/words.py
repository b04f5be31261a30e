"""Text of a diagnosis: where the model fails, the error's pattern, the likely cause, its effect, the next step."""

from __future__ import annotations

from collections.abc import Container, Sequence
from functools import partial
from operator import is_

import numpy as np

from orchestrator.diagnosis._diagnose import Diagnosis
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.reporting.convention import convention_words
from orchestrator.diagnosis.reporting.ladder import mean_rms_v, noise_rms_v
from orchestrator.diagnosis.reporting.parameter_bounds import bound_advice, bounds_reached
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds, needed_contrasts
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.formatting.deciding import DISCOVER_FIRST, NOTHING_TO_DECIDE, experiment_to_decide
from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import (
    in_degrees,
    number,
    operating_point,
    percent,
    quantity,
    value_and_interval,
)
from orchestrator.formatting.results import companion_words
from orchestrator.formatting.sentences import listed
from orchestrator.numerics.frames import to_dq
from protocols import (
    Contrast,
    DiagnosisReport,
    DiagnosisWords,
    DriveRecord,
    FoundEffect,
    ParameterValue,
    SegmentStage,
    is_compensable,
)

_STAGES = {
    SegmentStage.RESISTANCE: "a hold",
    SegmentStage.INJECTION: "an injection point",
    SegmentStage.CLASSICAL: "a sweep",
}
_LOOKS = {
    "odd_phase_current": "odd in the phase currents, as an inverter's errors are",
    "even_phase_current": "even in the phase currents",
    "constant": "constant, or slowly drifting, whatever the current",
    "anisotropic_resistance": "a resistance that depends on the current's direction",
    "time_resistance": "a resistance that changes in the course of the experiment",
    "power_voltage": "along the voltage, growing with the power",
    "sweep_direction": "opposite on rising and falling flux",
    "ripple_in_phase": "ripple in phase with the ripple current",
    "ripple_edges": "at the edges of the injected wave",
    "map_not_even": "a map that is not even in i_q",
    "reciprocity_broken": "a map without reciprocity",
    "map_detail": "detail of the map, finer than its splines",
    "periodic": "periodic at the mains frequency",
    "other": "none of the shapes that are looked for",
}


def in_words(diagnosis: Diagnosis) -> DiagnosisWords:
    """The five sections, each a sentence or two with units."""
    report = diagnosis.report
    if report.convention is not None:
        return convention_words(report.convention)
    clean = report.verdict == "clean"
    return DiagnosisWords(
        where_it_fails="nowhere beyond the noise" if clean else _where(diagnosis),
        what_it_looks_like="noise" if clean else _looks(diagnosis),
        likely_cause=_cause(diagnosis),
        if_added=_gain(diagnosis),
        to_decide=_to_decide(diagnosis),
    )


def _where(diagnosis: Diagnosis) -> str:
    fit = diagnosis.search.steps[0].fit
    rows = []
    for piece in fit.prepared.pieces:
        if piece.stage is not SegmentStage.GATES_OFF:
            rms = mean_rms_v(fit, partial(is_, piece))
            rows.append((rms or 0.0, piece))
    rms, piece = max(rows, key=lambda row: row[0])
    floor = noise_rms_v(fit, partial(is_, piece))
    i_d, i_q = np.abs(to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad)).max(axis=0)
    reach = f"|i_d| to {quantity(i_d, 'A', 2)}, |i_q| to {quantity(i_q, 'A', 2)}"
    before = "before the effects were added, " if len(diagnosis.search.steps) > 1 else ""
    return (
        f"{before}worst in {_stage_words(piece)} ({piece.segment.id}, {reach}): {quantity(rms, 'V')} rms; "
        f"noise alone leaves {quantity(floor, 'V')} in this segment"
    )


def _stage_words(piece: SegmentData) -> str:
    """What a segment is: ``a hold at 20 kHz PWM``."""
    kind = _STAGES.get(piece.stage, plain(piece.stage.value))
    return f"{kind} at {quantity(piece.signals.pwm_frequency_hz, 'Hz')} PWM"


def _looks(diagnosis: Diagnosis) -> str:
    report = diagnosis.report
    if report.effects and report.verdict != "unknown_remains":
        signatures = {c.name: c.effect.signature for c in diagnosis.library}
        shown = [e for e in report.effects if e.name in signatures]
        sentences = {e.name: _signature(diagnosis, e, signatures[e.name]) for e in shown}
        if len(sentences) > 1:
            return " ".join(f"{plain(name)}: {sentence}" for name, sentence in sentences.items())
        if sentences:
            return " ".join(sentences.values())
    if not report.unexplained.shape:
        return "what is left has no shape above the noise"
    parts = [f"{100 * (s.share or 0.0):.0f} % {_LOOKS[s.group]}" for s in report.unexplained.shape[:3]]
    return "; ".join(parts)


def _signature(diagnosis: Diagnosis, found: FoundEffect, signature: str) -> str:
    if not found.twins:
        return signature
    whole = f"{signature} {_why_alike(diagnosis, found)}"
    if needed := _needed(diagnosis, found):
        return f"{whole} What would tell it from {_plainly(found.twins)}, {', '.join(needed)}, was not measured."
    whole = f"{whole} At this size the recording does not tell it from {_plainly(found.twins)}."
    if measured := [CONTRASTS[contrast].text for contrast in _contrasts(diagnosis, found)]:
        return f"{whole} What tells them apart, {', '.join(measured)}, was measured, but too short or too small."
    return f"{whole} Larger currents or longer stages may."


def _why_alike(diagnosis: Diagnosis, found: FoundEffect) -> str:
    """Why a recording does not separate an effect from others: they fit in its place, or are in the model too."""
    present = [name for name in found.twins if name in diagnosis.search.fit.model.names]
    absent = [name for name in found.twins if name not in present]
    sentences = []
    if absent:
        sentences.append(f"In its place {_plainly(absent)} would leave the same residual, within the noise.")
    if present:
        verb = "are" if len(present) > 1 else "is"
        sentences.append(
            f"Here it acts like {_plainly(present)}, which {verb} in the model too: a part of its size may be theirs."
        )
    return " ".join(sentences)


def _needed(diagnosis: Diagnosis, found: FoundEffect) -> list[str]:
    """Measurements that separate an effect from its alternatives and that the recording lacks."""
    prepared = diagnosis.search.fit.prepared
    return [CONTRASTS[c].text for c in _contrasts(diagnosis, found) if not holds(prepared, c)]


def _contrasts(diagnosis: Diagnosis, found: FoundEffect) -> list[Contrast]:
    """Contrasts that separate an effect from its alternatives."""
    effects = {c.name: c.effect for c in diagnosis.library}
    twins = [effects[name] for name in found.twins]
    return list(dict.fromkeys(c for twin in twins for c in needed_contrasts(effects[found.name], twin)))


def _cause(diagnosis: Diagnosis) -> str:
    report = diagnosis.report
    if report.verdict == "clean" and report.minor:
        return f"none that counts; {_plainly([e.name for e in report.minor])} shows, and is in the model"
    if report.verdict == "clean":
        return "none: the model fits within the noise"
    terms = {a.name: a for a in diagnosis.search.fit.model.active}
    better = _better_in_place(report)
    drive = diagnosis.search.fit.prepared.manifest.drive
    named = [_named(e, terms.get(e.name), better.get(e.name), drive, terms.keys()) for e in report.effects]
    if report.effects and report.leaves_most:
        before, after, chi2 = *_error_before_and_after(report), number(report.ladder[-1].chi2)
        names, takes = listed([plain(e.name) for e in report.effects]), "take" if len(report.effects) > 1 else "takes"
        return f"none can be named while chi2 is {chi2}; {names} {takes} up a part ({before} -> {after})"
    if report.verdict == "unknown_remains":
        start = f"{listed(named)}, and " if named else ""
        if _time_constant_notes(report):
            return f"{start}not known: the readings are too slow for this winding to tell"
        return f"{start}something that no effect of the library explains"
    fraction = report.unexplained.fraction or 0.0
    rest = ""
    if report.verdict == "mostly_explained":
        rest = f"; {percent(100.0 * fraction)} of the error remains"
    if report.verdict == "explained_in_another_form" and report.verdict_record is not None:
        forms = listed([plain(name) for name in report.verdict_record.other_forms])
        rest = f"; {percent(100.0 * fraction)} of the error remains, as {forms} in another form would leave it"
    return listed(named) + rest


def _better_in_place(report: DiagnosisReport) -> dict[str, str]:
    """For each effect that is no certain cause, the one that fits better in its place."""
    found = [remark.values for remark in report.remarks if remark.code == "fits_better_in_place"]
    return {str(values["effect"]): str(values["other"]) for values in found}


def _named(
    effect: FoundEffect, term: EffectTerm | None, better: str | None, drive: DriveRecord, present: Container[str]
) -> str:
    """The effect with its amplitudes as text, those at a bound, and the one that fits better in its place.

    An amplitude that stands for a setting of the drive, such as a dead time, is stated where it holds.
    """
    amplitudes = () if term is None else term.candidate.amplitudes
    sizes = [name for name in effect.parameters if name in amplitudes] or list(effect.parameters)[:1]
    settings = {name: found for name, found in effect.derived.items() if not _is_parameter(effect, found)}
    of_drive = bool(settings) and term is not None and is_compensable(term.candidate.effect)
    where = f" at {operating_point(drive)}" if of_drive else ""
    parts = []
    for name in sizes:
        found = effect.parameters[name]
        size, interval = value_and_interval(found.value, found.low, found.high, found.unit)
        size += in_degrees(found.value, found.unit)
        parts.append(f"{parameter_words(name)} {size}{where}" + (f", 95 %: {interval}" if interval else ""))
        parts += [words] if (words := companion_words(effect, found)) else []
    derived = [f"{plain(name)} {quantity(found.value, found.unit)}" for name, found in settings.items()]
    is_certain = not effect.twins and better is None
    if of_drive and is_certain:
        # The same words name the time that an inverter waits between its switches, which no estimate may shorten.
        derived[0] += f", to enter as compensation; leave the inverter's own {plain(next(iter(settings)))} as it is"
    parts += derived
    reached = {} if term is None else bounds_reached(term)
    parts += [f"{parameter_words(name)} at its bound {bound}" for name, bound in reached.items()]
    parts += ["at this angle; other angles unknown"] if _is_of_one_angle(effect, term) else []
    absent = [name for name in effect.twins if name not in present]
    shared = [name for name in effect.twins if name in present]
    parts += [f"indistinguishable from {_plainly(absent)} here"] if absent else []
    parts += [f"acts like {_plainly(shared)} here, which is in the model too"] if shared else []
    parts += [f"{plain(better)} fits better in its place"] if better is not None else []
    return f"{plain(effect.name)} ({'; '.join(parts)})"


def _is_of_one_angle(effect: FoundEffect, term: EffectTerm | None) -> bool:
    """Whether size and sign belong to the only angle of the recording: a second one would show more amplitudes."""
    if term is None or Contrast.SECOND_ANGLE not in term.candidate.effect.needs:
        return False
    return any(name not in effect.parameters for name in term.candidate.amplitudes)


def _is_parameter(effect: FoundEffect, quantity: ParameterValue) -> bool:
    """Whether a derived quantity is one of the parameters under another name."""
    return any((p.value, p.unit) == (quantity.value, quantity.unit) for p in effect.parameters.values())


def _gain(diagnosis: Diagnosis) -> str:
    report, ladder = diagnosis.report, diagnosis.report.ladder
    if len(ladder) < 2:
        return "nothing was added"
    before, after, noise = ladder[0], ladder[-1], report.noise_floor
    fits = [diagnosis.search.steps[0].fit, diagnosis.search.fit]
    sizes = "error {} -> {}".format(*_error_before_and_after(report))
    if before.heldout_rms_v is None or after.heldout_rms_v is None:
        floor = f"noise floor {quantity(noise.rms_v, 'V')}"
    else:
        sizes = f"held-out {sizes}"
        floor = f"noise floor of the held-out error {quantity(noise.heldout_rms_v, 'V')}"
    first, last = (quantity(fit.model.r_s, "ohm", 4) for fit in fits)
    resistance = f"stays {last}" if first == last else f"{first} -> {last}"
    limits = {a.name: a.candidate.effect.gauge.rstrip(".") for a in fits[1].model.active if a.candidate.effect.gauge}
    several = len(fits[1].model.active) > 1
    gauges = [f"{plain(name)}: {limit}." if several else f"{limit}." for name, limit in limits.items()]
    text = f"{sizes} ({floor}); the model's R_s {resistance}"
    return " ".join([f"{text}.", *gauges]) if gauges else text


def _plainly(names: Sequence[str]) -> str:
    return listed([plain(name) for name in names])


def _error_before_and_after(report: DiagnosisReport) -> tuple[str, str]:
    """The error without and with the effects: held out, or else fitted."""
    before, after = report.ladder[0], report.ladder[-1]
    if before.heldout_rms_v is None or after.heldout_rms_v is None:
        return quantity(before.rms_v, "V"), quantity(after.rms_v, "V")
    return quantity(before.heldout_rms_v, "V"), quantity(after.heldout_rms_v, "V")


def _to_decide(diagnosis: Diagnosis) -> str:
    """What to do next; where an unknown remains, the search for its law comes before any experiment."""
    report, further = diagnosis.report, _next(diagnosis)
    is_searched = report.verdict == "unknown_remains" and not _time_constant_notes(report)
    return f"{DISCOVER_FIRST}; {further}" if is_searched else further


def _next(diagnosis: Diagnosis) -> str:
    slow = _time_constant_notes(diagnosis.report)
    if diagnosis.report.verdict == "unknown_remains" and slow:
        return f"the same once more with faster readings: {'; '.join(slow)}"
    better = {name: other for name, other in _better_in_place(diagnosis.report).items() if name in _names(diagnosis)}
    if better:
        name, other = next(iter(better.items()))
        return f"`fluxbench diagnose RUN --without {name}`: {plain(other)} fits better in its place"
    for term in diagnosis.search.fit.model.active:
        if term.name in _names(diagnosis) and (reached := list(bounds_reached(term))):
            return f"{listed([parameter_words(name) for name in reached])} of {plain(term.name)}: {bound_advice(term)}"
    proposal = diagnosis.report.next_experiment
    if proposal is not None:
        named = [found for found in diagnosis.report.effects if found.name in proposal.separates]
        angle = CONTRASTS[Contrast.SECOND_ANGLE].text
        also = f"; {angle} would, too" if any(angle in _needed(diagnosis, found) for found in named) else ""
        return f"{experiment_to_decide(proposal)}{also}"
    if inseparable := next((r for r in diagnosis.report.remarks if r.code == "not_separable"), None):
        return inseparable.text
    for found in diagnosis.report.effects:
        if needed := _needed(diagnosis, found):
            return f"no stage by itself; {listed(needed)} would tell {plain(found.name)} from {_plainly(found.twins)}"
    terms = {term.name: term for term in diagnosis.search.fit.model.active}
    if of_angle := [e.name for e in diagnosis.report.effects if _is_of_one_angle(e, terms.get(e.name))]:
        angle = CONTRASTS[Contrast.SECOND_ANGLE].text
        return f"{angle}: size and sign of {_plainly(of_angle)} belong to this angle alone"
    if twins := [found for found in diagnosis.report.effects if found.twins]:
        return f"{plain(twins[0].name)} or {_plainly(twins[0].twins)}: too small to be separated by the measurements"
    if any(remark.code == "rare_together" for remark in diagnosis.report.remarks):
        return "the same once more, the rotor locked at a second angle"
    if diagnosis.report.verdict == "cannot_tell":
        doubts = [reason for reason in diagnosis.report.reasons if reason.quantity != "ended_early"]
        return f"another recording: {' '.join([*slow, *(doubt.sentence for doubt in doubts[:1])])}"
    if diagnosis.report.verdict == "unknown_remains":
        return "no experiment of the catalogue tells more; the leftover's shape says where it is"
    if diagnosis.report.verdict == "mostly_explained":
        return "a part of the error remains that nothing in the library fits better; look at its shape"
    if diagnosis.report.verdict == "explained_in_another_form":
        return "nothing missing; the effect's form is not the library's, and the map's stated error includes that"
    return NOTHING_TO_DECIDE


def _names(diagnosis: Diagnosis) -> set[str]:
    return {effect.name for effect in diagnosis.report.effects}


def _time_constant_notes(report: DiagnosisReport) -> list[str]:
    """Notes that the winding is too fast for its samples or its injection, as `check` gives them for a plan."""
    return [remark.text for remark in report.remarks if remark.code == "time_constant"]
