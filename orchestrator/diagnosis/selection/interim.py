"""Interim results of a search: a sentence for the user, and a checkpoint for a report that ends the search early.

The recorder only receives; it does not influence the search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.verdict import fitted_verdict
from orchestrator.diagnosis.selection.scoring import log_bayes_factors, redundant_terms
from orchestrator.diagnosis.selection.search_state import AcceptedModel, SearchState
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
