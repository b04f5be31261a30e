"""The machine on paper: the currents of an excitation, and the voltages that they take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.experiment_design.machine import Machine, current_of
from protocols import Injection, ProcedureError, Trapezoid
from tests.orchestrator.experiment_design.plans import machine


@pytest.mark.parametrize("waveform", ["square", "sine"])
def test_a_ripple_has_the_voltage_that_was_requested(waveform: str) -> None:
    excitation = Injection.model_validate(
        {
            "target_d_a": 1.0,
            "target_q_a": -0.5,
            "settle_s": 0.1,
            "duration_s": 1.0,
            "amplitude_v": 40.0,
            "frequency_hz": 500.0,
            "rotation_hz": 2.0,
            "waveform": waveform,
        }
    )
    fs, on_paper = 1e5, replace(machine(), r_s=1e-9)
    current = current_of(excitation, on_paper, np.arange(50_001) / fs)
    volts = np.hypot(*on_paper.voltage(current, fs).T)
    assert current.mean(axis=0) == pytest.approx([1.0, -0.5], abs=1e-3)
    assert np.quantile(volts, 0.95) == pytest.approx(40.0, rel=0.02)
    rms = 40.0 if waveform == "square" else 40.0 / np.sqrt(2.0)
    assert np.sqrt(np.mean(volts**2)) == pytest.approx(rms, rel=0.02)


def test_a_trapezoid_is_at_its_amplitude_half_of_the_time() -> None:
    excitation = Trapezoid(swept_axis="dq", amplitude_a=3.0, period_s=2.0, periods=1, settle_s=0.0)
    current = current_of(excitation, machine(), np.arange(20_000) / 1e4)
    length = np.hypot(*current.T)
    assert length.max() == pytest.approx(3.0)
    assert np.mean(length > 2.999) == pytest.approx(0.5, abs=1e-3)
    assert current[5000] == pytest.approx(-current[15000])


def test_a_nameplate_that_lacks_a_resistance_is_named() -> None:
    with pytest.raises(ProcedureError, match=r"motor\.stator_resistance_ohm"):
        Machine.of(machine().motor.model_copy(update={"stator_resistance_ohm": None}), "mine")
