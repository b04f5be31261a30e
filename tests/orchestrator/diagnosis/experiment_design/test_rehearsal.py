"""A rehearsed plan obeys the voltage equation, and stands for the whole of what would be captured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.experiment_design.rehearsal import Machine, current_of, rehearse
from orchestrator.diagnosis.weak_form.magnetics import linear_magnetics
from orchestrator.numerics.tensor_spline import EvenSpline
from protocols import Injection, ProcedureError, SegmentStage, Trapezoid
from tests.orchestrator.diagnosis.experiment_design.plans import (
    DRIVE,
    GATES_OFF,
    HOLDS,
    NOISE_A,
    RIPPLE,
    SWEEPS,
    machine,
    plan,
)


def test_rehearsed_signals_fulfil_the_voltage_equation_in_every_stage() -> None:
    rehearsal = rehearse(plan(GATES_OFF, HOLDS, SWEEPS, RIPPLE), DRIVE, machine(), NOISE_A)
    fitter = rehearsal.setup.fitter
    fit = fitter.evaluate(rehearsal.model, fitter.frame(rehearsal.model))
    assert fit.chi2_per_dof < 1e-3
    assert fit.model.r_s == pytest.approx(4.25, rel=1e-4)


def test_pieces_stand_for_all_that_would_be_captured() -> None:
    longer = {**RIPPLE, "duration_s": 4.0}
    rehearsal = rehearse(plan(HOLDS, longer), DRIVE, machine(), NOISE_A)
    stood_for: dict[SegmentStage, float] = {}
    for piece, weight in zip(rehearsal.setup.prepared.pieces, rehearsal.weights, strict=True):
        seconds = len(piece.signals.v_dc) / piece.signals.sampling_frequency_hz
        stood_for[piece.stage] = stood_for.get(piece.stage, 0.0) + weight * seconds
    assert stood_for[SegmentStage.INJECTION] == pytest.approx(6 * 4.0)
    assert stood_for[SegmentStage.RESISTANCE] == pytest.approx(8 * 0.5)


@pytest.mark.parametrize("waveform", ["square", "sine"])
def test_a_ripple_has_the_voltage_that_was_asked_for(waveform: str) -> None:
    asked = Injection.model_validate(
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
    current = current_of(asked, on_paper, np.arange(50_001) / fs)
    volts = np.hypot(*on_paper.voltage(current, fs).T)
    assert current.mean(axis=0) == pytest.approx([1.0, -0.5], abs=1e-3)
    assert np.quantile(volts, 0.95) == pytest.approx(40.0, rel=0.02)
    rms = 40.0 if waveform == "square" else 40.0 / np.sqrt(2.0)
    assert np.sqrt(np.mean(volts**2)) == pytest.approx(rms, rel=0.02)


def test_a_trapezoid_is_at_its_amplitude_half_of_the_time() -> None:
    asked = Trapezoid(swept_axis="dq", amplitude_a=3.0, period_s=2.0, periods=1, settle_s=0.0)
    current = current_of(asked, machine(), np.arange(20_000) / 1e4)
    length = np.hypot(*current.T)
    assert length.max() == pytest.approx(3.0)
    assert np.mean(length > 2.999) == pytest.approx(0.5, abs=1e-3)
    assert current[5000] == pytest.approx(-current[15000])


def test_a_saturated_machine_is_rehearsed_on_its_own_map() -> None:
    grid = EvenSpline(-4.0, 4.0, 4.0, (4, 4))
    other = replace(machine(), magnetics=linear_magnetics(grid, 0.03, 0.05))
    model = rehearse(plan(HOLDS, SWEEPS, RIPPLE), DRIVE, other, NOISE_A).model
    inductance = model.magnetics.flux_and_inductance(np.zeros((1, 2)))[1][0]
    assert inductance == pytest.approx([0.03, 0.0, 0.05], rel=0.02, abs=1e-4)


def test_a_nameplate_that_lacks_a_resistance_is_named() -> None:
    with pytest.raises(ProcedureError, match=r"motor\.stator_resistance_ohm"):
        Machine.of(machine().motor.model_copy(update={"stator_resistance_ohm": None}), "mine")
