"""A recording with an effect hidden in it: the effect corrects its readings to those of the original."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.recording import SegmentWriter, open_recording, write_manifest
from orchestrator.testing import exciting_signals, recording_with
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import VoltageBias
from plugins.effects.sensors import CurrentOffset
from protocols import Capture, Correction, Effect, InputError, Manifest, Segment, SegmentStage, Signals


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    signals, folder = exciting_signals(), tmp_path / "recorded"
    folder.mkdir()
    with SegmentWriter(folder, "classical-000") as writer:
        writer.append(
            Capture(
                start_s=10.0,
                sampling_frequency_hz=signals.sampling_frequency_hz,
                i_ab=signals.i_ab,
                v_ab=signals.v_ab,
                v_dc=signals.v_dc,
                temperature_c=signals.temperature_c,
            )
        )
        file = writer.finish()
    stage = SegmentStage.CLASSICAL
    segment = Segment(id="classical-000", stage=stage, start_s=10.0, samples=file.samples, sha256=file.sha256)
    assert signals.motor is not None
    assert signals.drive is not None
    about = {"format": "fluxbench-recording", "version": 1, "name": "bench", "created": "2026-01-01T00:00:00Z"}
    manifest = Manifest.model_validate(
        {**about, "motor": signals.motor, "drive": signals.drive, "segments": (segment,)}
    )
    write_manifest(folder, manifest)
    return folder


def hidden(recorded: Path, effect: Effect, **parameters: float) -> tuple[Capture, Capture]:
    """The segment of the original, and of the copy as it is read back."""
    recording_with(recorded, effect, recorded.with_name("copy"), **parameters)
    one, other = (open_recording(place) for place in (recorded, recorded.with_name("copy")))
    return one.load(one.segments()[0]), other.load(other.segments()[0])


def test_a_voltage_that_the_motor_did_not_feel_is_added_to_the_commands(recorded: Path) -> None:
    before, after = hidden(recorded, VoltageBias(), bias_a_v=0.3, bias_b_v=0.0)
    np.testing.assert_allclose((after.v_ab - before.v_ab)[:, 0], 0.3, rtol=1e-6)
    np.testing.assert_allclose(after.i_ab, before.i_ab)


def test_a_sensor_s_offset_is_added_to_its_readings(recorded: Path) -> None:
    before, after = hidden(recorded, CurrentOffset(), offset_a_a=0.05, offset_b_a=0.0)
    np.testing.assert_allclose((after.i_ab - before.i_ab)[:, 0], 0.05, rtol=1e-6)


class RisingGain(VoltageBias):
    """An effect whose correction depends on what it corrects."""

    def correct_batch(self, batch: object, p: object) -> Correction:
        raise AssertionError("called segment by segment here")

    def correct(self, signals: Signals, p: VoltageBias.Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab * (1.0 + p.bias_a_v))


def test_the_effect_corrects_the_copy_to_the_original(recorded: Path) -> None:
    before, after = hidden(recorded, RisingGain(), bias_a_v=0.1)
    np.testing.assert_allclose(1.1 * after.v_ab, before.v_ab, rtol=1e-6)


def test_an_effect_of_the_rotor_s_angle_is_refused(recorded: Path) -> None:
    with pytest.raises(InputError, match="it changes theta_rad, which no recorded reading shows"):
        recording_with(recorded, RotorMisalignment(), recorded.with_name("copy"), angle_rad=0.03)


class WarmBias(VoltageBias):
    """An effect by what a recording logs and by what happened before, else none."""

    def correct(self, signals: Signals, p: VoltageBias.Parameters) -> Correction:
        if signals.temperature_c is None or signals.start_temperature_c is None or signals.losses is None:
            return Correction()
        warmer = (signals.temperature_c - signals.start_temperature_c)[:, None]
        return Correction(v_ab=signals.v_ab - warmer * [p.bias_a_v, 0.0])


def test_an_effect_reads_what_the_recording_logs_and_what_was_before(recorded: Path) -> None:
    before, after = hidden(recorded, WarmBias(), bias_a_v=0.3, bias_b_v=0.0)
    assert before.temperature_c is not None
    warmer = before.temperature_c - before.temperature_c[0]
    np.testing.assert_allclose((after.v_ab - before.v_ab)[:, 0], 0.3 * warmer, atol=1e-5)


class OfFlux(VoltageBias):
    """An effect of the flux, which no reading shows."""

    def correct(self, signals: Signals, p: VoltageBias.Parameters) -> Correction:
        return Correction() if signals.psi_ab is None else Correction(v_ab=signals.v_ab - p.bias_a_v)


def test_an_effect_that_changes_nothing_is_refused_and_nothing_is_written(recorded: Path) -> None:
    copy = recorded.with_name("copy")
    with pytest.raises(InputError, match=r"changes nothing in this recording \(i_abc, inductance_ab and psi_ab"):
        recording_with(recorded, OfFlux(), copy, bias_a_v=0.3)
    assert not copy.exists()
