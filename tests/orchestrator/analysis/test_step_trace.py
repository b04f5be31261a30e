"""A capture of voltage steps, averaged down."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import trace_steps
from protocols import Capture


@pytest.mark.parametrize("resting", [0, 3000], ids=["steps alone", "mostly without voltage"])
def test_the_voltage_of_steps_is_theirs_however_long_nothing_is_commanded(resting: int) -> None:
    swing = np.repeat([24.0, -24.0] * 4, 50)
    v = np.concatenate([np.zeros(resting), swing])
    capture = Capture(
        start_s=0.0,
        sampling_frequency_hz=1e4,
        i_ab=np.column_stack([np.cumsum(v) * 2e-3, np.zeros_like(v)]),
        v_ab=np.column_stack([v, np.zeros_like(v)]),
        v_dc=np.full(len(v), 48.0),
    )
    trace = trace_steps(capture, 0.0, delay=0.0, knots_a=np.array([1.0]), where="x")
    assert trace.volts == pytest.approx(24.0)
