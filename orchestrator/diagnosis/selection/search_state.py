"""State and result of a search, and how a model is fitted from one that is like it."""

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
from orchestrator.diagnosis.selection.scoring import LinearView, log_evidence
from protocols import SearchMeasure, SearchMove

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
    """Linear view of the last fit; None where it is not known."""
    below_materiality: tuple[str, ...] = ()
    """Effects of the last fit that are too small to be causes."""
    contributions: Mapping[str, Contribution] = field(default_factory=dict)
    """Contribution of each effect of a joint model; empty where effects were added one by one."""

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
