"""Computation budget of a diagnosis, and an upper bound of its remaining time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median


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
        """Set the time per unit of cost to the median over the evaluations so far.

        The median is robust against the first evaluations of a process, which are slow.
        """
        ends = [begin for begin, _ in self._calls[1:]] or [self.clock()]
        costs = [(end - begin) / cost for (begin, cost), end in zip(self._calls, ends, strict=False)]
        self._cost_s = median(costs) if costs else None
        self._calls.clear()

    def expect(self, cost: float) -> None:
        """Set the expected remaining cost of the diagnosis."""
        if self._cost_s is not None:
            self._ends_s = self.clock() + self._cost_s * cost

    @property
    def remaining_time(self) -> str:
        """Text with the remaining time; empty where it is unknown or over."""
        left_s = self._ends_s - self.clock()
        step = 1 if left_s < 10.0 else 5
        return f" (some {step * round(left_s / step)} s more)" if left_s >= 1.0 else ""
