"""How much a diagnosis has computed, and how long it may go on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Effort:
    """How much was computed, in samples times columns: the same on every machine, unlike time.

    How long it may take still is what such work usually comes to, in the time that the first model's fit took for its
    own.
    """

    most: float = math.inf
    spent: float = 0.0
    clock: Callable[[], float] = time.monotonic
    """Seconds, of any origin; for the words of who waits alone."""
    _begun: tuple[float, float] = field(init=False)
    """Time [s] and effort at which the measurement of its cost began."""
    _cost_s: float | None = field(init=False, default=None)
    """Of a unit of effort."""
    _ends_s: float = field(init=False, default=-math.inf)

    def __post_init__(self) -> None:
        self.start()

    @property
    def exhausted(self) -> bool:
        return self.spent > self.most

    def start(self) -> None:
        """What is computed from here to `calibrate` tells what effort costs on this machine."""
        self._begun = self.clock(), self.spent

    def calibrate(self) -> None:
        """Take the time since `start` for what was computed since then."""
        begun_s, spent = self._begun
        if self.spent > spent:
            self._cost_s = (self.clock() - begun_s) / (self.spent - spent)

    def expect(self, effort: float) -> None:
        """From here on so much of the calibrating work's kind is left to the diagnosis' end."""
        if self._cost_s is not None:
            self._ends_s = self.clock() + self._cost_s * effort

    @property
    def left(self) -> str:
        """Words for how long it may take still; none where that is not known, or over."""
        left_s = self._ends_s - self.clock()
        step = 1 if left_s < 10.0 else 5
        return f" (some {step * round(left_s / step)} s more)" if left_s >= 1.0 else ""
