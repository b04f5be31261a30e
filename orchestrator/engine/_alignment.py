"""Do a run's rows belong together? Judged where it shows first: in the square ripple of the first injections.

A voltage that stands in another row than the drive says is refused, not put right (decision 31): by it every flux of
the run would be wrong, and it is the drive's own number to say. Delays of a part of a row are left to the diagnosis.
"""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.alignment import Numbers, alignment_of
from protocols import Capabilities, Capture, DriveFault, Excitation, FaultCause, Injection

APART_ROWS = 0.75
"""Inverters and sensors are late by up to half a row; who writes into another row is off by a whole one."""
SURE = 0.8
"""Share of the current's steps that has to be explained for an answer that ends a run."""
ROWS = 8_000


class AlignmentCheck:
    """Hears the blocks of a run's injections until one of them has told."""

    def __init__(self, capabilities: Capabilities) -> None:
        self._said = capabilities.voltage_delay_samples
        self._is_told = False
        self._i: list[Numbers] = []
        self._v: list[Numbers] = []

    def begin(self) -> None:
        """A point begins."""
        self._i, self._v = [], []

    def hear(self, excitation: Excitation, capture: Capture) -> None:
        """A block of it, kept by reference."""
        is_square = isinstance(excitation, Injection) and excitation.waveform == "square"
        if is_square and not self._is_told and sum(map(len, self._i)) < ROWS:
            self._i.append(capture.i_ab)
            self._v.append(capture.v_ab)

    def conclude(self, segment: str) -> None:
        """Raise `DriveFault` (wrong_data) where the voltage of another row makes the current."""
        if not self._i:
            return
        found = alignment_of(np.concatenate(self._i), np.concatenate(self._v), max_samples=ROWS)
        self.begin()
        if found is None or found.explained < SURE:
            return
        self._is_told = True
        if abs(found.lag_rows - self._said) > APART_ROWS:
            raise DriveFault(
                FaultCause.WRONG_DATA,
                f"{segment}: the current follows the voltage of row k from t_k + {found.lag_rows:.1f} Ts on, the drive "
                f"says voltage_delay_samples {self._said:g}: its rows are not of one instant, and every flux would be "
                "wrong; put it right in the drive (its conformance kit shows the same)",
            )
