"""What cannot be a motor's is refused in one line; bad gains, small machines and large ones are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from orchestrator.numerics.types import Array
from orchestrator.recording._recording_checks import SoundRecording
from protocols import Capture, DriveRecord, InputError, Manifest, Motor, Segment, SegmentStage
from tests.support.cases import few

FS = 10_000.0


@dataclass(frozen=True)
class Machine:
    """A linear machine, its holds and its injection."""

    ohm: float = 4.25
    henry: float = 0.05
    rated_rms_a: float = 1.66
    bus_v: float = 540.0
    ripple_v: float = 40.0


@dataclass(frozen=True)
class InMemory:
    """A `RecordingReader` over captures that are already there."""

    manifest: Manifest
    captures: dict[str, Capture]

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return [s for s in self.manifest.segments if not stages or s.stage in stages]

    def load(self, segment: Segment) -> Capture:
        return self.captures[segment.id]

    def scaled(self, i: float = 1.0, v: float = 1.0, bus: float = 1.0, only: str = "") -> InMemory:
        made = {
            name: c.model_copy(update={"i_ab": c.i_ab * i, "v_ab": c.v_ab * v, "v_dc": c.v_dc * bus})
            if name.startswith(only)
            else c
            for name, c in self.captures.items()
        }
        return replace(self, captures=made)

    def with_motor(self, **changes: float | None) -> InMemory:
        motor = self.manifest.motor.model_copy(update=changes)
        return replace(self, manifest=self.manifest.model_copy(update={"motor": motor}))


def recorded(machine: Machine = Machine()) -> InMemory:
    rng = np.random.default_rng(1)
    rated = machine.rated_rms_a * 2.0**0.5
    captures: dict[str, Capture] = {}
    segments = []

    def put(stage: SegmentStage, i_ab: Array, v_ab: Array, **settings: Any) -> None:
        name = f"{stage.value}-{len(captures):03d}"
        noisy = i_ab + rng.normal(0.0, 2e-3 * rated, i_ab.shape)
        bus = np.full(len(i_ab), machine.bus_v)
        captures[name] = Capture(start_s=len(captures), sampling_frequency_hz=FS, i_ab=noisy, v_ab=v_ab, v_dc=bus)
        segments.append(
            Segment(id=name, stage=stage, start_s=len(captures), samples=len(bus), settings=settings, sha256=None)
        )

    put(SegmentStage.GATES_OFF, np.zeros((1000, 2)), np.zeros((1000, 2)))
    for d, q in ((0.5, 0.0), (-0.5, 0.0), (0.0, 1.0), (1.2, 0.0)):
        held = np.tile([d * rated, q * rated], (1000, 1))
        put(SegmentStage.RESISTANCE, held, machine.ohm * held)
    wave = np.where(np.arange(2000) % 20 < 10, machine.ripple_v, -machine.ripple_v)
    ripple = np.concatenate([[0.0], np.cumsum(wave)[:-1]]) / FS / machine.henry
    axis = np.array([0.8, 0.6])
    put(SegmentStage.INJECTION, np.outer(ripple - ripple.mean(), axis), np.outer(wave, axis), frequency_hz=500.0)
    motor = Motor(
        name="m",
        pole_pairs=2,
        rated_current_rms_a=machine.rated_rms_a,
        stator_resistance_ohm=machine.ohm,
        d_inductance_h=machine.henry,
        q_inductance_h=machine.henry,
    )
    drive = DriveRecord(name="d", sampling_frequency_hz=FS, dc_bus_voltage_v=machine.bus_v)
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="bench",
        created="2026-01-01",
        motor=motor,
        drive=drive,
        segments=tuple(segments),
    )
    return InMemory(manifest, captures)


SMALL = Machine(ohm=12.0, henry=6e-3, rated_rms_a=0.4, bus_v=24.0, ripple_v=5.0)
LARGE = Machine(ohm=0.02, henry=5e-4, rated_rms_a=145.0, bus_v=320.0, ripple_v=60.0)


@pytest.mark.parametrize("machine", [Machine(), SMALL, LARGE])
@pytest.mark.parametrize("gains", [{}, {"i": 10.0}, {"i": 0.1}, {"v": 10.0}, {"v": 0.1}, {"bus": 10.0}, {"bus": 0.1}])
def test_a_gain_that_is_wrong_by_ten_passes(machine: Machine, gains: dict[str, Any]) -> None:
    SoundRecording(recorded(machine).scaled(**gains)).read_through()


@few("machine", [Machine(), SMALL, LARGE])
@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"i": 1e18}, "i_alpha, i_beta"),
        ({"i": 1e9}, "i_alpha, i_beta"),
        ({"i": 1e3}, "times the rated current"),
        ({"i": 0.0}, "no current was measured"),
        ({"v": 1e18}, "v_alpha, v_beta"),
        ({"v": 1e9}, "times the bus voltage"),
        ({"v": 0.0}, "not the voltage at a motor"),
        ({"v": 1e-3}, "ohm"),
        ({"v": -1.0}, "reversed"),
        ({"bus": 0.0}, "v_dc"),
        ({"bus": -1.0}, "v_dc"),
        ({"bus": 1e9}, "v_dc"),
        ({"i": 1e18, "only": "injection"}, "injection-005"),
        ({"v": -1.0, "only": "injection"}, "reversed"),
    ],
)
def test_what_cannot_be_a_motor_s_is_refused(machine: Machine, gains: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        SoundRecording(recorded(machine).scaled(**gains)).read_through()
    assert message in str(caught.value)
    assert str(caught.value).startswith("bench: ")
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_what_is_refused_without_a_nameplate_is_what_needs_none() -> None:
    bare = recorded().with_motor(
        rated_current_rms_a=None, stator_resistance_ohm=None, d_inductance_h=None, q_inductance_h=None
    )
    SoundRecording(bare.scaled(i=100.0)).read_through()
    for scaled, message in (
        (bare.scaled(i=1e9), "any motor's"),
        (bare.scaled(v=1e9), "bus"),
        (bare.scaled(v=-1.0), "reversed"),
    ):
        with pytest.raises(InputError, match=message):
            SoundRecording(scaled).read_through()


def test_a_sampling_frequency_that_is_wrong_by_a_thousand_shows_in_the_inductance() -> None:
    sound = recorded()
    slow = {
        name: c.model_copy(update={"sampling_frequency_hz": 1e-3 * c.sampling_frequency_hz})
        for name, c in sound.captures.items()
    }
    with pytest.raises(InputError, match="sampling frequency"):
        SoundRecording(replace(sound, captures=slow)).read_through()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stator_resistance_ohm": 1e300}, "motor.stator_resistance_ohm"),
        ({"d_inductance_h": 1e-300}, "motor.d_inductance_h"),
        ({"pm_flux_wb": 1e9}, "motor.pm_flux_wb"),
        ({"rated_current_rms_a": 1e-9}, "motor.rated_current_rms_a"),
    ],
)
def test_a_nameplate_that_no_motor_has_is_named(changes: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SoundRecording(recorded().with_motor(**changes))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frequency_hz": "500 Hz"}, "settings.frequency_hz: expected a number"),
        ({"rotation_hz": [2.0]}, "settings.rotation_hz: expected a number"),
        ({"rotation_hz": -2.0}, "settings.rotation_hz"),
        ({"period_s": True}, "settings.period_s"),
        ({"pwm_frequency_hz": 1e12}, "settings.pwm_frequency_hz"),
        ({"target_d_a": "1 A"}, "settings.target_d_a"),
    ],
)
def test_a_setting_that_cannot_be_meant_is_named(settings: dict[str, object], message: str) -> None:
    sound = recorded()
    *others, last = sound.manifest.segments
    changed = (*others, last.model_copy(update={"settings": settings}))
    with pytest.raises(InputError) as caught:
        SoundRecording(replace(sound, manifest=sound.manifest.model_copy(update={"segments": changed})))
    assert f"segments.{last.id}.{message}" in str(caught.value)


def test_a_recording_without_a_measurement_is_left_to_whoever_reads_it() -> None:
    sound = recorded()
    only = sound.manifest.model_copy(update={"segments": sound.manifest.segments[:1]})
    SoundRecording(replace(sound, manifest=only)).read_through()
