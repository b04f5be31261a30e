"""Progress of a diagnosis: its computation budget, its remaining time, and the record of its moves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import TYPE_CHECKING

from protocols import SearchDecision, SearchEvent, SearchMeasure, SearchMove

if TYPE_CHECKING:
    from orchestrator.diagnosis.fitting.model import Fit

MIN_CALIBRATING_EVALUATIONS: int = 5
"""Evaluations whose median time is robust against the slow first ones of a process."""


@dataclass
class Budget:
    """Cost of all evaluations in samples times columns, which is the same on every machine.

    The remaining time is the usual remaining cost, at the speed measured while the first model was fitted.
    """

    limit: float = math.inf
    spent: float = 0.0
    clock: Callable[[], float] = time.monotonic
    """Clock for the remaining time [s]; its origin is arbitrary."""
    _calls: list[tuple[float, float]] = field(init=False, default_factory=list)
    """Time [s] and cost of each evaluation before `calibrate`."""
    _cost_s: float | None = field(init=False, default=None)
    """Time per unit of cost [s]."""
    _is_calibrating: bool = field(init=False, default=False)
    """Whether the time per unit of cost is wanted, but too few evaluations have been made."""
    _ends_s: float = field(init=False, default=-math.inf)

    @property
    def is_spent(self) -> bool:
        return self.spent > self.limit

    def spend(self, cost: float) -> None:
        """Account for an evaluation that begins."""
        self.spent += cost
        if self._cost_s is None and cost > 0.0:
            self._calls.append((self.clock(), cost))

    def calibrate(self) -> None:
        """Set the time per unit of cost to the median over the evaluations so far, as soon as these are enough."""
        self._is_calibrating = len(self._calls) <= MIN_CALIBRATING_EVALUATIONS
        if self._is_calibrating:
            return
        ends = [begin for begin, _ in self._calls[1:]]
        self._cost_s = median((end - begin) / cost for (begin, cost), end in zip(self._calls, ends, strict=False))
        self._calls.clear()

    def expect(self, cost: float) -> None:
        """Set the expected remaining cost of the diagnosis."""
        if self._is_calibrating:
            self.calibrate()
        if self._cost_s is not None:
            self._ends_s = self.clock() + self._cost_s * cost

    @property
    def remaining_time(self) -> str:
        """Text with the remaining time; empty where it is unknown or over."""
        left_s = self._ends_s - self.clock()
        step = 1 if left_s < 10.0 else 5
        return f" (some {step * round(left_s / step)} s more)" if left_s >= 1.0 else ""


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
