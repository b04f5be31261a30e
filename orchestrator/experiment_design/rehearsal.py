"""A plan's rehearsal: its currents, and the voltages that they take in a model of the machine.

    v_k = R_s (i_k + i_k+1) / 2 + (psi(i_k+1) - psi(i_k)) / Ts

These signals contain neither noise nor effects. They are cut into equations like a recording's; the sensors' noise
enters through the equations' covariance.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.config import Plan, PlannedPoint
from orchestrator.diagnosis._prepare import setup_of
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model, given_model
from orchestrator.diagnosis.fitting.model import Model
from orchestrator.diagnosis.reporting.motor_model import flux_map_of
from orchestrator.diagnosis.weak_form.noise import SensorNoise
from orchestrator.diagnosis.weak_form.preparation import THINNED_TURNS, prepare
from orchestrator.diagnosis.weak_form.segments import MIN_PERIODS_PER_TEST_FUNCTION, TEST_FUNCTIONS_PER_TURN
from orchestrator.experiment_design.machine import Machine, current_of
from orchestrator.experiment_design.separation import PLANNED_TURN_S
from orchestrator.numerics.frames import from_two_phases, to_ab
from protocols import (
    Capabilities,
    Capture,
    DriveRecord,
    Excitation,
    FluxMap,
    GatesOff,
    Injection,
    Manifest,
    MotorModel,
    PluginError,
    Saturated,
    Segment,
    SegmentStage,
    Trapezoid,
)

NOISE_OF_RATED_CURRENT: float = 0.002
"""Default noise of a reading over the rated current: the step of a 12-bit converter with four times its range."""
REHEARSED_HOLD_S: float = 2.0
"""Part of a hold that is rehearsed [s]; the rest is identical."""


@dataclass(frozen=True)
class RehearsedRecording:
    """A plan's recording in advance: a `RecordingReader` that computes waveforms when they are loaded.

    Of repeated periods, turns and holds only the beginning is computed, and turns are short.
    """

    manifest: Manifest
    machine: Machine
    excitations: dict[str, Excitation]
    criteria: Criteria

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        return [s for s in self.manifest.segments if not stages or s.stage in stages]

    def load(self, segment: Segment) -> Capture:
        fs = self.manifest.drive.sampling_frequency_hz
        excitation = self.excitations[segment.id]
        samples = self._samples(excitation, segment.samples, fs)
        i_dq = current_of(excitation, self.machine, np.arange(samples + 1) / fs)
        off = isinstance(excitation, GatesOff)
        v_dq = np.zeros((samples, 2)) if off else self.machine.voltage(i_dq, fs)
        angle = segment.rotor_angle_rad
        return Capture(
            start_s=segment.start_s,
            sampling_frequency_hz=fs,
            i_ab=to_ab(i_dq[:-1], angle),
            v_ab=to_ab(v_dq, angle),
            v_dc=np.full(samples, self.manifest.drive.dc_bus_voltage_v),
        )

    def _samples(self, excitation: Excitation, samples: int, fs: float) -> int:
        if isinstance(excitation, Trapezoid):
            return min(samples, round(excitation.period_s * fs) + 1)
        if isinstance(excitation, Injection):
            turn_s = 1.0 / (excitation.rotation_hz or 1.0)
            return min(samples, math.ceil(THINNED_TURNS * turn_s * fs))
        return min(samples, round(REHEARSED_HOLD_S * fs))


@dataclass(frozen=True)
class Rehearsal:
    """A plan's equations before it is measured.

    Attributes
    ----------
    plan : Plan
    setup : DiagnosisSetup
        Like that of a recording of the plan.
    model : Model
        The machine, with a free map and without effects.
    weights : tuple of float
        Number of segments that each piece represents; 0 where it is held out of fits.
    stages : tuple of int
        Index in the plan of each piece's stage.
    noise_a : float
        Standard deviation of a phase current's reading.
    """

    plan: Plan
    setup: DiagnosisSetup
    model: Model
    weights: tuple[float, ...]
    stages: tuple[int, ...]
    noise_a: float


def rehearse(
    plan: Plan, drive: Capabilities, machine: Machine, noise_a: float | None = None, criteria: Criteria | None = None
) -> Rehearsal:
    """A plan's equations.

    Parameters
    ----------
    drive : Capabilities
        Its sampling, PWM frequency and bus voltage.
    noise_a : float, optional
        Standard deviation of a phase current's reading; by default a part of the rated current.

    Raises
    ------
    NotMeasuredError
        Where nothing in the plan can be diagnosed.
    """
    criteria = criteria or Criteria()
    cutting = criteria.weak_form.model_copy(update={"most_samples": criteria.rehearsal.rehearsed_samples})
    recording = _recording(plan, drive, machine, criteria)
    prepared = replace(prepare(recording, criteria.model_copy(update={"weak_form": cutting})), remarks=())
    if noise_a is None:
        noise_a = NOISE_OF_RATED_CURRENT * (machine.motor.rated_current_a or max(prepared.current_range))
    # Two phases are read, each with its own noise; the third is computed.
    readings = from_two_phases([noise_a, 0.0], [0.0, noise_a])
    covariance = readings.T @ readings
    setup = setup_of(prepared, SensorNoise(covariance, covariance, 0.0))
    model = baseline_model(setup, Saturated())
    if machine.magnetics is not None:
        model = setup.fitter.fit(model, relinearisations=1).model
    index = {point.id: point.stage_index for point in plan.points}
    stages = tuple(index[piece.segment.id] for piece in setup.prepared.pieces)
    return Rehearsal(plan, setup, replace(model, r_s=machine.r_s), _weights(plan, setup, stages), stages, noise_a)


def machine_of(nameplate: Machine, plan: Plan, drive: Capabilities, model: FluxMap | MotorModel | str) -> Machine:
    """A machine with a known flux map, and with the R_s of a complete motor model.

    Raises
    ------
    PluginError
        Where the model is neither a map nor a model.
    NotMeasuredError
        Where the map does not cover the plan's currents.
    """
    if isinstance(model, str):
        raise PluginError("--model", model, "expected the path of a flux map or model")
    flux_map = flux_map_of(model) if isinstance(model, MotorModel) else model
    r_s = model.r_s_ohm if isinstance(model, MotorModel) else nameplate.r_s
    magnetics = given_model(rehearse(plan, drive, nameplate).setup, flux_map).magnetics
    return replace(nameplate, r_s=r_s, magnetics=magnetics)


def _recording(plan: Plan, drive: Capabilities, machine: Machine, criteria: Criteria) -> RehearsedRecording:
    segments, excitations, now = [], dict[str, Excitation](), 0.0
    for point in plan.points:
        if point.spare:
            continue
        now += point.excitation.settling_s
        excitations[point.id] = excitation = _with_short_turns(point.excitation)
        segments.append(_segment(point, excitation, now, drive.sampling_frequency_hz))
        now += point.captured_s
    record = DriveRecord(
        name=drive.name,
        sampling_frequency_hz=drive.sampling_frequency_hz,
        pwm_frequency_hz=drive.pwm_frequency_hz,
        dc_bus_voltage_v=drive.dc_bus_voltage_v,
    )
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name=plan.procedure.name,
        created="",
        motor=machine.motor,
        drive=record,
        segments=tuple(segments),
    )
    return RehearsedRecording(manifest, machine, excitations, criteria)


def _with_short_turns(excitation: Excitation) -> Excitation:
    """An injection that turns as fast as its windows allow: its information per time stays the same."""
    if not isinstance(excitation, Injection) or not excitation.rotation_hz:
        return excitation
    periods = TEST_FUNCTIONS_PER_TURN * MIN_PERIODS_PER_TEST_FUNCTION
    turn_s = max(PLANNED_TURN_S, periods / excitation.frequency_hz)
    return excitation.model_copy(update={"rotation_hz": max(excitation.rotation_hz, 1.0 / turn_s)})


def _segment(point: PlannedPoint, excitation: Excitation, start_s: float, fs: float) -> Segment:
    turning = {"rotation_hz": excitation.rotation_hz} if isinstance(excitation, Injection) else {}
    return Segment(
        id=point.id,
        stage=point.stage,
        start_s=start_s,
        samples=max(excitation.rows(fs), 1),
        rotor_angle_rad=excitation.rotor_angle_rad,
        settings={**point.settings, **turning},
    )


def _weights(plan: Plan, setup: DiagnosisSetup, stages: Sequence[int]) -> tuple[float, ...]:
    """Captured time of a stage over the time of its rehearsed pieces, for each piece."""
    pieces = setup.prepared.pieces
    captured, rehearsed = defaultdict[int, float](float), defaultdict[int, float](float)
    for point in plan.points:
        captured[point.stage_index] += 0.0 if point.spare else point.captured_s
    for piece, stage in zip(pieces, stages, strict=True):
        rehearsed[stage] += len(piece.signals.v_dc) / piece.signals.sampling_frequency_hz
    return tuple(
        0.0 if piece.held_out else captured[stage] / rehearsed[stage]
        for piece, stage in zip(pieces, stages, strict=True)
    )
