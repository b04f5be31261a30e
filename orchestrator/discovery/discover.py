"""From a diagnosed recording to what was learned of it: `Discovery`, and the texts of the effects."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis._prepare import open_for_refit
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, observable_effects, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import left_of_excitation
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.reporting.ladder import held_out, mean_rms_v, noise_rms_v
from orchestrator.diagnosis.reporting.motor_model import reduced, require_effects_of, restored
from orchestrator.diagnosis.reporting.resemblance import Alternative, alternatives_to
from orchestrator.discovery.bases import CurveBasis, LineBasis
from orchestrator.discovery.forms import FormFit
from orchestrator.discovery.hypotheses import PHASE_NAMES, Hypothesis
from orchestrator.discovery.law import quotient
from orchestrator.discovery.laws import FittedLaw, error_of, text_of
from orchestrator.discovery.ranking import Score
from orchestrator.discovery.report import (
    Constant,
    CurvePoint,
    Discovery,
    FoundForm,
    FoundLaw,
    Outcome,
    RankedHypothesis,
)
from orchestrator.discovery.search import MIN_FALL, LearnedLaw, SearchOutcome, learn_laws
from orchestrator.discovery.writing import NamedLaw, gauge_of, sentence_of
from orchestrator.formatting.quantities import number, percent, quantity
from orchestrator.numerics.types import Array
from orchestrator.recording import Recording
from protocols import DiagnosisReport, Effect, MotorModel, ParameterRole

EXPLAINED = ("clean", "explained", "explained_in_another_form", "convention")
MAX_SHARE_OF_SEGMENT: float = 0.5
"""Part of a law's gain that one segment may carry."""
MAX_RESEMBLING_CHI2_RATIO: float = 2.0
"""Most chi2 of an effect of the library in a law's place, over the law's, to be named as what it looks like."""
SIGMAS: float = 1.96
CURVE_POINTS: int = 40
SCALES_OF_MEMORY: float = 4.0
"""Length of the curve of a law with memory, in its time constants or radii."""
PERIODS: float = 2.0
"""Length of the curve of a line."""
RANKED: int = 12


@dataclass(frozen=True)
class Learned:
    """A discovery with the text of its file of effects, empty where there is no law."""

    report: Discovery
    text: str = ""


@solvable
def discover_laws(
    recording: Recording,
    effects: Sequence[Effect],
    model: MotorModel | None,
    diagnosis: DiagnosisReport,
    *,
    name: str = "learned_law",
    without: Sequence[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> Learned:
    """Find the law that a diagnosed recording requires beyond the library.

    Parameters
    ----------
    effects : sequence of Effect
        The library; all effects of the model are in it.
    model, diagnosis
        What the diagnosis stored; it has no model of a recording that breaks its manifest's conventions.
    name : str
        Of the effect that is written.
    without : sequence of str
        Effects that are doubted: they are taken out of the model, whatever its verdict.

    Raises
    ------
    PluginError
        If an effect of the model is not installed.
    NotMeasuredError, RecordingError
        If the recording cannot be diagnosed.
    """
    began = time.monotonic()
    if model is not None:
        require_effects_of(model, {effect.name for effect in effects})
    doubted = [] if model is None else [effect.name for effect in model.effects if effect.name in without]
    if model is None or (diagnosis.verdict in EXPLAINED and not doubted):
        why = f"nothing to learn here: the verdict is {diagnosis.verdict.replace('_', ' ')}"
        return Learned(_without_law(diagnosis, "nothing_to_learn", why))
    model = reduced(model, doubted)
    setup = open_for_refit(recording, model, tell)
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest) if c.name not in without}
    whole = restored(setup, model, model.baseline, library)
    # Without a doubted effect all others have to find their sizes anew.
    before = setup.fitter.fit(whole) if doubted else setup.fitter.fit(whole, relinearisations=0, steps=1)
    whole = before.model if doubted else whole
    little = _too_little(before)
    if little:
        return Learned(_report(diagnosis, before, None, "nothing_to_learn", little, (), began))
    named = [effect.name for effect in diagnosis.effects if effect.name not in doubted]
    outcome = learn_laws(setup, whole, named, name, tell)
    verdict, why = _verdict(before, outcome)
    laws = _laws(setup, outcome, tuple(library.values())) if outcome.laws else ()
    report = _report(diagnosis, before, outcome, verdict, why, laws, began)
    return Learned(report, _text(setup, report, outcome) if verdict == "law" else "")


