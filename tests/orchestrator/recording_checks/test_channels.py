"""Dead and clipped channels, and noise in the place of a current."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from orchestrator.recording import open_recording
from orchestrator.recording._recording_checks import SoundRecording
from orchestrator.recording_checks import find_convention
from orchestrator.recording_checks.channels import clipped
from orchestrator.recording_checks.survey import survey
from protocols import Capture, NotMeasuredError
from tests.blind.campaign import record
from tests.blind.hidden import draw_case
from tests.orchestrator.recording_checks.conftest import SHORT
from tests.support.cases import few
from tests.support.rewriting import TO_PHASES, Field, Rewritten, gain


@few("phase, sensors", [("a", "ab"), ("b", "ab"), ("c", "ac"), ("a", "abc"), ("c", "abc")], fast=2)
def test_a_dead_phase_is_named(right: Rewritten, phase: str, sensors: str) -> None:
    convention = find_convention(right.phases("i_ab", gain(phase, 0.0), sensors))
    assert convention is not None
    assert convention.kind == "dead_channel"
    assert f"phase {phase}" in convention.what


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_a_channel_that_stays_where_it_is_is_named(right: Rewritten, value: float) -> None:
    convention = find_convention(right.captured(lambda c: {"i_ab": c.i_ab * [1.0, 0.0] + [0.0, value]}))
    assert convention is not None
    assert convention.what == "i_beta looks dead"


def test_a_phase_that_is_only_dead_in_its_own_column_is_named(right: Rewritten) -> None:
    convention = find_convention(
        right.captured(lambda c: {"i_abc": np.ones((len(c), 3)) * c.i_ab[:, :1] * [1.0, 1.0, 0.0]})
    )
    assert convention is not None
    assert convention.what == "the current of phase c looks dead"


@pytest.mark.parametrize(("field", "limit", "name"), [("i_ab", 1.5, "currents"), ("v_ab", 20.0, "voltages")])
def test_clipped_readings_are_named_with_their_limit(right: Rewritten, field: Field, limit: float, name: str) -> None:
    convention = find_convention(right.captured(lambda c: {field: np.clip(getattr(c, field), -limit, limit)}))
    assert convention is not None
    assert convention.kind == f"clipped_{name}"
    assert f"{limit:g}" in convention.what


def test_square_waves_of_an_open_loop_are_no_clipped_voltages(right: Rewritten) -> None:
    """A log states no amplitude, and its commands stand still between the edges."""
    log = right.without_settings("amplitude_v")

    def squared(c: Capture) -> dict[str, Any]:
        sign = np.where(np.arange(len(c)) // 10 % 2 == 0, 1.0, -1.0)
        return {"v_ab": c.v_ab.mean(axis=0) + 20.0 * sign[:, None] * [1.0, 0.0]}

    assert clipped(survey(log.captured(squared))) is None
    found = clipped(survey(log.captured(lambda c: {"v_ab": np.clip(c.v_ab, -20.0, 20.0)})))
    assert found is not None
    assert found.kind == "clipped_voltages"


@pytest.mark.parametrize(("spikes", "size"), [(1, 3.0), (5, -0.4), (5, 19.0)])
def test_spikes_of_the_bus_are_named(right: Rewritten, spikes: int, size: float) -> None:
    def spiked(c: Capture) -> dict[str, Any]:
        v_dc = c.v_dc.copy()
        v_dc[50 : 50 + 7 * spikes : 7] *= size
        return {"v_dc": v_dc}

    convention = find_convention(right.captured(spiked))
    assert convention is not None
    assert convention.kind == "bus_spikes"
    assert "sample 50" in convention.evidence


def test_a_spike_that_no_bus_makes_is_refused(right: Rewritten) -> None:
    def spiked(c: Capture) -> dict[str, Any]:
        v_dc = c.v_dc.copy()
        v_dc[50] *= 1e3
        return {"v_dc": v_dc}

    with pytest.raises(NotMeasuredError, match=r"v_dc: sample 50: .* which is impossible"):
        SoundRecording(right.captured(spiked)).read_through()


def test_a_bus_that_moves_is_no_spike(right: Rewritten) -> None:
    def moved(c: Capture) -> dict[str, Any]:
        return {"v_dc": c.v_dc * np.where(np.arange(len(c)) < len(c) // 4, 1.8, 1.0).astype(c.v_dc.dtype)}

    assert find_convention(right.captured(moved)) is None


def test_noise_in_the_place_of_a_current_is_refused(right: Rewritten, rng: np.random.Generator) -> None:
    def noise(c: Capture) -> dict[str, Any]:
        return {"i_ab": rng.normal(0.0, 1.0, c.i_ab.shape)}

    with pytest.raises(NotMeasuredError, match="do not follow the voltage"):
        find_convention(right.captured(noise))


def test_noise_in_the_place_of_one_channel_is_named(right: Rewritten, rng: np.random.Generator) -> None:
    convention = find_convention(
        right.captured(lambda c: {"i_ab": c.i_ab * [1.0, 0.0] + [0.0, 1.0] * rng.normal(0.0, 1.0, (len(c), 1))})
    )
    assert convention is not None
    assert convention.what == "i_beta looks dead"


@pytest.mark.parametrize("angle_rad", [0.0, 0.9, 0.5 * math.pi])
def test_a_current_that_is_requested_along_one_line_is_not_dead(right: Rewritten, angle_rad: float) -> None:
    along = _along_one_axis(right, angle_rad)
    assert find_convention(along) is None
    phases = along.captured(lambda c: {"i_abc": c.i_ab @ TO_PHASES.T})
    assert find_convention(phases) is None


def _along_one_axis(right: Rewritten, angle_rad: float) -> Rewritten:
    """The same segments of an R-L winding whose voltage never leaves a line, with some noise."""
    ohm, henry = right.manifest.motor.stator_resistance_ohm, right.manifest.motor.d_inductance_h
    assert ohm is not None
    assert henry is not None
    keep = math.exp(-ohm / henry / right.manifest.drive.sampling_frequency_hz)
    rng, axis = np.random.default_rng(3), np.array([math.cos(angle_rad), math.sin(angle_rad)])

    def change(c: Capture) -> dict[str, Any]:
        level = float(rng.uniform(-3.0, 3.0))
        square = np.where(np.arange(len(c)) % 20 < 10, 40.0, -40.0)
        volts = ohm * level + square
        i = level + lfilter([0.0, (1.0 - keep) / ohm], [1.0, -keep], square)
        return {"i_ab": i[:, None] * axis + rng.normal(0.0, 0.004, (len(c), 2)), "v_ab": volts[:, None] * axis}

    return right.captured(change).with_segments(lambda _: {"settings": {}, "rotor_angle_rad": angle_rad})


def test_a_drive_that_lost_its_current_on_the_way_is_no_exchange_of_phases(tmp_path: Path) -> None:
    """Its sensors saturate: from some large current on the control winds up, and what follows is at full voltage."""
    bench = draw_case("clean", 0, 1).bench
    bench = dataclasses.replace(bench, plant=bench.plant._replace(clip_a=4.1), believed_rad=-0.45)
    path = record(bench, dataclasses.replace(SHORT, injection_s=0.25), tmp_path / "lost")
    message = r"injection-0\d\d: i_alpha, i_beta: .* the drive had lost its current there"
    with pytest.raises(NotMeasuredError, match=message):
        find_convention(open_recording(path))
