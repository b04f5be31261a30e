"""What became of the effects from outside the library: each that is not in the model has a remark.

They were given beside the installed ones, or another distribution installed them.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.determination import undeterminable_words
from orchestrator.diagnosis.selection.contrasts import inseparable_from
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from orchestrator.formatting.sentences import listed
from orchestrator.registry.plugins import PluginKind, of_other_distributions
from protocols import LAYER_CHANGES, RealArray, Remark, SearchEvent, Signals

MAX_NEUTRAL_CHANGE: float = 1e-9
"""Change of a signal by neutral parameters, over its largest value, that rounding explains."""


def own_effect_remarks(
    fitter: Fitter,
    candidates: Sequence[CandidateEffect],
    observable: Sequence[CandidateEffect],
    fit: Fit,
    events: Sequence[SearchEvent],
    besides: Container[str] = (),
) -> list[Remark]:
    """A remark for each own effect that the model has not: code ``own_effect_tried`` or ``own_effect_not_tried``.

    Parameters
    ----------
    candidates, observable : sequence of CandidateEffect
        All candidates, and those that some segment can show.
    fit : Fit
        The search's last.
    events : sequence of SearchEvent
        The moves of the search.
    besides : container of str
        Effects that need no remark, because another one has their result.
    """
    can_show = {candidate.name for candidate in observable}
    others = of_other_distributions(PluginKind.EFFECTS)
    remarks = []
    for candidate in candidates:
        name = candidate.name
        if name in fit.model.names or name in besides or not (is_own(candidate.effect) or name in others):
            continue
        trials = _trials(name, events)
        if trials:
            text = "{effect}: tried, and not in the model: {trials}; `explain` lists all moves"
            remarks.append(Remark.of("own_effect_tried", text, effect=plain(name), trials="; ".join(trials)))
        else:
            text = "{effect}: not fitted: {why}"
            why = "no segment can show it" if name not in can_show else _why_not_fitted(fitter, candidate, fit, events)
            remarks.append(Remark.of("own_effect_not_tried", text, effect=plain(name), why=why))
    return remarks


def contract_remarks(fit: Fit, candidates: Sequence[CandidateEffect]) -> list[Remark]:
    """Remarks on own effects whose size means nothing: those that act at neutral values, or beyond their layer.

    Code ``breaks_contract``. It is what the conformance kit checks first, on the segment of the largest current.
    """
    own = [candidate for candidate in candidates if is_own(candidate.effect)]
    bases = [one.base for one in fit.linearisation.batches] if own else []
    segments = [base.segment(k) for base in bases for k in range(len(base.segments)) if base.segments[k].bridge_on]
    if not segments:
        return []
    signals = max(segments, key=lambda s: float(np.abs(s.i_ab).max()))
    text = "{effect}: {problems}, so that its size and what resembles it mean little: run its conformance kit first"
    found = {candidate.name: _broken_rules(candidate, signals) for candidate in own}
    return [
        Remark.of("breaks_contract", text, effect=plain(name), problems=" and ".join(problems))
        for name, problems in found.items()
        if problems
    ]


def _broken_rules(candidate: CandidateEffect, signals: Signals) -> list[str]:
    neutral, typical = (
        EffectTerm(candidate, {p.name: getattr(p, which) for p in candidate.parameters}, ())
        for which in ("neutral", "typical")
    )
    before, after = (candidate.effect.correct(signals, term.parameters).arrays for term in (neutral, typical))
    beyond = sorted(after.keys() - LAYER_CHANGES[candidate.effect.layer])
    moved = [] if any(p.strong_when_small for p in candidate.parameters) else sorted(before)
    moved = [name for name in moved if _change(getattr(signals, name), before[name]) > MAX_NEUTRAL_CHANGE]
    problems = [f"at its neutral values it changes {listed(moved)}"] if moved else []
    return problems + (
        [f"its layer is {candidate.effect.layer.name}, but it changes {listed(beyond)}"] if beyond else []
    )


def _change(before: RealArray | None, after: RealArray) -> float:
    """Largest change of an array over its largest value."""
    change = after if before is None else after - before
    size = 0.0 if before is None else float(np.abs(before).max())
    return float(np.abs(change).max()) / max(size, 1e-12)


def _trials(name: str, events: Sequence[SearchEvent]) -> list[str]:
    """The first refit with an effect, and the last decision on it, in words."""
    own = [event for event in events if name in event.effects]
    refit = next((event for event in own if event.move == "refit"), None)
    decided = [event for event in own if event.move in ("full_model", "add", "remove", "swap", "merge")]
    trials = []
    if refit is not None:
        winner = next((e for e in events if e.move == "add" and e.step > refit.step and name not in e.effects), None)
        better = "" if winner is None else f" ({listed([plain(n) for n in winner.effects])}: {_score(winner)})"
        trials.append(f"added alone, {_chi2(refit)}, {_score(refit)}{better}")
    if decided:
        last = decided[-1]
        others = [plain(other) for other in last.effects if other != name]
        words = (_decision(last, others), _chi2(last), _score(last) + _needed(last))
        trials.append(", ".join(part for part in words if part))
    return trials


def _decision(event: SearchEvent, others: Sequence[str]) -> str:
    """What a move did with an effect."""
    if event.move == "full_model":
        return "fitted together with all others"
    if event.move in ("swap", "merge"):
        return f"compared with {listed(list(others))}, {event.decision}"
    done = {"add": "added", "remove": "removed"}[event.move]
    together = f" together with {len(others)} others" if others else ""
    return f"{done}{together}" if event.decision == "accepted" else f"not {done}{together}"


def _chi2(event: SearchEvent) -> str:
    ends = [number(chi2) for chi2 in (event.chi2_before, event.chi2_after) if chi2 is not None]
    return f"chi2 {' → '.join(ends)}" if ends else ""


def _score(event: SearchEvent) -> str:
    """The move's score."""
    if event.score is None:
        return ""
    score = number(event.score, 6 if abs(event.score) >= 1000.0 else 3)
    return f"log evidence {score} nat" if event.measure == "log_evidence" else f"chi2 falls by {score} in all"


def _needed(event: SearchEvent) -> str:
    """The number that a move's score was compared with."""
    if event.score is None or event.threshold is None or event.measure != "log_evidence":
        return ""
    return f" (at least {number(event.threshold, 3)} nat for this)"


def _why_not_fitted(fitter: Fitter, candidate: CandidateEffect, fit: Fit, events: Sequence[SearchEvent]) -> str:
    tied = [plain(term.name) for term in fit.model.active if inseparable_from(fitter, fit, term, [candidate])]
    if tied:
        return f"this recording cannot separate it from {listed(tied)}"
    if unknown := undeterminable_words(fitter, fit, candidate):
        return unknown
    screen = next((event for event in reversed(events) if event.move == "screen" and event.effects), None)
    if screen is None:
        return "the search ended before it"
    largest = f"the largest, of {plain(screen.effects[0])}, is {number(screen.score, 3)}"
    return f"its predicted fall of chi2 is too small; {largest} ({number(screen.threshold, 3)} needed)"
