"""Effects that resemble each other in a recording: which one fits better in the other's place, and the remarks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds, needed_contrasts, resembling, separable
from orchestrator.diagnosis.selection.scoring import fits_as_well
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.diagnosis.selection.search_state import evidence_gain
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from orchestrator.formatting.sentences import listed
from protocols import Inseparable, Remark

MAX_ALTERNATIVES: int = 2
"""Effects that are refitted in the place of one, those that imitate most of it first."""


@dataclass(frozen=True)
class Alternative:
    """Another effect in the place of one of a fit.

    Attributes
    ----------
    name, other : str
        The effect of the fit, and the one that was refitted in its place.
    fit, in_place : Fit
        With the effect, and with the other one.
    gain : float
        Gain in log evidence by the other one [nat].
    """

    name: str
    other: str
    fit: Fit
    in_place: Fit
    gain: float

    @property
    def is_tied(self) -> bool:
        """Whether neither is certain against the other, as an effect has to be against none."""
        lesser, better = (self.fit, self.in_place) if self.gain > 0.0 else (self.in_place, self.fit)
        return abs(self.gain) < self.fit.criteria.selection.log_evidence or fits_as_well(lesser, better)

    @property
    def sigmas(self) -> float:
        """Difference of the two fits in standard deviations."""
        inflation = max(1.0, min(self.fit.chi2_per_dof, self.in_place.chi2_per_dof))
        return math.sqrt(abs(self.in_place.objective - self.fit.objective) / inflation)

    @property
    def fits_better(self) -> bool:
        """Whether the other one fits better."""
        return self.gain > 0.0 and not self.is_tied


def alternatives_to(
    setup: DiagnosisSetup, fit: Fit, name: str, candidates: Sequence[CandidateEffect]
) -> list[Alternative]:
    """The absent effects that resemble one of the model, each refitted in its place."""
    absent = {c.name: c for c in candidates if c.name not in fit.model.names}
    others = [absent[other] for other in resembling(setup.fitter, fit, name, candidates) if other in absent]
    without = fit.model.with_active([a for a in fit.model.active if a.name != name])
    reduced = setup.fitter.evaluate(without, fit.linearisation) if others else fit
    return [_alternative(setup, fit, name, reduced, other) for other in others[:MAX_ALTERNATIVES]]


def _alternative(setup: DiagnosisSetup, fit: Fit, name: str, reduced: Fit, other: CandidateEffect) -> Alternative:
    trial = with_effect(setup, reduced, other)
    trial = setup.fitter.fit(trial.model, trial.linearisation)
    return Alternative(name, other.name, fit, trial, evidence_gain(trial, fit))


def own_alternatives(setup: DiagnosisSetup, fit: Fit, candidates: Sequence[CandidateEffect]) -> list[Alternative]:
    """Alternatives to the own effects of the model, and own effects as alternatives to the installed ones."""
    own = [c for c in candidates if is_own(c.effect)]
    return [
        alternative
        for active in (fit.model.active if own else ())
        for alternative in alternatives_to(setup, fit, active.name, candidates if active.candidate in own else own)
    ]


def refitted_ties(
    setup: DiagnosisSetup,
    fit: Fit,
    indistinguishable: Mapping[str, Sequence[str]],
    candidates: Sequence[CandidateEffect],
    known: Sequence[Alternative],
) -> list[Alternative]:
    """Effects that the search found indistinguishable, each refitted in the other's place in the final model.

    A search compares them while other effects are still missing. Those whose declared contrasts the recording lacks
    stay indistinguishable without a refit.
    """
    absent = {c.name: c for c in candidates if c.name not in fit.model.names}
    done = {(one.name, one.other) for one in known}
    refitted = []
    for term in fit.model.active:
        others = [absent[n] for n in indistinguishable.get(term.name, ()) if n in absent and (term.name, n) not in done]
        others = [one for one in others if separable(fit.prepared, one.effect, term.candidate.effect)]
        without = fit.model.with_active([a for a in fit.model.active if a.name != term.name])
        reduced = setup.fitter.evaluate(without, fit.linearisation) if others else fit
        refitted += [_alternative(setup, fit, term.name, reduced, other) for other in others]
    return refitted


def separated_remarks(refitted: Sequence[Alternative]) -> list[Remark]:
    """A remark, ``separated``, for each pair that the search found indistinguishable and that a refit separates."""
    text = "{effect} and {other} are separated, by {sigmas:.2g} sigma: {fits}"
    return [
        Remark.of(
            "separated",
            text,
            effect=plain(one.name),
            other=plain(one.other),
            sigmas=one.sigmas,
            fits=_fits_in_words(one),
        )
        for one in refitted
        if not one.is_tied
    ]


def alternative_remarks(alternatives: Sequence[Alternative]) -> list[Remark]:
    """A remark for each: ``indistinguishable``, ``fits_better_in_place`` or ``fits_worse_in_place``."""
    remarks = []
    for one in alternatives:
        if one.is_tied:
            code, text = "indistinguishable", "{effect} and {other} are indistinguishable here: {fits}" + _parting(one)
        elif one.fits_better:
            code = "fits_better_in_place"
            text = "{other} resembles {effect} and fits better in its place: {fits}; {effect} is no certain cause"
        else:
            code, text = "fits_worse_in_place", "{other} resembles {effect} and fits worse in its place: {fits}"
        words = {"effect": plain(one.name), "other": plain(one.other), "fits": _fits_in_words(one)}
        values = {"effect": one.name, "other": one.other, "gain_nat": one.gain}
        remarks.append(Remark.of(code, text, **words).model_copy(update={"values": values}))
    return remarks


def _parting(one: Alternative) -> str:
    """What would tell the two apart, as far as both declare it and the recording lacks it."""
    prepared = one.fit.prepared
    effects = [
        next(term.candidate.effect for term in fit.model.active if term.name == name)
        for fit, name in ((one.fit, one.name), (one.in_place, one.other))
    ]
    lacking = [CONTRASTS[c].text for c in needed_contrasts(*effects) if not holds(prepared, c)]
    same = "; what was measured leaves the same residual with either"
    return f"{same}, and {listed(lacking)} would tell them apart" if lacking else f"{same}, within the noise"


def resembling_pairs(fitter: Fitter, fit: Fit, names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of one of these effects of the model and another of the model that resembles it."""
    pairs: list[tuple[str, str]] = []
    for name in (n for n in names if n in fit.model.names):
        others = resembling(fitter, fit, name, ())
        pairs += [(name, other) for other in others if (other, name) not in pairs]
    return pairs


