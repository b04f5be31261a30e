"""A rehearsed plan obeys the voltage equation, and stands for the whole of what would be captured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.magnetics import linear_magnetics
from orchestrator.experiment_design.rehearsal import machine_of, rehearse
from orchestrator.numerics.tensor_spline import EvenSpline
from protocols import FluxMap, PluginError, SegmentStage
from tests.orchestrator.experiment_design.plans import (
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
    fit = fitter.evaluate(rehearsal.model, fitter.linearise(rehearsal.model))
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


def test_a_saturated_machine_is_rehearsed_on_its_own_map() -> None:
    grid = EvenSpline(-4.0, 4.0, 4.0, (4, 4))
    other = replace(machine(), magnetics=linear_magnetics(grid, 0.03, 0.05))
    model = rehearse(plan(HOLDS, SWEEPS, RIPPLE), DRIVE, other, NOISE_A).model
    inductance = model.magnetics.flux_and_inductance(np.zeros((1, 2)))[1][0]
    assert inductance == pytest.approx([0.03, 0.0, 0.05], rel=0.02, abs=1e-4)


def test_a_known_map_stands_for_the_nameplate_s_inductances() -> None:
    i_d, i_q = np.linspace(-4.0, 4.0, 9), np.linspace(-4.0, 4.0, 11)
    d, q = np.meshgrid(i_d, i_q, indexing="ij")
    unknown = np.full(d.shape, np.nan)
    errors = {f"{name}_std": unknown for name in ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")}
    inductances = {"l_dd": unknown, "l_dq": unknown, "l_qq": unknown}
    psi_d = (machine().motor.pm_flux_wb or 0.0) + 0.03 * d
    known = FluxMap(method="on paper", i_d=i_d, i_q=i_q, psi_d=psi_d, psi_q=0.05 * q, **inductances, **errors)
    wanted = plan(HOLDS, SWEEPS, RIPPLE)
    flux = machine_of(machine(), wanted, DRIVE, known).flux(np.array([[2.0, 0.0], [0.0, 2.0]]))
    assert flux == pytest.approx(np.array([[0.06, 0.0], [0.0, 0.1]]), abs=1e-4)


def test_a_model_that_is_no_file_is_refused() -> None:
    with pytest.raises(PluginError, match="flux map or model"):
        machine_of(machine(), plan(HOLDS, SWEEPS), DRIVE, "saturated")
