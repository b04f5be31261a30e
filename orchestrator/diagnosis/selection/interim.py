"""What a search has found so far: its answer in a sentence, and the report's search where nobody waits for its end.

Nothing here decides what a finished search finds: a search tells the recorder where it stands, and asks it nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.verdict import fitted_verdict
from orchestrator.diagnosis.selection.forward_search import Search, Step
from orchestrator.diagnosis.selection.joint_search import log_bayes_factors, redundant_terms
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from protocols import Verdict

MAX_NAMES = 5
"""Effects that a sentence names."""


@dataclass(frozen=True)
class InterimResult:
    """What a search has found so far.

    Attributes
    ----------
    effects : tuple of str
        That the model has and the data ask for, in the order in which they were found.
    verdict : str
        By the fitted stages alone: ``clean``, ``explained``, ``mostly_explained`` or ``unknown_remains``.
    chi2 : float
        Per degree of freedom.
    is_part : bool
        Whether a part of the recording was fitted.
    fitted_together : int
        Effects of a joint fit, of which `effects` are those that the data ask for clearly; 0 in a search one by one.
    """

    effects: tuple[str, ...]
    verdict: Verdict
    chi2: float
    is_part: bool
    fitted_together: int = 0

    @property
    def sentence(self) -> str:
        """The same in plain English, on one line."""
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
    """Where a search stands at the end of a step.

    Attributes
    ----------
    setup : DiagnosisSetup
        With what is taken for noise then.
    first : sequence of Step
        The ladder's first rungs, fitted to the whole recording.
    search : Search
        Its fits are of a part of the recording where `is_part`.
    is_part : bool
    is_joint : bool
        Whether effects were fitted together: then the last fit has all of them, and the ladder is not made yet.
    """

    setup: DiagnosisSetup
    first: tuple[Step, ...]
    search: Search
    is_part: bool
    is_joint: bool


@dataclass
class InterimRecorder:
    """Remembers where a search stands, and tells each answer that differs from the one before.

    Parameters
    ----------
    tell : callable
        Called with an `InterimResult` when the effects, the verdict, or what was fitted have changed.
    """

    tell: Callable[[InterimResult], None] = lambda _: None
    checkpoint: Checkpoint | None = None
    _last_answer: tuple[object, ...] = field(default=(), init=False)

    def record(
        self, setup: DiagnosisSetup, first: Sequence[Step], search: Search, *, is_part: bool, is_joint: bool = False
    ) -> None:
        """A step of the search has ended here."""
        # The search goes on with the same lists.
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
        first: Sequence[Step],
        fits: tuple[Fit, Fit],
        quick: Search,
        indistinguishable: Mapping[str, Sequence[str]],
        *,
        is_part: bool,
    ) -> None:
        """The same where effects are fitted together: `fits` without any of them, and with them."""
        before, fit = fits
        tied = {name: list(others) for name, others in indistinguishable.items()}
        search = Search([Step(None, before), Step(None, fit)], quick.detected_not_named, tied)
        self.record(setup, first, search, is_part=is_part, is_joint=True)


def _causes(search: Search) -> tuple[str, ...]:
    return tuple(name for name in search.fit.model.names if name not in search.below_materiality)


def _clear_effects(fit: Fit) -> tuple[str, ...]:
    """Effects of a joint fit whose evidence exceeds half of what is left, the clearest first."""
    factors, spare = log_bayes_factors(fit), set(redundant_terms(fit))
    rest = 0.5 * max(fit.chi2 - fit.dof, 0.0)
    clear = [name for name in fit.model.names if name not in spare and factors[name] > rest]
    return tuple(sorted(clear, key=lambda name: -factors[name]))
