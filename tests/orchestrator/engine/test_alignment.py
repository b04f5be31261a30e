"""A drive whose voltage stands in the wrong row is caught at its first injection, in the run itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orchestrator.engine._alignment import AlignmentCheck
from plugins.drives.simulated import SimulatedDrive
from protocols import Capture, DriveFault, Excitation, FaultCause, Injection
from tests.orchestrator.testing.example_drive import FS, ExampleDrive
from tests.support.tiny import STAGES, run_tiny


@pytest.mark.parametrize("rows", [-1, 1])
def test_a_voltage_in_the_row_beside_ends_the_run_at_the_first_injection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    start = SimulatedDrive.start

    def shifted(self: SimulatedDrive, excitation: Excitation) -> Iterator[Capture]:
        for block in start(self, excitation):
            yield block.model_copy(update={"v_ab": np.roll(block.v_ab, rows, axis=0)})

    monkeypatch.setattr(SimulatedDrive, "start", shifted)
    outcome = run_tiny(tmp_path, stages=[stage for stage in STAGES if stage["kind"] == "injection"]).outcome
    assert isinstance(outcome.error, DriveFault)
    assert outcome.error.cause is FaultCause.WRONG_DATA
    assert f"injection-000: the current follows the voltage of row k from t_k + {-rows:.1f} Ts on" in outcome.reason


@pytest.mark.parametrize("delay_rows", [0.0, 0.5])
def test_a_delay_of_a_part_of_a_row_and_a_ripple_without_edges_are_left_to_the_diagnosis(delay_rows: float) -> None:
    check = AlignmentCheck(ExampleDrive.capabilities)
    for waveform, late in (("square", delay_rows), ("sine", 5.0)):
        injection = Injection(
            target_d_a=0.0,
            target_q_a=0.0,
            settle_s=0.1,
            duration_s=0.2,
            amplitude_v=40.0,
            frequency_hz=500.0,
            rotation_hz=5.0,
            waveform=waveform,
        )
        t = np.arange(2000)
        phase = t / 20 % 1.0
        wave = np.where(phase < 0.5, 1.0, -1.0) if waveform == "square" else np.sin(2 * np.pi * phase)
        v = 40.0 * wave * np.exp(2j * np.pi * 5.0 * t / FS)
        whole = int(late)
        acts = (1 - late + whole) * np.roll(v, whole) + (late - whole) * np.roll(v, whole + 1)
        i = np.cumsum(acts) - acts
        ab = [np.stack([x.real, x.imag], axis=1) for x in (i / FS / 0.05, v)]
        check.begin()
        check.update(
            injection, Capture(start_s=0, sampling_frequency_hz=FS, i_ab=ab[0], v_ab=ab[1], v_dc=np.ones(len(t)))
        )
        check.conclude("injection-000")
