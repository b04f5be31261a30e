"""How much a diagnosis has computed, and how long it may go on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Effort:
    """How much was computed, in samples times columns: the same on every machine, unlike time."""

    most: float = math.inf
    spent: float = 0.0
    clock: Callable[[], float] = time.monotonic
    """Seconds, of any origin; for the words of who waits alone."""
    _begun_s: float = field(init=False)
    _ends_s: float = field(init=False, default=-math.inf)

    def __post_init__(self) -> None:
        self._begun_s = self.clock()

    @property
    def exhausted(self) -> bool:
        return self.spent > self.most

    def reached(self, part: float) -> None:
        """So much of the whole is done: what is left takes as long in proportion."""
        now = self.clock()
        self._ends_s = now + (now - self._begun_s) * (1.0 - part) / part

    @property
    def left(self) -> str:
        """Words for how long it may take still; none where that is not known, or over."""
        left_s = self._ends_s - self.clock()
        step = 1 if left_s < 10.0 else 5
        return f" (some {step * round(left_s / step)} s more)" if left_s >= 1.0 else ""
