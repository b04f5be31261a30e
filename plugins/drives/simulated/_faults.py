"""Failures on request: when they are due, and what a block of wrong data looks like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plugins.drives.simulated.options import Fault
from protocols import Capture


class FaultPlan:
    """Which of the configured faults are still to come."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        self.fired: set[int] = set()

    def due(self, number: int, start_s: float, sampling_frequency_hz: float, samples: int) -> dict[int, int]:
        """Indices of the faults within an excitation, by the sample (settling included) before which they strike."""
        moments: dict[int, int] = {}
        for index, fault in enumerate(self.faults):
            if index in self.fired:
                continue
            if fault.at_excitation is not None:
                after_s = fault.after_s if fault.at_excitation == number else -1.0
            else:
                after_s = (fault.at_s or 0.0) - start_s
                after_s = max(0.0, after_s)
            sample = round(after_s * sampling_frequency_hz)
            if after_s >= 0 and sample <= samples:
                while sample in moments:
                    sample += 1
                moments[sample] = index
        return moments

    def strike(self, index: int) -> Fault:
        """The fault that happens now; it happens once."""
        self.fired.add(index)
        return self.faults[index]


def corrupted(capture: Capture, fault: Fault) -> Capture:
    """What a faulty link would hand over instead of a block."""
    fields = {name: getattr(capture, name) for name in type(capture).model_fields}
    i = capture.i_ab.copy()
    match fault.data:
        case "nan":
            i[len(i) // 2] = np.nan
        case "huge":
            i[len(i) // 2] = 1e30
        case "shape":
            i = i[: len(i) // 2]
        case "gap":
            fields["start_s"] = capture.start_s + 0.25
    fields["i_ab"] = i
    return Capture.model_construct(**fields)  # past the model's own checks: that is the point
