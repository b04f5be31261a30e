"""State of a search, its interim and final results, and how a model is fitted from one that is like it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from orchestrator.diagnosis.criteria import SelectionCriteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import MAP_RUNGS
from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.judgement.contributions import Contribution
from orchestrator.diagnosis.judgement.verdict import fitted_verdict
from orchestrator.diagnosis.selection.scoring import LinearView, log_bayes_factors, log_evidence, redundant_terms
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from protocols import SearchMeasure, SearchMove, Verdict

MAX_JOINT_ROUNDS: int = 6
"""Relinearisations of a joint model, which the next move continues."""
MAX_SHAPE_ROUNDS: int = 15
"""Relinearisations of a joint model whose shapes have been freed."""
JOINT_TOLERANCE: float = 1e-2
"""Gain of a round of a joint fit, as a part of the excess chi2, below which it ends."""


@dataclass(frozen=True)
class SearchState:
    """One model of a search: effects, free shapes, form and grid are the fit's, nuisances the setup's.

    Attributes
    ----------
    setup : DiagnosisSetup
    fit : Fit
    first_chi2 : float
        chi2 per degree of freedom of the first model.
    is_part : bool
        Whether a part of the recording is fitted.
    is_joint : bool
        Whether all effects of the library were in the model.
    indistinguishable : mapping
        For an effect of the model, those that fit as well in its place.
    gains : mapping
        For an effect that was added alone, the gain in log evidence by which it was [nat].
    refused : tuple of str
        Absent effects that the data show, but that are redundant or explain too little.
    late : frozenset of str
        Effects added to a joint model.
    needed : frozenset of str
        Effects whose removal was refused since the model last gained anything.
    view : LinearView, optional
        All absent effects to first order beside the fit.
    """

    setup: DiagnosisSetup
    fit: Fit
    first_chi2: float
    is_part: bool = True
    is_joint: bool = False
    indistinguishable: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)
    refused: tuple[str, ...] = ()
    late: frozenset[str] = frozenset()
    needed: frozenset[str] = frozenset()
    view: LinearView | None = None

    @property
    def fitter(self) -> Fitter:
        return self.setup.part_fitter if self.is_part else self.setup.fitter

    @property
    def limits(self) -> SelectionCriteria:
        return self.fit.criteria.selection

    @property
    def noise(self) -> float:
        """Variance of the residual relative to the known noise, at least one."""
        return max(self.fit.chi2_per_dof, 1.0)

    @property
    def is_explained(self) -> bool:
        return self.fit.chi2_per_dof <= self.limits.detected_chi2

    def minimum(self, model: Model, known: Fit | None = None, *, rounds: int = MAX_JOINT_ROUNDS) -> Fit:
        """A model fitted, from a fit of a similar one (this state's by default)."""
        known = self.fit if known is None else known
        if self.is_joint:
            return fit_with_frozen_jacobian(self.fitter, model, rounds=rounds, tolerance=JOINT_TOLERANCE, known=known)
        return self.fitter.fit(model, known.linearisation, steps=5, relinearisations=1, tolerance=1e-3)

    def record(
        self,
        move: SearchMove,
        effects: tuple[str, ...],
        after: Fit | None,
        score: float | None,
        threshold: float | None,
        *,
        measure: SearchMeasure = "log_evidence",
        taken: bool | None,
        note: str = "",
    ) -> None:
        """Record a move from this state in the trace."""
        self.fitter.trace.record(
            move,
            effects,
            before=self.fit,
            after=after,
            measure=None if score is None else measure,
            score=score,
            threshold=threshold,
            taken=taken,
            note=note,
        )

    def after(self, fit: Fit) -> SearchState:
        """The state with another fit."""
        return replace(self, fit=fit, view=None, needed=frozenset())


@dataclass(frozen=True)
class Move:
    """A change of a state that may be tried.

    Attributes
    ----------
    kind : str
    concerned : tuple of str
        Names of what it changes: effects, and parameters.
    make : callable
        The state after the move; None where it is not above its threshold.
    gain : float
        Predicted fall of chi2 to first order; zero where nothing predicts it.
    is_once : bool
        Whether the move is tried once in a part and once in the whole, however the model changes meanwhile.
    """

    kind: SearchMove
    concerned: tuple[str, ...]
    make: Callable[[], SearchState | None]
    gain: float = 0.0
    is_once: bool = False

    def key(self, state: SearchState) -> tuple[object, ...]:
        """What tells this trial from others."""
        key = self.kind, self.concerned, state.is_part, state.is_joint
        if self.is_once:
            return key
        free = tuple((a.name, n) for a, n in state.fit.model.free)
        return (*key, free, state.fit.model.space.grid, id(state.fitter.noise))


def first_accepted(state: SearchState, moves: Iterable[Move], tried: set[tuple[object, ...]]) -> SearchState | None:
    """The state after the first of some moves that is above its threshold; those `tried` are left out, and extended."""
    for move in moves:
        key = move.key(state)
        if key in tried:
            continue
        tried.add(key)
        if (after := move.make()) is not None:
            return after
    return None


def evidence_gain(trial: Fit, fit: Fit) -> float:
    """Gain in log evidence of one fit over another, with the noise inflated to the better one's residual."""
    inflation = max(1.0, min(fit.chi2_per_dof, trial.chi2_per_dof))
    return log_evidence(trial, inflation) - log_evidence(fit, inflation)


@dataclass(frozen=True)
class AcceptedModel:
    """One step of the ladder: the effect added, the model with it, and the effect's log evidence [nat]."""

    added: str | None
    fit: Fit
    log_evidence: float = 0.0


@dataclass
class SearchResult:
    """The ladder of models that a search has accepted, and its findings beside them."""

    steps: list[AcceptedModel]
    detected_not_named: list[str] = field(default_factory=list)
    indistinguishable: dict[str, list[str]] = field(default_factory=dict)
    """For an effect of the model, those that fit as well in its place."""
    view: LinearView | None = None
    """Linear view of the last fit, or of the one from which that converged; None where it is not known."""
    below_materiality: tuple[str, ...] = ()
    """Effects of the last fit that are too small to be causes."""
    contributions: Mapping[str, Contribution] = field(default_factory=dict)
    """Contribution of each effect of a joint model; empty where effects were added one by one."""
    doubtful: tuple[str, ...] = ()
    """Effects that are not separable from the remaining error."""
    needed: frozenset[str] = frozenset()
    """Effects of a joint model that explains the error, without which a refit was refused. No interval makes them
    absent: a linear model's is far too wide where a size and a form are confounded."""

    @property
    def fit(self) -> Fit:
        return self.steps[-1].fit


def baseline_models(steps: Sequence[AcceptedModel]) -> list[AcceptedModel]:
    """The models without any effect: the first, and those that only free the map."""
    return [step for step in steps if step.added is None or step.added in MAP_RUNGS]


def refit_steps(setup: DiagnosisSetup, steps: Sequence[AcceptedModel]) -> list[AcceptedModel]:
    """The models refitted with the setup's noise; as they are where they have it."""
    if all(step.fit.linearisation.noise is setup.fitter.noise for step in steps):
        return list(steps)
    return [replace(step, fit=setup.fitter.fit(step.fit.model)) for step in steps]


MAX_NAMES = 5
"""Maximum number of effects in the sentence."""


@dataclass(frozen=True)
class InterimResult:
    """Interim result of a search.

    Attributes
    ----------
    effects : tuple of str
        Effects in the model that the data require, in the order in which they were found.
    verdict : str
        From the fitted stages alone: ``clean``, ``explained``, ``mostly_explained`` or ``unknown_remains``.
    chi2 : float
        chi2 per degree of freedom.
    is_part : bool
        Whether only a part of the recording was fitted.
    fitted_together : int
        Effects of a joint fit, of which `effects` are those that the data clearly require; 0 in a search one by one.
    """

    effects: tuple[str, ...]
    verdict: Verdict
    chi2: float
    is_part: bool
    fitted_together: int = 0

    @property
    def sentence(self) -> str:
        """The result in plain English, on one line."""
        if self.fitted_together and not self.effects:
            return f"so far: {self.fitted_together} effects fitted together, none named yet (chi2 {number(self.chi2)})"
        first, more = self.effects[:MAX_NAMES], len(self.effects) - MAX_NAMES
        names = ", ".join(plain(name) for name in first) + (f" and {more} more" if more > 0 else "")
        data = "the part of the recording that was searched" if self.is_part else "the recording"
        meaning = {
            "clean": f"the model alone explains {data}",
            "explained": f"explains {data}",
            "mostly_explained": f"explains most of {data}",
        }.get(self.verdict, "something unknown remains")
        return f"so far: {names or 'no effect found'}; {meaning} (chi2 {number(self.chi2)})"


@dataclass(frozen=True)
class Checkpoint:
    """A search after an accepted move.

    Attributes
    ----------
    state : SearchState
    first : tuple of AcceptedModel
        First steps of the ladder, fitted to the whole recording.
    """

    state: SearchState
    first: tuple[AcceptedModel, ...]


@dataclass
class InterimRecorder:
    """Keeps the latest checkpoint, and reports each interim result that differs from the one before.

    Parameters
    ----------
    tell : callable
        Called with an `InterimResult` when the effects, the verdict, or what was fitted have changed.
    """

    tell: Callable[[InterimResult], None] = lambda _: None
    checkpoint: Checkpoint | None = None
    _last_answer: tuple[object, ...] = field(default=(), init=False)

    def record(self, state: SearchState, first: Sequence[AcceptedModel]) -> None:
        """Record the state of a search, whose first models are given."""
        self.checkpoint = Checkpoint(state, tuple(first))
        fit, joint = state.fit, state.is_joint
        names = _clear_effects(fit) if joint else fit.model.names
        verdict = fitted_verdict(first[0].fit, fit)
        result = InterimResult(names, verdict, fit.chi2_per_dof, state.is_part, len(fit.model.names) if joint else 0)
        answer = (set(names), result.verdict, state.is_part)
        if answer != self._last_answer:
            self._last_answer = answer
            self.tell(result)


def _clear_effects(fit: Fit) -> tuple[str, ...]:
    """Effects of a joint fit whose log evidence exceeds half of the excess chi2, the largest first.

    The causes of the answer (`naming.build_ladder`) need a refit for each effect, too much while the search goes on.
    """
    factors, spare = log_bayes_factors(fit), set(redundant_terms(fit))
    rest = 0.5 * max(fit.chi2 - fit.dof, 0.0)
    clear = [name for name in fit.model.names if name not in spare and factors[name] > rest]
    return tuple(sorted(clear, key=lambda name: -factors[name]))
