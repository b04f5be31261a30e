"""Do a run's rows belong together? Judged where it shows first: in the square ripple of the first injections.

A voltage that stands in another row than the drive says is refused, not put right (decision 3): by it every flux of
the run would be wrong, and it is the drive's own number to say. Delays of a part of a row are left to the diagnosis.
"""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.alignment import Numbers, alignment_of
from protocols import Capabilities, Capture, DriveFault, Excitation, FaultCause, Injection

MAX_LAG_ERROR_ROWS = 0.75
"""Inverters and sensors are late by up to half a row; a shifted row is off by a whole one."""
MIN_EXPLAINED_RATIO = 0.8
"""Explained share of the current's steps, below which the check decides nothing."""
CHECKED_ROWS = 8_000


class AlignmentCheck:
    """Checks the blocks of a run's injections until one of them decides."""

    def __init__(self, capabilities: Capabilities) -> None:
        self._lag_rows = capabilities.voltage_delay_samples
        self._is_decided = False
        self._i: list[Numbers] = []
        self._v: list[Numbers] = []

    def begin(self) -> None:
        """A point begins."""
        self._i, self._v = [], []

    def update(self, excitation: Excitation, capture: Capture) -> None:
        """A block of it, kept by reference."""
        is_square = isinstance(excitation, Injection) and excitation.waveform == "square"
        if is_square and not self._is_decided and sum(map(len, self._i)) < CHECKED_ROWS:
            self._i.append(capture.i_ab)
            self._v.append(capture.v_ab)

    def conclude(self, segment: str) -> None:
        """Raise `DriveFault` (wrong_data) where the voltage of another row makes the current."""
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
                f"says voltage_delay_samples {self._lag_rows:g}: its rows are not of one instant, and every flux would "
                "be wrong; correct it in the drive (its conformance kit shows the same)",
            )
