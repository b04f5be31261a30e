"""Forward search: which effects the data ask for, one after the other, and how sure that is. Words nothing.

An effect is scored linearly first; the best few are refitted with their shapes free and compared by Laplace
evidence, with the noise inflated by the best chi2 per degree of freedom reached. An accepted effect's shape is
refined before another is tried: the wrong shape of the right effect causes most spurious second ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis._fit import Fitter, absent_columns
from orchestrator.diagnosis._fitted import Fit
from orchestrator.diagnosis._library import Active, Candidate
from protocols import ParameterRole

Array = NDArray[np.float64]

LOG_EVIDENCE = 12.0
"""Least gain in log evidence (natural) for an effect to be added: chance alone reaches this once in some 1e5 tries."""
TIE = 3.0
"""Rivals this near in log evidence cannot be told apart."""
LEAST_SIZE = 0.01
"""Effects smaller than this part of their typical size are traces."""
LEAST_SHARE = 0.2
"""Least part of the excess chi2 - 1 that an effect has to remove to be added."""
HOPEFUL = 0.3
"""Rivals whose linear gain is at least this part of the best one's are refitted too."""
MOST_TRIALS = 5
MOST_EFFECTS = 6


@dataclass(frozen=True)
class Score:
    """What an effect would bring, by a linear estimate."""

    candidate: Candidate
    gain: float
    """Fall of chi2."""
    coordinates: Array


@dataclass(frozen=True)
class LinearView:
    """What every effect of the library would do to a fit, to first order.

    Attributes
    ----------
    absent : tuple of Candidate
        Effects that are not in the model.
    columns : tuple of (Active, str)
        The model's free parameters, then the amplitudes of the absent effects.
    normal, right : array
        Normal matrix and gradient of the columns, R_s and the map following.
    """

    fit: Fit
    absent: tuple[Candidate, ...]
    columns: tuple[tuple[Active, str], ...]
    normal: Array
    right: Array


@dataclass(frozen=True)
class Step:
    """One rung of the ladder: what was added, the model refitted with it, and what it brought."""

    added: str | None
    fit: Fit
    log_evidence: float = 0.0


@dataclass
class Search:
    """Where the search ended, and how it came there."""

    steps: list[Step]
    traces: list[str] = field(default_factory=list)
    rivals: dict[str, list[str]] = field(default_factory=dict)
    """Effects that do as well as an accepted one in its place."""
    view: LinearView | None = None
    """Of the last fit."""

    @property
    def fit(self) -> Fit:
        return self.steps[-1].fit


def log_evidence(fit: Fit, inflation: float) -> float:
    """Laplace's approximation to the log evidence of a fit, up to a constant of the recording."""
    count = len(fit.model.free)
    priors = sum(a.coordinate(n) ** 2 for a, n in fit.model.free)
    value = -0.5 * (fit.chi2 / inflation + fit.log_det + priors)
    if count:
        own = fit.projected()[0][:count, :count]
        value -= 0.5 * float(np.linalg.slogdet(np.eye(count) + own / inflation)[1])
    return value


def linear_view(fitter: Fitter, fit: Fit, candidates: Sequence[Candidate]) -> LinearView:
    """All effects that are not in the model beside those that are, to first order."""
    absent = tuple(c for c in candidates if c.name not in fit.model.names)
    columns = absent_columns(absent)
    normal, right = fitter.evaluate(fit.model, fit.frame, columns).projected()
    return LinearView(fit, absent, (*fit.model.free, *columns), normal, right)


def score(view: LinearView) -> list[Score]:
    """Linear scores of effects that are not in the model, best first; those that are follow, as the map does."""
    kept = len(view.fit.model.free)
    normal, right = view.normal[kept:, kept:], view.right[kept:]
    if kept:
        inner = view.normal[:kept, :kept] + np.eye(kept)
        follow = np.linalg.solve(inner, view.normal[:kept, kept:])
        right = right - follow.T @ view.right[:kept]
        normal = normal - view.normal[kept:, :kept] @ follow
    scores = []
    for candidate in view.absent:
        index = [k for k, (a, _) in enumerate(view.columns[kept:]) if a.name == candidate.name]
        block = normal[np.ix_(index, index)] + np.eye(len(index))
        x = np.asarray(-np.linalg.solve(block, right[index]), dtype=np.float64)
        scores.append(Score(candidate, float(-right[index] @ x), x))
    return sorted(scores, key=lambda s: -s.gain)


