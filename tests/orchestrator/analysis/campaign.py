"""A whole recording in memory, from the tests' own motor: holds, trapezoids and injection on a 5 x 5 grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from protocols import Capture, DriveRecord, Manifest, Motor, Segment, SegmentStage
from tests.orchestrator.analysis.plant import (
    R_S,
    SAMPLING_HZ,
    Array,
    CurrentOf,
    Run,
    capture_of,
    flux_for,
    injection_voltage,
    integrate_motor,
    saturated_current,
)

SIDES = np.array([-3.0, -1.5, 0.0, 1.5, 3.0])
PERIOD_S = 0.6
MOTOR = Motor(name="test motor", pole_pairs=2, rated_current_rms_a=1.66, pm_flux_wb=0.3)


@dataclass(frozen=True)
class MemoryRecording:
    """A `RecordingReader` over captures that are already there."""

    manifest: Manifest
    captures: dict[str, Capture]

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return [s for s in self.manifest.segments if not stages or s.stage in stages]

    def load(self, segment: Segment) -> Capture:
        return self.captures[segment.id]

    def only(self, *stages: SegmentStage) -> MemoryRecording:
        """The same recording with these stages alone."""
        return self.with_segments(tuple(self.segments(*stages)))

    def with_segments(self, segments: tuple[Segment, ...]) -> MemoryRecording:
        return MemoryRecording(self.manifest.model_copy(update={"segments": segments}), self.captures)


def trapezoid(t: float) -> float:
    """Unit trapezoid: up in an eighth of the period, held a quarter, down in a quarter, held, back."""
    return float(
        np.interp(t / PERIOD_S % 1.0, [0.0, 0.125, 0.375, 0.625, 0.875, 1.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    )


def follow(reference: Callable[[float], Array], resistance: float) -> Callable[[int, Array], Array]:
    """A current controller, proportional with the resistive drop fed forward."""

    def voltage(k: int, i: Array) -> Array:
        wanted = reference(k / SAMPLING_HZ)
        return resistance * wanted + 60.0 * (wanted - i)

    return voltage


def make_recording(
    *,
    current_of: CurrentOf = saturated_current,
    resistance: float = R_S,
    angle: float = 0.0,
    noise_a: float = 2e-3,
    acts: Callable[[Array, Array], Array] = lambda v, _i: v,
    amplitudes_v: tuple[float, ...] = (40.0,),
    frequency_hz: float = 500.0,
) -> MemoryRecording:
    """Record the motor; `angle` is the (true and believed) rotor angle, `acts` what gets through the inverter."""

    def run(voltage: Callable[[int, Array], Array], at: Array, steps: int) -> Run:
        start = flux_for(at, current_of)
        return integrate_motor(voltage, start, steps, current_of, resistance=resistance, substeps=1, acts=acts)

    plane = np.stack(np.meshgrid(SIDES, SIDES, indexing="ij"), axis=-1).reshape(-1, 2)
    sizes = np.array([0.2, 0.6, 1.2, 2.0, 3.0])
    held = np.concatenate([np.outer(s * sizes, e) for e in np.eye(2) for s in (1.0, -1.0)])
    swept = np.array([*((0.0, 1.0),) * 5, *((1.0, 0.0),) * 5, (0.5**0.5, 0.5**0.5)])
    base = np.concatenate([np.outer(SIDES, [1.0, 0.0]), np.outer(SIDES, [0.0, 1.0]), np.zeros((1, 2))])
    stages: list[tuple[SegmentStage, Run]] = [
        (SegmentStage.RESISTANCE, run(follow(lambda _t: held, resistance), held, 1500)),
        (
            SegmentStage.CLASSICAL,
            run(
                follow(lambda t: base + 3.0 * trapezoid(t) * swept, resistance), base, round(2 * PERIOD_S * SAMPLING_HZ)
            ),
        ),
    ]
    for amplitude in amplitudes_v:
        # What the inverter takes of the mean voltage is put back, so that the currents aimed at are reached.
        command = resistance * plane
        for _ in range(4):
            command = command + resistance * plane - acts(command, plane)
        stages.append(
            (SegmentStage.INJECTION, run(injection_voltage(command, amplitude, frequency_hz, 4.0), plane, 4000))
        )
    segments: list[Segment] = []
    captures: dict[str, Capture] = {}
    clock = 0.0
    for stage, result in stages:
        for point in range(result.i_dq.shape[1]):
            name = f"{stage.value}-{len(segments):03d}"
            samples = result.i_dq.shape[0]
            segments.append(Segment(id=name, stage=stage, start_s=clock, samples=samples, rotor_angle_rad=angle))
            captures[name] = capture_of(
                result, point, angle=angle, start_s=clock, noise_a=noise_a, seed=1000 * len(segments)
            )
            clock += samples / SAMPLING_HZ
    drive = DriveRecord(name="tests", sampling_frequency_hz=SAMPLING_HZ, dc_bus_voltage_v=540.0)
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="test",
        created="2026-01-01T00:00:00Z",
        motor=MOTOR,
        drive=drive,
        segments=tuple(segments),
    )
    return MemoryRecording(manifest, captures)
