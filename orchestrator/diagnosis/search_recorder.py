"""Record of a search's moves, for the report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from orchestrator.diagnosis.fitting.budget import Budget
from protocols import SearchDecision, SearchEvent, SearchMeasure, SearchMove

if TYPE_CHECKING:
    from orchestrator.diagnosis.fitting.model import Fit


@dataclass
class SearchRecorder:
    """The moves of one diagnosis, in order.

    Attributes
    ----------
    budget : Budget
        Computation budget of all fits of the diagnosis.
    samples : int
        Samples of the whole recording; the unit of `SearchEvent.evaluations`.
    is_part : bool
        Whether a part of the recording is fitted.
    events : list of SearchEvent
        The moves, shared by the recorders of the whole and of its part.
    """

    budget: Budget = field(default_factory=Budget)
    samples: int = 1
    is_part: bool = False
    events: list[SearchEvent] = field(default_factory=list)
    begun_s: float = field(default_factory=time.monotonic)

    def of_part(self) -> SearchRecorder:
        """A recorder for fits to a part of the recording, with the same list of events."""
        return replace(self, is_part=True)

    def record(
        self,
        move: SearchMove,
        effects: Sequence[str] = (),
        *,
        before: Fit | None = None,
        after: Fit | None = None,
        measure: SearchMeasure | None = None,
        score: float | None = None,
        threshold: float | None = None,
        taken: bool | None = None,
        note: str = "",
    ) -> None:
        """Record one move; `taken` is None for a move without a decision."""
        decision: SearchDecision = "tested" if taken is None else "accepted" if taken else "rejected"
        event = SearchEvent(
            step=len(self.events) + 1,
            move=move,
            effects=tuple(effects),
            data="part" if self.is_part else "whole",
            measure=measure,
            score=score,
            threshold=threshold,
            chi2_before=None if before is None else before.chi2_per_dof,
            chi2_after=None if after is None else after.chi2_per_dof,
            decision=decision,
            note=note,
            evaluations=self.budget.spent / self.samples,
            seconds=time.monotonic() - self.begun_s,
        )
        self.events.append(event)
