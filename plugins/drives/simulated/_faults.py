"""Injected faults: their instants, and corrupted data blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plugins.drives.simulated.options import Fault
from protocols import Capture


class FaultPlan:
    """The configured faults, each of which occurs once."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self.faults = tuple(faults)
        self.fired: set[int] = set()

    def due(self, number: int, start_s: float, sampling_frequency_hz: float, samples: int) -> dict[int, int]:
        """Sample (settling included) before which each fault within an excitation occurs, by the fault's index."""
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
        """The fault of this index, marked as having occurred."""
        self.fired.add(index)
        return self.faults[index]


def corrupted(capture: Capture, fault: Fault) -> Capture:
    """A block as a faulty link would deliver it."""
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
    return Capture.model_construct(**fields)  # bypasses the model's checks on purpose
