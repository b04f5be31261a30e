"""Segments of a machine with constant inductances, made without a recording: each test takes what it needs.

Between two samples the voltage is constant and the current is the exact response of a resistance and an inductance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.corrections import apply_effects
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import MapSpace, Model
from orchestrator.diagnosis.nuisances.pwm_quantiser import leg_step_of, rounded_by
from orchestrator.diagnosis.weak_form.magnetics import linear_magnetics, smoothness_prior
from orchestrator.diagnosis.weak_form.noise import sensor_noise
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData, injection_period, windows_of
from orchestrator.diagnosis.weak_form.sensor_scatter import scatter_of
from orchestrator.numerics.tensor_spline import EvenSpline
from protocols import (
    DriveRecord,
    Manifest,
    ModulatorTimer,
    Motor,
    Segment,
    SegmentStage,
    SignalBatch,
    Signals,
    TimerPhases,
)

Array = NDArray[np.float64]

FS = 10_000.0
R_S, L_D, L_Q, PM_WB = 4.25, 0.045, 0.07, 0.3
NOISE_A = 0.004
CRITERIA = Criteria()
GRID = EvenSpline(-3.5, 3.5, 3.5, (4, 4))
TRUE_MAP = linear_magnetics(GRID, L_D, L_Q)
MOTOR = Motor(
    name="on paper",
    pole_pairs=2,
    rated_current_rms_a=1.66,
    stator_resistance_ohm=R_S,
    d_inductance_h=L_D,
    q_inductance_h=L_Q,
    pm_flux_wb=PM_WB,
)
DRIVE = DriveRecord(name="on paper", sampling_frequency_hz=FS, pwm_frequency_hz=FS, dc_bus_voltage_v=540.0)


def response(v_dq: Array, start: Array) -> Array:
    """Current at each sample, the voltage being constant from it to the next, shape (n, 2)."""
    out = np.empty_like(v_dq)
    for axis, henry in enumerate((L_D, L_Q)):
        keep = math.exp(-R_S / (FS * henry))
        out[0, axis] = start[axis]
        for k in range(1, len(v_dq)):
            out[k, axis] = keep * out[k - 1, axis] + (1.0 - keep) / R_S * v_dq[k - 1, axis]
    return out


def hold(d: float, q: float, samples: int = 600) -> Array:
    """Voltage of a dwell."""
    return np.tile(R_S * np.array([d, q]), (samples, 1))


def sweep(axis: int, amplitude: float, held: float, samples: int = 3000) -> Array:
    """Voltage whose current goes round along one axis, the other held."""
    t = 2.0 * np.pi * np.arange(samples) / samples
    v = np.full((samples, 2), R_S * held)
    henry = (L_D, L_Q)[axis]
    v[:, axis] = amplitude * (R_S * np.sin(t) + henry * 2.0 * np.pi * FS / samples * np.cos(t))
    return v


def ripple(d: float, q: float, volts: float, samples: int = 2500, period: int = 20) -> Array:
    """Voltage of a square wave whose direction turns once in `samples`."""
    k = np.arange(samples)
    turn = 2.0 * np.pi * k / samples
    wave = np.where((k + period // 4) % period < period // 2, volts, -volts)
    return np.asarray(R_S * np.array([d, q]) + wave[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1))


@dataclass(frozen=True)
class Plan:
    """One segment to be made."""

    stage: SegmentStage
    v_dq: Array
    held_out: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)


def plan(*, sparse: bool = False) -> list[Plan]:
    """A small campaign: gates off, holds, sweeps, two injections."""
    holds = [(a * x, a * y) for a in (0.3, 2.0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    made = [Plan(SegmentStage.GATES_OFF, np.zeros((600, 2)))]
    made += [Plan(SegmentStage.RESISTANCE, hold(*point)) for point in holds]
    made += [Plan(SegmentStage.CLASSICAL, sweep(axis, 2.5, 0.0)) for axis in (0, 1)]
    made.append(Plan(SegmentStage.CLASSICAL, sweep(1, 1.5, 0.0), held_out=True))
    settings = {"frequency_hz": FS / 20, "rotation_hz": FS / 2500, "amplitude_v": 40.0}
    points = [(0.0, 0.0)] if sparse else [(0.0, 0.0), (2.0, 1.0), (-1.0, 2.0)]
    return made + [Plan(SegmentStage.INJECTION, ripple(*point, 40.0), settings=settings) for point in points]


def many_holds() -> list[Plan]:
    """Without the sweeps, but with holds all around at currents that no other has."""
    turn = 2.0 * np.pi * np.arange(36) / 36
    held = [hold(a * np.cos(t), a * np.sin(t)) for t, a in zip(turn, np.linspace(0.5, 2.4, 36), strict=True)]
    return [
        *(p for p in plan() if p.stage is not SegmentStage.CLASSICAL),
        *(Plan(SegmentStage.RESISTANCE, v_dq) for v_dq in held),
    ]


def piece(requested: Plan, *, start_s: float = 0.0, angle: float = 0.0, noise: Array | None = None) -> SegmentData:
    """A segment as the diagnosis has it; `noise` (n, 2) is added to the readings in the stator frame."""
    c, s = math.cos(angle), math.sin(angle)
    to_stator = np.array([[c, s], [-s, c]])
    v_ab = requested.v_dq @ to_stator
    first = requested.v_dq.mean(axis=0) / R_S
    i_ab = response(requested.v_dq, first) @ to_stator + (0.0 if noise is None else noise)
    n, on = len(v_ab), requested.stage is not SegmentStage.GATES_OFF
    segment = Segment(
        id=f"{requested.stage.value}-{start_s:.4f}",
        stage=requested.stage,
        start_s=start_s,
        samples=n,
        rotor_angle_rad=angle,
        settings=dict(requested.settings),
    )
    signals = Signals(
        start_s=start_s,
        sampling_frequency_hz=FS,
        pwm_frequency_hz=FS,
        i_ab=i_ab,
        v_ab=v_ab,
        v_dc=np.full(n, 540.0),
        theta_rad=np.full(n, angle),
        resistance_ohm=np.ones(n),
        i_m_ab=i_ab,
        heat_j=np.zeros(n),
        motor=MOTOR,
        drive=DRIVE,
        bridge_on=on,
    )
    cutting = CRITERIA.weak_form
    windows = windows_of(segment, FS, i_ab, v_ab, cutting)
    assert windows is not None
    period = injection_period(segment, FS, v_ab) if requested.stage is SegmentStage.INJECTION else None
    return SegmentData(
        segment, requested.held_out, signals, windows, scatter_of(i_ab, period), 1, i_ab[0], i_ab, v_ab, 0.0
    )


def prepared(
    plans: Sequence[Plan], *, seed: int = 1, noise_a: float = NOISE_A, angle: float = 0.0
) -> PreparedRecording:
    """A campaign, its readings noisy."""
    rng = np.random.default_rng(seed)
    pieces, clock = [], 0.0
    for requested in plans:
        noise = rng.normal(0.0, noise_a, requested.v_dq.shape)
        pieces.append(piece(requested, start_s=clock, angle=angle, noise=noise))
        clock += len(requested.v_dq) / FS + 0.05
    segments = tuple(p.segment for p in pieces)
    manifest = Manifest(
        format="fluxbench-recording",
        version=1,
        name="on paper",
        created="2026-01-01T00:00:00Z",
        motor=MOTOR,
        drive=DRIVE,
        segments=segments,
    )
    return PreparedRecording(manifest, tuple(pieces), (), CRITERIA)


def with_voltage(made: PreparedRecording, change: Mapping[str, Array] | Array) -> PreparedRecording:
    """The same where a voltage (2,) was commanded that the machine never felt; or each piece's own, by id."""
    pieces = []
    for p in made.pieces:
        extra = change.get(p.segment.id, np.zeros(2)) if isinstance(change, Mapping) else change
        v_ab = p.signals.v_ab + (extra if p.signals.bridge_on else 0.0)
        pieces.append(replace(p, signals=replace(p.signals, v_ab=v_ab)))
    return replace(made, pieces=tuple(pieces))


