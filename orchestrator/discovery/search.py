"""The search for a law: rank flexible laws, find a short form, and test it on the stages that were held out.

What a diagnosis names beside an unknown may be its stand-in, and what it does not name may be there. So the whole
model and R_s and map alone are started from too, unless a law beside the named causes leaves no more than noise. The
one whose best law leaves the least is kept. As long as
more than noise is left, a further law is looked for beside the first.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, with_finest_map
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.discovery.bases import CurveBasis, MemoryBasis
from orchestrator.discovery.forms import FormFit, fitting_forms
from orchestrator.discovery.hypotheses import Hypothesis, Ranges, hypotheses, in_words, line_hypotheses
from orchestrator.discovery.law import POWER_BOUNDS, Law, Line, Table
from orchestrator.discovery.laws import (
    FittedLaw,
    fit_flexible,
    fit_law,
    keeps_scale,
    line_of,
    score_of,
    table_of,
    with_fitted_constants,
)
from orchestrator.discovery.proposals import gradient_over, step_places
from orchestrator.discovery.ranking import Score, rank
from orchestrator.formatting.quantities import duration

MAX_LAWS: int = 2
NEAR: float = 1.5
"""chi2 that another hypothesis may leave, relative to the best one's or to noise, to be fitted too."""
MIN_FALL: float = 0.5
"""Part of the held-out error above its noise that a law has to remove."""
MAX_NEAR: int = 3
"""Hypotheses that are fitted to the whole recording; of a second law, the best one alone."""
MAX_FORMS: int = 3
"""Short forms of a law that are refitted."""
MIN_SHARE: float = 0.5
"""Part of the excess chi2 that a law has to remove, to be worth a fit."""
SAME_NAT: float = 3.0
"""Difference of the log evidence up to which two forms do as well."""
SAME_ERROR: float = 0.02
"""Relative difference of the held-out errors, and of chi2 per degree of freedom, up to which they do as well."""
CLOSE_CHI2: float = 1.5
"""chi2 per degree of freedom of the best curve from which other hypotheses' formulas are fitted too; of the best
formula, from which a second law is looked for."""
CLOSE_ERROR: float = 1.2
"""Held-out error, in units of its noise, below which no second law is looked for."""
UNRELIABLE_CHI2: float = 0.3
"""chi2 per degree of freedom below which a linear prediction has left its range."""
STEPS: int = 12
"""Places of a step that are compared, by the residual's gradient."""
BESIDE: int = 12
"""Samples on either side of the best of them, between which the step is placed then."""
REFINED: tuple[tuple[int, float], ...] = ((9, 0.03), (16, 0.03), (24, 0.1), (24, 0.01))
"""Intervals of a curve and its knee, of which the evidence chooses."""


@dataclass(frozen=True)
class LearnedLaw:
    """A law with all that was fitted of it.

    Attributes
    ----------
    flexible : Score
        The flexible law of the chosen form, as fitted to the whole recording.
    forms : tuple of FittedLaw
        The chosen one first, then those that do as well.
    near : tuple of Hypothesis
        Others whose flexible laws do as well.
    """

    flexible: Score
    forms: tuple[FittedLaw, ...]
    near: tuple[Hypothesis, ...]

    @property
    def best(self) -> FittedLaw:
        return self.forms[0]


@dataclass(frozen=True)
class SearchOutcome:
    """All laws that were learned.

    Attributes
    ----------
    start : Fit
        The model that the laws were added to, on the whole recording.
    laws : tuple of LearnedLaw
        In the order in which they were added.
    ranking : tuple of Score
        The first ranking, the best first.
    """

    start: Fit
    laws: tuple[LearnedLaw, ...]
    ranking: tuple[Score, ...]

    @property
    def fit(self) -> Fit:
        return self.laws[-1].best.fit if self.laws else self.start


@dataclass(frozen=True)
class _Start:
    """A model on the part of the recording, and its ranking."""

    part: Fit
    ranking: list[Score]

    @property
    def least_chi2(self) -> float:
        """Per degree of freedom, that the best law would leave; infinite where that cannot be predicted."""
        left = min((s.chi2 / self.part.dof for s in self.ranking[:1]), default=np.inf)
        return left if left > UNRELIABLE_CHI2 else np.inf