@dataclass(frozen=True)
class NeededPair:
    """Two effects of a model that resemble each other, and of which neither can take the other's place.

    Attributes
    ----------
    names : tuple of str
    chi2 : float
        chi2 per degree of freedom of the model with both.
    chi2_without : tuple of float
        That of the model refitted without each, in the order of the names.
    """

    names: tuple[str, str]
    chi2: float
    chi2_without: tuple[float, float]


def separately_needed(
    fitter: Fitter, fit: Fit, pairs: Sequence[tuple[str, str]]
) -> tuple[list[tuple[str, str]], list[NeededPair]]:
    """The pairs whose sizes are not determined separately, and those of which the data need both.

    Small changes of one are imitated by the other in either case. A refit without one shows whether its whole size is.
    """
    least = fit.criteria.selection.log_evidence
    without: dict[str, Fit] = {}
    tied, needed = [], []
    for pair in pairs:
        for name in pair:
            if name not in without:
                rest = fit.model.with_active([a for a in fit.model.active if a.name != name])
                without[name] = fitter.fit(rest, fit.linearisation)
        first, second = (without[name] for name in pair)
        if all(evidence_gain(one, fit) < -least and not fits_as_well(one, fit) for one in (first, second)):
            needed.append(NeededPair(pair, fit.chi2_per_dof, (first.chi2_per_dof, second.chi2_per_dof)))
        else:
            tied.append(pair)
    return tied, needed