def forward(
    fitter: Fitter,
    steps: Sequence[Step],
    candidates: Sequence[Candidate],
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Search:
    """Add effects to the last of the steps until the data ask for no more."""
    search = Search(list(steps))
    rejected: set[str] = set()
    while len(search.fit.model.active) < MOST_EFFECTS:
        fit = search.fit
        search.view = linear_view(fitter, fit, candidates)
        scores = [s for s in score(search.view) if s.candidate.name not in rejected]
        hopeful = _worth_trying(scores, fit)
        if not hopeful:
            search.traces += _faint(scores, fit)
            break
        trials = [(s.candidate.name, _refit(fitter, fit, s)) for s in hopeful]
        inflation = max(1.0, min(t.chi2_per_dof for _, t in trials))
        before = log_evidence(fit, inflation)
        ranked = sorted(((log_evidence(t, inflation) - before, n, t) for n, t in trials), key=lambda item: -item[0])
        gain, name, trial = ranked[0]
        tell(str([(n, round(g, 1), round(t.chi2_per_dof, 3)) for g, n, t in ranked]))
        if gain < LOG_EVIDENCE:
            break
        if _size(trial, name) < LEAST_SIZE or _share(fit, trial) < LEAST_SHARE:
            rejected.update(n for g, n, _ in ranked if g > LOG_EVIDENCE)
            search.traces.append(name)
            continue
        search.rivals[name] = [n for g, n, _ in ranked[1:] if gain - g < TIE]
        search.steps.append(Step(name, polished(fitter, trial, inflation), gain))
        rejected.clear()
    search.traces = [n for n in dict.fromkeys(search.traces) if n not in search.fit.model.names]
    return search


def _worth_trying(scores: Sequence[Score], fit: Fit) -> list[Score]:
    """The best few by linear gain, with the declared twins of the best; none where even the best explains little."""
    if not scores:
        return []
    best = scores[0]
    least = 2.0 * LOG_EVIDENCE * max(1.0, (fit.chi2 - best.gain) / fit.dof)
    # A refit with the shape free does better than the linear estimate, but not without limit.
    if best.gain < least or best.gain < 0.5 * LEAST_SHARE * (fit.chi2 - fit.dof):
        return []
    twins = best.candidate.effect.twins
    return [s for s in scores if s.gain > least and (s.gain > HOPEFUL * best.gain or s.candidate.name in twins)][
        :MOST_TRIALS
    ]


def _faint(scores: Sequence[Score], fit: Fit) -> list[str]:
    """Effects whose linear gain is beyond chance, though they explain little of what is left."""
    least = 2.0 * LOG_EVIDENCE * max(1.0, fit.chi2_per_dof)
    return [s.candidate.name for s in scores[:3] if s.gain > least]


def _size(fit: Fit, name: str) -> float:
    return next(a.relative_size for a in fit.model.active if a.name == name)


def _share(before: Fit, after: Fit) -> float:
    """Part of the excess chi2 that is gone."""
    # A noise estimated a little too large puts the floor below one.
    floor = min(1.0, after.chi2_per_dof)
    excess = before.chi2_per_dof - floor
    return (before.chi2_per_dof - after.chi2_per_dof) / excess if excess > 0.0 else 0.0


def with_effect(fitter: Fitter, fit: Fit, candidate: Candidate) -> Fit:
    """The model refitted with one named effect, in its flexible form where that pays."""
    scored = score(linear_view(fitter, fit, [candidate]))[0]
    return polished(fitter, _refit(fitter, fit, scored), 1.0)


def _refit(fitter: Fitter, fit: Fit, scored: Score) -> Fit:
    """The model with one more effect, amplitudes started at the linear estimate, shapes free."""
    active = scored.candidate.absent()
    for name, x in zip(scored.candidate.amplitudes, scored.coordinates, strict=True):
        active = active.moved(name, float(x))
    active = active.freeing(*scored.candidate.of_role(ParameterRole.SHAPE))
    return fitter.fit(fit.model.with_active([*fit.model.active, active]), fit.frame, steps=4, renewals=0)


def polished(fitter: Fitter, fit: Fit, inflation: float) -> Fit:
    """The newest effect's flexible form where the evidence asks for it, fitted to the end."""
    newest = fit.model.active[-1]
    names = newest.candidate.of_role(ParameterRole.REFINEMENT)
    if names:
        flexible: Active = newest.freeing(*names)
        trial = fitter.fit(fit.model.with_active([*fit.model.active[:-1], flexible]), fit.frame, renewals=1)
        inflation = max(1.0, min(inflation, trial.chi2_per_dof))
        if log_evidence(trial, inflation) > log_evidence(fit, inflation) + TIE:
            return trial
    return fitter.fit(fit.model, fit.frame, renewals=1)