def learn_laws(
    setup: DiagnosisSetup, model: Model, named: Sequence[str], name: str, tell: Callable[[str], None]
) -> SearchOutcome:
    """Look for the laws that a diagnosed recording requires.

    Parameters
    ----------
    model : Model
        The diagnosis'.
    named : sequence of str
        Effects that it names as causes.
    name : str
        Of the effect to be written.
    """
    causes = [a for a in model.active if a.name in named]
    starts = []
    for active in _distinct([causes, list(model.active), []]):
        beside = ", ".join(a.name.replace("_", " ") for a in active) or "R_s and map"
        tell(f"which place and quantity, beside {beside}?")
        starts.append(_start(setup, model.with_active(active)))
        if starts[-1].least_chi2 < CLOSE_CHI2:
            break
    start = min(starts, key=lambda one: one.least_chi2)
    if not np.isfinite(start.least_chi2):
        start = starts[-1]
    fit = setup.fitter.fit(model.with_active(start.part.model.active))
    first = start.ranking
    laws: list[LearnedLaw] = []
    while True:
        law = _learn(setup, start, fit, _numbered(name, len(laws)), 1 if laws else MAX_NEAR, tell)
        if law is None or (laws and law.best.error - 1.0 > (1.0 - MIN_FALL) * (laws[-1].best.error - 1.0)):
            break
        law = _on_finer_map(setup, law, tell)
        laws.append(law)
        fit = law.best.fit
        if len(laws) == MAX_LAWS or fit.chi2_per_dof < CLOSE_CHI2 or law.best.error < CLOSE_ERROR:
            break
        tell("is there a second law?")
        start = _start(setup, fit.model, besides=[law.best.hypothesis for law in laws])
    before = _without_laws(setup, laws) if laws else fit
    return SearchOutcome(before, tuple(laws), tuple(first))


def _distinct(models: Sequence[list[EffectTerm]]) -> list[list[EffectTerm]]:
    """Each selection of effects once, in the given order; the empty one last."""
    by_names = {tuple(term.name for term in one): one for one in models}
    return [*(one for names, one in by_names.items() if names), []]


def _on_finer_map(setup: DiagnosisSetup, law: LearnedLaw, tell: Callable[[str], None]) -> LearnedLaw:
    """The law learned anew on the map that the rest requires; a large misfit had kept the diagnosis from it."""
    best = law.best
    if best.chi2 < best.fit.criteria.selection.detected_chi2:
        return law
    tell("a finer map beside the law?")
    finer = with_finest_map(setup, setup.fitter, best.fit)
    if finer is best.fit:
        return law
    kept = replace(best, fit=finer)
    kept = replace(kept, law=with_fitted_constants(kept))
    bare = setup.fitter.fit(finer.model.with_active(finer.model.active[:-1]), finer.linearisation)
    anew = _formed(setup, bare, [law.flexible], best.term.name, tell)
    if anew is not None and anew.best.chi2 < kept.chi2:
        return anew
    return replace(law, forms=(kept,))


def _without_laws(setup: DiagnosisSetup, laws: Sequence[LearnedLaw]) -> Fit:
    """The model before the first law."""
    model = laws[0].best.fit.model
    return setup.fitter.fit(model.with_active(model.active[:-1]))


def _numbered(name: str, before: int) -> str:
    return name if before == 0 else f"{name}_{before + 1}"


def _start(setup: DiagnosisSetup, model: Model, besides: Sequence[Hypothesis] = ()) -> _Start:
    """A model with its ranking, without laws at the place of those that it has, over their quantity."""
    part = setup.part_fitter.fit(model)
    there = {(one.place.name, one.quantity.name) for one in besides}
    ranges = Ranges.in_fit(part)
    every = [h for h in hypotheses(ranges) if (h.place.name, h.quantity.name) not in there]
    ranking = rank(setup.part_fitter, part, every)
    least = ranking[0].chi2 if ranking else part.chi2
    if least > CLOSE_CHI2 * part.dof:
        lines = [h for h in line_hypotheses(part, ranges) if (h.place.name, h.quantity.name) not in there]
        ranking = [*(s for s in rank(setup.part_fitter, part, lines)[:1] if s.chi2 < least), *ranking]
    return _Start(part, ranking)