def with_effects(made: PreparedRecording, active: Sequence[EffectTerm]) -> PreparedRecording:
    """The same where effects are accounted for in every piece's signals."""
    pieces = []
    for p in made.pieces:
        batch = apply_effects(SignalBatch.of([p.signals]), active).signals
        pieces.append(replace(p, signals=batch.segment(0)))
    return replace(made, pieces=tuple(pieces))


def timer(step_s: float, rise: float, fall: float, *, centred: bool = True, pwm_hz: float = FS) -> ModulatorTimer:
    phases = TimerPhases(pwm_frequency_hz=pwm_hz, rise=rise, fall=fall)
    return ModulatorTimer(step_s=step_s, centred=centred, phases=(phases,))


def felt_through(modulator: ModulatorTimer, plans: Sequence[Plan], *, noise_a: float = NOISE_A) -> PreparedRecording:
    """The readings of what a modulator's timer lets through, beside the voltages that were commanded."""
    (at,) = modulator.phases
    step_v = leg_step_of(modulator.step_s, FS, 540.0)

    def felt(v_dq: Array) -> Array:
        return v_dq + rounded_by(v_dq, step_v, at.rise, at.fall, centred=modulator.centred)

    let_through = [p if p.stage is SegmentStage.GATES_OFF else replace(p, v_dq=felt(p.v_dq)) for p in plans]
    made = prepared(let_through, noise_a=noise_a)
    pieces = []
    for piece, requested in zip(made.pieces, plans, strict=True):
        signals = replace(piece.signals, v_ab=requested.v_dq)
        pieces.append(replace(piece, signals=signals, command_ab=requested.v_dq))
    return replace(made, pieces=tuple(pieces))


def fitter(made: PreparedRecording) -> Fitter:
    return Fitter(made, sensor_noise(made.pieces), PM_WB)


def setup_of(maker: Fitter) -> DiagnosisSetup:
    """What a diagnosis has at hand, searching in the whole of a recording."""
    return DiagnosisSetup(maker.prepared, maker, maker, L_D, L_Q, 2.5, ())


def free_model() -> Model:
    """A free map on a small grid, started at the true one."""
    prior = smoothness_prior(GRID, math.sqrt(L_D * L_Q), 2.5, CRITERIA.fitting.roughness)
    return Model(MapSpace(GRID, np.zeros(GRID.size), np.eye(GRID.size), prior), TRUE_MAP, R_S)