def _too_little(before: Fit) -> str:
    """Why the error that a model leaves is too small to learn from; empty where it is not."""
    criteria = before.criteria
    chi2, error, left = before.chi2_per_dof, error_of(before), left_of_excitation(before)
    if chi2 < criteria.selection.detected_chi2:
        return f"nothing to learn here: chi2 is {number(chi2)} per degree of freedom, which noise explains"
    if error < math.sqrt(1.0 + criteria.verdict.noise_accuracy_excess_chi2):
        return f"nothing to learn here: the held-out error is {number(error)} times its noise; measure a larger current"
    if left < criteria.verdict.negligible_voltage:
        return (
            f"nothing to learn here: what is left is {percent(100.0 * left)} of the applied voltage, within the "
            "model's error; measure a larger current"
        )
    return ""


def _verdict(before: Fit, outcome: SearchOutcome) -> tuple[Outcome, str]:
    if not outcome.laws:
        return "no_law", "no place and quantity whose law removes half of the error"
    was, now = min(error_of(before), error_of(outcome.start)), error_of(outcome.fit)
    share, segment = _largest_segment(outcome)
    if share > MAX_SHARE_OF_SEGMENT:
        why = f"nothing to learn here: {100 * share:.0f} % of the gain is by the segment {segment}; measure it again"
        return "nothing_to_learn", why
    if now - 1.0 > (1.0 - MIN_FALL) * (was - 1.0):
        why = f"the held-out error, {number(was)} times its noise, is {number(now)} times with the best law: not halved"
        return "no_law", why
    volts, floor = [mean_rms_v(fit, held_out) for fit in (before, outcome.fit)], noise_rms_v(outcome.fit, held_out)
    if volts[0] is not None and volts[1] is not None and volts[1] > max(volts[0], 1.2 * (floor or 0.0)):
        was_v, now_v = (quantity(v, "V") for v in volts)
        return "no_law", f"the held-out error at low frequencies grows from {was_v} to {now_v}"
    return "law", f"the held-out error falls from {number(error_of(before))} to {number(now)} times its noise"


def _largest_segment(outcome: SearchOutcome) -> tuple[float, str]:
    """The largest part of the fall of chi2 that one segment has, and its id; nothing where there are few segments."""
    start, fit = outcome.start, outcome.fit
    gains = {
        piece.segment.id: float(old @ old - new @ new)
        for piece, old, new in zip(fit.prepared.pieces, start.residual, fit.residual, strict=True)
        if not piece.held_out
    }
    total = sum(gains.values())
    segment = max(gains, key=lambda one: gains[one])
    return (gains[segment] / total if total > 0.0 and len(gains) > 4 else 0.0), segment