def _learn(
    setup: DiagnosisSetup, start: _Start, fit: Fit, name: str, max_near: int, tell: Callable[[str], None]
) -> LearnedLaw | None:
    """The best law beside a model, of so many hypotheses at most; None where none removes much."""
    threshold = fit.criteria.selection.log_evidence
    limit = NEAR * max(start.ranking[0].chi2, start.part.dof) if start.ranking else 0.0
    near = [s for s in start.ranking[:max_near] if s.chi2 <= limit]
    near = [s for s in near if s.log_evidence > threshold and s.share > MIN_SHARE]
    if not near:
        return None
    return _formed(setup, fit, [_refined(setup, start.part, score) for score in near], name, tell)


def _formed(
    setup: DiagnosisSetup, fit: Fit, scores: Sequence[Score], name: str, tell: Callable[[str], None]
) -> LearnedLaw | None:
    """The flexible laws fitted beside a model, and the short forms of the best; None where it has none."""
    flexible = []
    for step, score in zip(_steps("curve", len(scores), tell), scores, strict=True):
        step(in_words(score.hypothesis))
        flexible.append(fit_flexible(setup.fitter, fit, score))
    flexible = [f for f in flexible if keeps_scale(f, fit)]
    if not flexible:
        return None
    noise = max(1.0, min(f.chi2 for f in flexible))
    flexible.sort(key=lambda f: -f.log_evidence(noise))
    best = flexible[0]
    # Where no curve comes down to the noise, a formula with a step or a corner may, of another one of them.
    tied = flexible if best.chi2 > CLOSE_CHI2 else [f for f in flexible if _does_as_well(f, best, noise)]
    fitted = []
    for one in tied:
        fitted += [f for f in _in_forms(setup, fit, one, name, tell) if keeps_scale(f, fit)]
    if not fitted:
        return None
    noise = max(1.0, min(f.chi2 for f in (*fitted, best)))
    chosen = _chosen(fitted, noise)
    of = next(f for f in flexible if f.hypothesis.key == chosen[0].hypothesis.key)
    rivals = [f for f in flexible if f is not of and best.chi2 <= CLOSE_CHI2 and _does_as_well(f, best, noise)]
    return LearnedLaw(score_of(of), chosen, tuple(f.hypothesis for f in rivals))


def _chosen(fitted: Sequence[FittedLaw], noise: float) -> tuple[FittedLaw, ...]:
    """The form to keep, and those that do as well; the table where no short form comes near it."""
    ordered = sorted(fitted, key=lambda f: -f.log_evidence(noise))
    forms, tables = [f for f in ordered if not _is_table(f)], [f for f in ordered if _is_table(f)]
    if forms and (not tables or _comes_near(forms[0], tables[0], noise)):
        best = _simplest_first([f for f in forms if _does_as_well(f, forms[0], noise)])
        # Where no likelihood separates formulas of two quantities, that of the better curve comes first.
        curves = list(dict.fromkeys(f.hypothesis.key for f in fitted))
        limit = best[0].fit.chi2 + 2.0 * SAME_NAT * noise
        return tuple(sorted(best, key=lambda f: (f.fit.chi2 > limit, curves.index(f.hypothesis.key))))
    return tuple(tables[:1])


def _comes_near(form: FittedLaw, table: FittedLaw, noise: float) -> bool:
    """Whether a form leaves little more than a table, whose evidence has no price for its many numbers."""
    likelier = form.log_evidence(noise) >= table.log_evidence(noise)
    return likelier or form.chi2 - 1.0 <= 1.5 * max(table.chi2 - 1.0, 0.05)


def _does_as_well(one: FittedLaw, best: FittedLaw, noise: float) -> bool:
    if one is best or best.log_evidence(noise) - one.log_evidence(noise) < SAME_NAT:
        return True
    close = SAME_ERROR * best.error
    return abs(one.error - best.error) < close and abs(one.chi2 - best.chi2) < SAME_ERROR * best.chi2


