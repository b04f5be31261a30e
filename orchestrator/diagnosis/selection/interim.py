"""Interim results of a search: a sentence for the user, and a checkpoint for a report that ends the search early.

The recorder only receives; it does not influence the search.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.verdict import fitted_verdict
from orchestrator.diagnosis.selection.forward_search import AcceptedModel, SearchResult
from orchestrator.diagnosis.selection.joint_search import log_bayes_factors, redundant_terms
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from protocols import Verdict

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
    """State of a search after an accepted or rejected effect.

    Attributes
    ----------
    setup : DiagnosisSetup
        The setup with its current noise.
    first : sequence of AcceptedModel
        First steps of the ladder, fitted to the whole recording.
    search : SearchResult
        Fits to a part of the recording where `is_part`.
    is_part : bool
    is_joint : bool
        Whether effects were fitted together: the last fit then has all of them, and there is no ladder yet.
    """

    setup: DiagnosisSetup
    first: tuple[AcceptedModel, ...]
    search: SearchResult
    is_part: bool
    is_joint: bool


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

    def record(
        self,
        setup: DiagnosisSetup,
        first: Sequence[AcceptedModel],
        search: SearchResult,
        *,
        is_part: bool,
        is_joint: bool = False,
    ) -> None:
        """Record the state of the search."""
        # Copies, as the search continues with the same lists.
        snapshot = replace(
            search,
            steps=list(search.steps),
            detected_not_named=list(search.detected_not_named),
            indistinguishable=dict(search.indistinguishable),
        )
        self.checkpoint = Checkpoint(setup, tuple(first), snapshot, is_part, is_joint)
        before, fit = search.steps[0].fit, search.fit
        names = _clear_effects(fit) if is_joint else _causes(search)
        together = len(fit.model.names) if is_joint else 0
        result = InterimResult(names, fitted_verdict(before, fit), fit.chi2_per_dof, is_part, together)
        answer = (set(names), result.verdict, is_part)
        if answer != self._last_answer:
            self._last_answer = answer
            self.tell(result)

    def record_joint(
        self,
        setup: DiagnosisSetup,
        first: Sequence[AcceptedModel],
        fits: tuple[Fit, Fit],
        quick: SearchResult,
        indistinguishable: Mapping[str, Sequence[str]],
        *,
        is_part: bool,
    ) -> None:
        """Record the state of a joint search: `fits` without any effect, and with all of them."""
        before, fit = fits
        tied = {name: list(others) for name, others in indistinguishable.items()}
        search = SearchResult([AcceptedModel(None, before), AcceptedModel(None, fit)], quick.detected_not_named, tied)
        self.record(setup, first, search, is_part=is_part, is_joint=True)


def _causes(search: SearchResult) -> tuple[str, ...]:
    return tuple(name for name in search.fit.model.names if name not in search.below_materiality)


def _clear_effects(fit: Fit) -> tuple[str, ...]:
    """Effects of a joint fit whose log evidence exceeds half of the excess chi2, the largest first."""
    factors, spare = log_bayes_factors(fit), set(redundant_terms(fit))
    rest = 0.5 * max(fit.chi2 - fit.dof, 0.0)
    clear = [name for name in fit.model.names if name not in spare and factors[name] > rest]
    return tuple(sorted(clear, key=lambda name: -factors[name]))
