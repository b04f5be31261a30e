"""Voltage steps whose rows are slow beside L / R: exact where the voltage is constant between them, else doubted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.estimation import estimate_recording
from plugins.estimators._maps import SteppedFlux
from plugins.estimators.steps import StepResistanceEstimator, StepsEstimator
from protocols import Capture, DriveRecord, EstimationContext, Manifest, Motor, Segment, SegmentStage
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.analysis.plant import Array
from tests.support.cases import few

OHM, HENRY = 0.45, (2.0e-4, 2.1e-4)
RATE_HZ, ROWS = 1e3, 900


def stepped_voltage(hold: int, rows: int) -> Array:
    """+-1.5 V on both axes, each turning round at random times, shape (rows, 2)."""
    random = np.random.default_rng(5)
    turns = random.random((rows // hold + 1, 2)) < 0.5
    return np.repeat(1.5 * np.where(np.cumsum(turns, axis=0) % 2, 1.0, -1.0), hold, axis=0)[:rows]


def answer(v: Array, step_s: float, henry: tuple[float, float] = HENRY) -> Array:
    """Current at the beginning of each row, the voltage being constant until the next; shape (rows, 2)."""
    i = np.zeros_like(v)
    for axis, h in enumerate(henry):
        kept = np.exp(-step_s * OHM / h)
        i[:, axis] = lfilter([0.0, (1.0 - kept) / OHM], [1.0, -kept], v[:, axis])
    return i


def recording_of(i: Array, v: Array, rate_hz: float, carrier_hz: float) -> MemoryRecording:
    noisy = i + 0.008 * np.random.default_rng(6).normal(size=i.shape)
    capture = Capture(
        start_s=0.0, sampling_frequency_hz=rate_hz, i_ab=noisy, v_ab=v, v_dc=np.full(len(v), 24.0)
    )  # fmt: skip
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="slow rows",
        created="2026-01-01",
        motor=Motor(
            name="m",
            pole_pairs=6,
            rated_current_rms_a=4.0,
            stator_resistance_ohm=OHM,
            d_inductance_h=HENRY[0],
            q_inductance_h=HENRY[1],
        ),
        drive=DriveRecord(
            name="d", sampling_frequency_hz=rate_hz, dc_bus_voltage_v=24.0, pwm_frequency_hz=carrier_hz
        ),
        segments=(Segment(id="s", stage=SegmentStage.STEPS, start_s=0.0, samples=len(v)),),
    )  # fmt: skip
    return MemoryRecording(manifest, {"s": capture})


def telemetry() -> MemoryRecording:
    """Means over a millisecond of a control at 20 kHz, whose L / R is 0.44 ms."""
    fine = stepped_voltage(103, 20 * ROWS)
    means = [x.reshape(ROWS, 20, 2).mean(axis=1) for x in (answer(fine, 5e-5), fine)]
    return recording_of(means[0], means[1], RATE_HZ, 2e4)


def found(recording: MemoryRecording) -> SteppedFlux:
    return StepsEstimator().estimate(recording, EstimationContext())


def at_rest(stepped: SteppedFlux) -> tuple[Array, Array]:
    """L_d and L_q without current, and their standard deviations [H]."""
    m = stepped.map
    d, q = int(np.argmin(np.abs(m.i_d))), int(np.argmin(np.abs(m.i_q)))
    return np.array([m.l_dd[d, q], m.l_qq[d, q]]), np.array([m.l_dd_std[d, q], m.l_qq_std[d, q]])


@few("rows_a_constant", [4.0, 1.2, 0.5])
def test_rows_of_the_control_itself_give_the_inductance_however_slow_they_are(rows_a_constant: float) -> None:
    rate_hz = rows_a_constant * OHM / HENRY[0]
    v = stepped_voltage(max(5, round(4.0 * rows_a_constant)), 3000)
    value, std = at_rest(found(recording_of(answer(v, 1.0 / rate_hz), v, rate_hz, rate_hz)))
    assert value == pytest.approx(HENRY, rel=0.04)
    assert (np.abs(value - HENRY) < 1.96 * std).all()


@pytest.mark.slow
def test_means_slower_than_the_control_leave_the_map_unusable_and_its_band_holds_the_truth() -> None:
    recording = telemetry()
    stepped = found(recording)
    m = stepped.map
    off_d, off_q = m.psi_d - HENRY[0] * m.i_d[:, None], m.psi_q - HENRY[1] * m.i_q[None, :]
    for off, std in ((off_d, m.psi_d_std), (off_q, m.psi_q_std)):
        there = np.isfinite(off)
        assert np.mean(np.abs(off[there]) < 1.96 * std[there]) > 0.9
    value, std = at_rest(stepped)
    assert (np.abs(value - HENRY) < 1.96 * std).all()


def test_an_estimate_of_slow_telemetry_names_what_is_in_the_way(tmp_path: Path) -> None:
    report = estimate_recording(telemetry(), [StepsEstimator(), StepResistanceEstimator()], tmp_path)
    assert not report.usable
    assert "uncertain_map" in {remark.code for remark in report.remarks}
    assert "far_from_nameplate" not in {remark.code for remark in report.remarks}
    assert any("L / R is 0.44 samples" in remark.text for remark in report.remarks)