def _simplest_first(forms: Sequence[FittedLaw]) -> list[FittedLaw]:
    """The form with the fewest constants, then others with as many; what needs more for the same is no rival."""
    least = min(len(f.term.free) for f in forms)
    # Two starts of one form, as of a lag, end at the same constants.
    first = {(f.hypothesis.key, f.law and f.law.formula): f for f in reversed(forms) if len(f.term.free) == least}
    return [f for f in forms if any(f is one for one in first.values())]


def _is_table(fitted: FittedLaw) -> bool:
    return fitted.law is not None and isinstance(fitted.law.form, Table)


def _refined(setup: DiagnosisSetup, part: Fit, score: Score) -> Score:
    """The law with the resolution that the evidence prefers."""
    basis = score.hypothesis.basis
    if not isinstance(basis, CurveBasis) or basis.parity == "periodic":
        return score
    top = max(abs(basis.low), abs(basis.high))
    finer = [
        replace(
            score.hypothesis, basis=replace(basis, cells=cells, knee=knee * top if np.isfinite(basis.knee) else np.inf)
        )
        for cells, knee in REFINED
    ]
    return rank(setup.part_fitter, part, finer)[0]


def _in_forms(
    setup: DiagnosisSetup, fit: Fit, flexible: FittedLaw, name: str, tell: Callable[[str], None]
) -> list[FittedLaw]:
    """The best short forms of a flexible law, and its table, each refitted."""
    score = score_of(flexible)
    options: list[FormFit | Table | Line] = list(_promising(fitting_forms(score)))
    options += [option for option in (table_of(score), line_of(score)) if option is not None]
    fitted = []
    for step, option in zip(_steps("formula", len(options), tell), options, strict=True):
        if isinstance(option, FormFit) and option.form is not None and option.form.power_name == "sharpness":
            option = _located(setup, fit, score.hypothesis, option)
        law = Law(score.hypothesis, option)
        step(f"y = {law.formula}")
        one = fit_law(setup, fit, law, name)
        fitted.append(replace(one, law=with_fitted_constants(one)))
    return fitted


def _steps(what: str, count: int, tell: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """For each step a function that tells it, with the time that the rest of them takes as the steps before did."""
    began = time.monotonic()
    for k in range(count):
        each_s = (time.monotonic() - began) / k if k else None
        left = "" if each_s is None else f", {duration(each_s * (count - k))} left of these"
        yield partial(_tell_step, tell, f"{what} {k + 1} of {count}{left}")


def _tell_step(tell: Callable[[str], None], step: str, text: str) -> None:
    tell(f"{step}: {text}")


def _located(setup: DiagnosisSetup, fit: Fit, hypothesis: Hypothesis, step: FormFit) -> FormFit:
    """A step where it removes most; the curve that proposed it is coarser than a sample by far."""
    place, phases, quantity = hypothesis.place, hypothesis.phases, hypothesis.quantity
    x, gradient = gradient_over(fit, place, phases, quantity)
    values = [step.scale, *step_places(x, gradient, STEPS)]
    x = np.unique(x)
    for _ in range(2):
        steps = [replace(hypothesis, basis=MemoryBasis("step", (value,))) for value in values]
        best = rank(setup.fitter, fit, steps)[0]
        assert isinstance(best.hypothesis.basis, MemoryBasis)
        at, size = best.hypothesis.basis.values[0], float(best.coefficients[0])
        nearest = int(np.searchsorted(x, at))
        near = x[max(nearest - BESIDE, 0) : nearest + BESIDE]
        values = [at, *map(float, 0.5 * (near[1:] + near[:-1]))]
    edge = max(float(np.median(np.diff(near))), 2.0 * at / POWER_BOUNDS["sharpness"][2])
    return replace(step, size=size, scale=at, power=at / edge)


def _promising(forms: Sequence[FormFit]) -> list[FormFit]:
    """The best, and others that miss the flexible law by a few times as much."""
    if not forms:
        return []
    limit = 30.0 * max(forms[0].misfit, 10.0)
    single = [form for form in forms if form.form is not None and form.form.constants == 1]
    return [form for form in dict.fromkeys((*forms[:MAX_FORMS], *single[:1])) if form.misfit <= limit]