def _laws(setup: DiagnosisSetup, outcome: SearchOutcome, library: Sequence[CandidateEffect]) -> tuple[FoundLaw, ...]:
    found = []
    seen = observable_effects(library, [p.signals for p in setup.prepared.pieces])
    for law in outcome.laws:
        best, hypothesis = law.best, law.best.hypothesis
        noise = max(1.0, min(f.chi2 for f in law.forms))
        alternatives = alternatives_to(
            setup, best.fit, best.term.name, [c for c in seen if c.name not in best.fit.model.names]
        )
        like = [a.other for a in alternatives if a.is_tied or a.fits_better or _is_near(a)]
        alike = [a.other.replace("_", " ") for a in alternatives if a.is_tied or a.fits_better]
        found.append(
            FoundLaw(
                name=best.term.name,
                sentence=sentence_of(hypothesis),
                place=hypothesis.place.name,
                quantity=hypothesis.quantity.name,
                phase=PHASE_NAMES[hypothesis.phases],
                **_axes(hypothesis),
                forms=tuple(_form(f, best, noise) for f in law.forms),
                curve=_curve(law),
                as_well=(*(f"{one} of the library" for one in alike), *map(_described, law.near)),
                library=tuple(like),
                gauge=gauge_of(hypothesis),
                to_decide=_to_decide(law),
            )
        )
    return tuple(found)


def _is_near(one: Alternative) -> bool:
    """Whether an effect of the library leaves little more than the law in whose place it was fitted."""
    return one.in_place.chi2_per_dof <= MAX_RESEMBLING_CHI2_RATIO * one.fit.chi2_per_dof


def _axes(hypothesis: Hypothesis) -> dict[str, str]:
    """Names and units of the curve's axes."""
    place, of, kind = hypothesis.place, hypothesis.quantity, hypothesis.basis.kind
    if kind in ("lag", "cooling", "late"):
        return {
            "unit": quotient(place.unit, of.unit),
            "quantity_unit": "s",
            "symbol": f"time after a step of {of.symbol}",
        }
    return {"unit": place.unit, "quantity_unit": of.unit, "symbol": of.symbol}


def _described(hypothesis: Hypothesis) -> str:
    text = sentence_of(hypothesis).rstrip(".")
    return text[0].lower() + text[1:]


def _form(fitted: FittedLaw, best: FittedLaw, noise: float) -> FoundForm:
    assert fitted.law is not None
    return FoundForm(
        name=fitted.law.label,
        formula=fitted.law.formula,
        constants=tuple(_constants(fitted)),
        chi2=fitted.chi2,
        heldout=fitted.error,
        heldout_rms_v=mean_rms_v(fitted.fit, held_out),
        log_evidence=fitted.log_evidence(noise) - best.log_evidence(noise),
    )


def _stood_in(whole: Fit, after: Fit) -> tuple[str, ...]:
    """Effects of a model that are not in the one with laws, or all of whose free amplitudes have zero within 95 %."""
    std = list(np.sqrt(np.diag(after.covariance(max(after.chi2_per_dof, 1.0)))))
    at_zero = set()
    for term in reversed(after.model.active):
        own, std = std[len(std) - len(term.free) :], std[: len(std) - len(term.free)]
        spread = dict(zip(term.free, own, strict=True))
        sizes = [p for p in term.candidate.parameters if p.role is ParameterRole.AMPLITUDE and p.name in term.free]
        if sizes and all(
            _low_and_high(term, p.name, spread)[0] <= p.neutral <= _low_and_high(term, p.name, spread)[1] for p in sizes
        ):
            at_zero.add(term.name)
    left = set(after.model.names) - at_zero
    return tuple(name for name in whole.model.names if name not in left)


def _low_and_high(term: EffectTerm, name: str, spread: Mapping[str, float]) -> tuple[float, float]:
    """The 95 % interval of a parameter, by the standard deviations of its standardised values."""
    x, s = term.standardised_value(name), SIGMAS * float(spread.get(name, 0.0))
    low, high = sorted(term.moved(name, x + sign * s).values[name] for sign in (-1.0, 1.0))
    return low, high


def _constants(fitted: FittedLaw) -> list[Constant]:
    term = fitted.term
    covariance = fitted.fit.covariance(max(fitted.chi2, 1.0))
    spread = dict(zip(term.free, np.sqrt(np.diag(covariance))[-len(term.free) :], strict=True))
    found = []
    for p in term.candidate.parameters:
        ends = _low_and_high(term, p.name, spread)
        found.append(Constant(name=p.name, value=term.values[p.name], low=ends[0], high=ends[1], unit=p.unit))
    return found


