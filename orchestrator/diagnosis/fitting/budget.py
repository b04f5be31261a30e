"""How much a diagnosis has computed, and how long it may go on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median


@dataclass
class Budget:
    """How much was computed, in samples times columns: the same on every machine, unlike time.

    How long it may take still is what such work usually comes to, in the time that the first model's fit took for its
    own.
    """

    limit: float = math.inf
    spent: float = 0.0
    clock: Callable[[], float] = time.monotonic
    """Seconds, of any origin; for the words of who waits alone."""
    _calls: list[tuple[float, float]] = field(init=False, default_factory=list)
    """Time [s] and effort of each evaluation until `calibrate`."""
    _cost_s: float | None = field(init=False, default=None)
    """Of a unit of effort."""
    _ends_s: float = field(init=False, default=-math.inf)

    @property
    def is_spent(self) -> bool:
        return self.spent > self.limit

    def spend(self, cost: float) -> None:
        """An evaluation of so much effort begins."""
        self.spent += cost
        if self._cost_s is None and cost > 0.0:
            self._calls.append((self.clock(), cost))

    def calibrate(self) -> None:
        """Take what has been computed so far for what effort costs on this machine: the median of the evaluations.

        The first ones of a process take longer than all others.
        """
        ends = [begin for begin, _ in self._calls[1:]]
        costs = [(end - begin) / cost for (begin, cost), end in zip(self._calls, ends, strict=False)]
        self._cost_s = median(costs) if costs else None
        self._calls.clear()

    def expect(self, cost: float) -> None:
        """From here on so much of the calibrating work's kind is left to the diagnosis' end."""
        if self._cost_s is not None:
            self._ends_s = self.clock() + self._cost_s * cost

    @property
    def left(self) -> str:
        """Words for how long it may take still; none where that is not known, or over."""
        left_s = self._ends_s - self.clock()
        step = 1 if left_s < 10.0 else 5
        return f" (some {step * round(left_s / step)} s more)" if left_s >= 1.0 else ""