def needed_remarks(needed: Sequence[NeededPair]) -> list[Remark]:
    """A remark, ``both_needed``, for each pair of similar effects of which the data need both."""
    text = (
        "{effect} and {other} resemble each other, and the recording needs both: chi2 rises from {chi2} to {first} "
        "without {effect}, and to {second} without {other}"
    )
    return [
        Remark.of(
            "both_needed",
            text,
            effect=plain(pair.names[0]),
            other=plain(pair.names[1]),
            chi2=number(pair.chi2, 3),
            first=number(pair.chi2_without[0], 3),
            second=number(pair.chi2_without[1], 3),
        )
        for pair in needed
    ]


def pair_remarks(pairs: Sequence[tuple[str, str]]) -> list[Remark]:
    """A remark, ``resemble_each_other``, for each pair of effects whose sizes are not determined separately."""
    text = (
        "{effect} and {other} are both in the model and resemble each other: this recording does not determine their "
        "sizes separately; `fluxbench remove` each in turn, and leave out the one without which chi2 rises less"
    )
    return [
        Remark.of("resemble_each_other", text, effect=plain(one), other=plain(other)).model_copy(
            update={"values": {"effect": one, "other": other}}
        )
        for one, other in pairs
    ]


def inseparable_remark(pair: Inseparable) -> Remark:
    """Remark, ``not_separable``, on two effects that no stage separates."""
    text = (
        "{first} and {second}: not separable by any experiment this bench can make: at the size found the best would "
        "separate them by {best:.2g} sigma, and {least:.2g} are needed"
    )
    first, second = map(plain, pair.separates)
    numbers = {"best": pair.best_sigmas, "least": pair.least_sigmas}
    if pair.reached_sigmas is not None:
        text = (
            "{first} and {second}: the stage that separates them most is measured already, and the recording separates "
            "them by {reached:.2g} sigma where {least:.2g} are needed; any other stage adds {best:.2g} sigma at most"
        )
        numbers["reached"] = pair.reached_sigmas
    return Remark.of("not_separable", text, first=first, second=second, **numbers)


def with_tied(
    indistinguishable: Mapping[str, Sequence[str]],
    alternatives: Sequence[Alternative],
    pairs: Sequence[tuple[str, str]],
) -> dict[str, list[str]]:
    """The indistinguishable effects by name, with tied alternatives and pairs added; less what a refit separates."""
    apart = {(one.name, one.other) for one in alternatives if not one.is_tied}
    tied = {
        name: [other for other in others if (name, other) not in apart] for name, others in indistinguishable.items()
    }
    links = [(one.name, one.other) for one in alternatives if one.is_tied]
    for name, other in (*links, *pairs, *((other, name) for name, other in pairs)):
        if other not in tied.setdefault(name, []):
            tied[name].append(other)
    return tied


def _fits_in_words(one: Alternative) -> str:
    """``chi2 1.02 with dead time, 885 with tanh drop (log evidence -1200 nat)``.

    Where chi2 alone says the opposite, the sentence says what the log evidence counts besides.
    """
    gain = number(round(one.gain), 6) if abs(one.gain) >= 10.0 else number(one.gain, 2)
    sign = "+" if one.gain > 0.0 else ""
    ends = f"chi2 {number(one.fit.chi2_per_dof, 4)} with {plain(one.name)}, "
    is_opposite = (one.in_place.chi2_per_dof < one.fit.chi2_per_dof) != (one.gain > 0.0)
    besides = ", which counts also how many parameters fit and how usual their values are" if is_opposite else ""
    return (
        f"{ends}{number(one.in_place.chi2_per_dof, 4)} with {plain(one.other)} (log evidence {sign}{gain} nat{besides})"
    )