def _curve(law: LearnedLaw) -> tuple[CurvePoint, ...]:
    """The flexible law and its standard deviation; with memory, what shows it (`Basis.design`), for a few scales."""
    basis, score = law.flexible.hypothesis.basis, law.flexible
    if isinstance(basis, CurveBasis):
        x = basis.grid(CURVE_POINTS)
        x = x if basis.parity == "none" else np.concatenate([-x[:0:-1], x])
    elif isinstance(basis, LineBasis):
        x = np.linspace(0.0, PERIODS / basis.frequency_hz, CURVE_POINTS)
    else:
        assert law.best.law is not None
        assert isinstance(law.best.law.form, FormFit)
        x = np.linspace(0.0, SCALES_OF_MEMORY * law.best.law.form.scale, CURVE_POINTS)
    design = basis.design(x)
    y = _beside_the_rest(law, x, design @ score.coefficients)
    std = np.sqrt(np.einsum("ij,jk,ik->i", design, score.covariance, design))
    return tuple(CurvePoint(x=float(a), y=float(b), std=float(c)) for a, b, c in zip(x, y, std, strict=True))


def _beside_the_rest(law: LearnedLaw, x: Array, y: Array) -> Array:
    """A curve without the constant, or the line of an odd one, that R_s, the map or an effect of the model takes up."""
    chosen, basis = law.best.law, law.flexible.hypothesis.basis
    if chosen is None or not isinstance(basis, CurveBasis) or not isinstance(chosen.form, FormFit):
        return y
    open_part = x if basis.parity == "odd" else np.ones_like(x)
    apart = y - chosen.values(x)
    taken_up = open_part * (open_part @ apart) / (open_part @ open_part)
    return y - taken_up if np.linalg.norm(apart - taken_up) < 0.5 * np.linalg.norm(apart) else y


def _to_decide(law: LearnedLaw) -> str:
    """Where the forms that do as well differ most, up to half beyond the range of the quantity."""
    basis, hypothesis = law.flexible.hypothesis.basis, law.best.hypothesis
    forms = [f.law.form for f in law.forms if f.law is not None and f.hypothesis.key == hypothesis.key]
    if len(forms) < 2 or not isinstance(basis, CurveBasis):
        return ""
    top = max(abs(basis.low), abs(basis.high))
    x = np.linspace(0.01 * top, 1.5 * top, 300)
    curves = [f.size * f.form.of(x, f.scale, f.power) for f in forms[:2] if isinstance(f, FormFit) and f.form]
    if len(curves) < 2:
        return ""
    unit, of = hypothesis.place.unit, hypothesis.quantity
    at = decisive_index(curves[0], curves[1], _relative_error(_constants(law.best)))
    if at is None:
        range_text = f"up to {number(float(x[-1]))} {of.unit}"
        return f"nothing to measure: {range_text} the forms differ by less than the error of their size; keep either"
    first, second = (quantity(float(c[at]), unit) if unit != "1" else number(float(c[at])) for c in curves)
    return f"measure at {of.text} = {number(float(x[at]))} {of.unit}: {first} by the first form, {second} by the second"


def decisive_index(first: Array, second: Array, relative_error: float) -> int | None:
    """Where two curves (n,) differ most; None where that is within an error of the first one's size."""
    apart = np.abs(first - second)
    at = int(np.argmax(apart))
    return None if apart[at] <= relative_error * abs(float(first[at])) else at


def _relative_error(constants: Sequence[Constant]) -> float:
    """Half of the size's 95 % interval over the size, which comes first."""
    size = constants[0]
    return 0.5 * (size.high - size.low) / abs(size.value) if size.value else math.inf


