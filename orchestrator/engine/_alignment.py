"""Checks that current and voltage rows are aligned, by the square ripple of the first injections.

A voltage in another row than the drive states is refused, not corrected (decision 3): every flux of the run would be
wrong, and the number is the drive's to state. The diagnosis estimates delays of a fraction of a row.
"""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.alignment import Numbers, alignment_of
from protocols import Capabilities, Capture, DriveFault, Excitation, FaultCause, Injection

MAX_LAG_ERROR_ROWS = 0.75
"""Tolerance: inverters and sensors delay by up to half a row, a shifted row is a whole one."""
MIN_EXPLAINED_RATIO = 0.8
"""Minimum explained share of the current's steps for a conclusive check."""
CHECKED_ROWS = 8_000


class AlignmentCheck:
    """Checks the injections of a run until one is conclusive."""

    def __init__(self, capabilities: Capabilities) -> None:
        self._lag_rows = capabilities.voltage_delay_samples
        self._is_decided = False
        self._i: list[Numbers] = []
        self._v: list[Numbers] = []

    def begin(self) -> None:
        """Start a point."""
        self._i, self._v = [], []

    def update(self, excitation: Excitation, capture: Capture) -> None:
        """Add a block of the point, by reference."""
        is_square = isinstance(excitation, Injection) and excitation.waveform == "square"
        if is_square and not self._is_decided and sum(map(len, self._i)) < CHECKED_ROWS:
            self._i.append(capture.i_ab)
            self._v.append(capture.v_ab)

    def conclude(self, segment: str) -> None:
        """Raise `DriveFault` (wrong_data) where the current follows the voltage of another row."""
        if not self._i:
            return
        fit = alignment_of(np.concatenate(self._i), np.concatenate(self._v), max_samples=CHECKED_ROWS)
        self.begin()
        if fit is None or fit.explained < MIN_EXPLAINED_RATIO:
            return
        self._is_decided = True
        if abs(fit.lag_rows - self._lag_rows) > MAX_LAG_ERROR_ROWS:
            raise DriveFault(
                FaultCause.WRONG_DATA,
                f"{segment}: the current follows the voltage of row k from t_k + {fit.lag_rows:.1f} Ts on, the drive "
                f"says voltage_delay_samples {self._lag_rows:g}: its rows are not simultaneous, and every flux would "
                "be wrong; correct it in the drive (its conformance kit shows the same)",
            )