def _report(
    diagnosis: DiagnosisReport,
    before: Fit,
    outcome: SearchOutcome | None,
    verdict: Outcome,
    why: str,
    laws: tuple[FoundLaw, ...],
    began: float,
) -> Discovery:
    after = outcome.fit if outcome is not None else before
    learned = {law.name for law in laws}
    return Discovery(
        recording=diagnosis.recording,
        outcome=verdict,
        reason=why,
        verdict=diagnosis.verdict,
        before=error_of(before),
        after=error_of(after),
        before_rms_v=mean_rms_v(before, held_out),
        after_rms_v=mean_rms_v(after, held_out),
        floor_rms_v=noise_rms_v(after, held_out),
        chi2_before=before.chi2_per_dof,
        chi2_after=after.chi2_per_dof,
        laws=laws,
        ranking=tuple(_ranked(s) for s in (outcome.ranking[:RANKED] if outcome is not None else ())),
        kept_effects=tuple(name for name in after.model.names if name not in learned),
        stood_in=_stood_in(before, after) if laws and outcome is not None else (),
        seconds=time.monotonic() - began,
    )


def _ranked(score: Score) -> RankedHypothesis:
    hypothesis, basis = score.hypothesis, score.hypothesis.basis
    return RankedHypothesis(
        place=hypothesis.place.name,
        quantity=hypothesis.quantity.name,
        phase=PHASE_NAMES[hypothesis.phases],
        kind=basis.parity if isinstance(basis, CurveBasis) else basis.kind,
        log_evidence=score.log_evidence,
        share=min(score.share, 1.0) if math.isfinite(score.share) else 0.0,
    )


def _without_law(diagnosis: DiagnosisReport, verdict: Outcome, why: str) -> Discovery:
    last = diagnosis.ladder[-1] if diagnosis.ladder else None
    chi2, volts = (last.chi2 or 0.0, last.heldout_rms_v) if last is not None else (0.0, None)
    return Discovery(
        recording=diagnosis.recording, outcome=verdict, reason=why, verdict=diagnosis.verdict, before=0.0, after=0.0,
        before_rms_v=volts, after_rms_v=volts, floor_rms_v=diagnosis.noise_floor.heldout_rms_v, chi2_before=chi2,
        chi2_after=chi2, laws=(), ranking=(), kept_effects=tuple(e.name for e in diagnosis.effects), seconds=0.0,
    )  # fmt: skip


def _text(setup: DiagnosisSetup, report: Discovery, outcome: SearchOutcome) -> str:
    return text_of(
        setup,
        [
            NamedLaw(learned.best.law, found.name, _story(report, found))
            for found, learned in zip(report.laws, outcome.laws, strict=True)
            if learned.best.law is not None
        ],
    )


def _story(report: Discovery, law: FoundLaw) -> list[str]:
    form = law.forms[0]
    constants = ", ".join(
        f"{c.name} {number(c.value)} {c.unit if c.unit != '1' else ''}".rstrip()
        + f" (95 %: {number(c.low)} to {number(c.high)})"
        for c in form.constants
    )
    volts = ""
    if report.before_rms_v is not None and report.after_rms_v is not None and report.floor_rms_v is not None:
        was, now, floor = (quantity(v, "V") for v in (report.before_rms_v, report.after_rms_v, report.floor_rms_v))
        volts = f", in volts from {was} to {now} where noise alone makes {floor}"
    story = [
        f"Learned from the recording {report.recording}: its held-out error falls from {number(report.before)} to "
        f"{number(report.after)} times the noise{volts}; chi2 per degree of freedom from {number(report.chi2_before)} "
        f"to {number(report.chi2_after)}.",
        f"Constants there, where the class has those of a 400 W machine: {constants}.",
    ]
    others = [other.formula for other in law.forms[1:]]
    if others:
        story.append(f"As well: y = {'; y = '.join(others)}. To decide: {law.to_decide or 'no experiment is known'}.")
    if law.as_well:
        story.append(f"As well: {'; '.join(law.as_well)}.")
    return story
