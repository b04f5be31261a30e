"""What a stage that nobody has measured yet would tell of two effects: predicted by the fitted model, decides nothing.

One effect, as it was fitted, makes an error a in the whitened equations of a stage; its rival is refitted to that,
together with R_s, the map and everything else that is free, to first order. What it cannot imitate is the separation,

    chi2 = min over x of |a - W x|^2 + priors,

of what there is and of what there would be with the stage. Currents of the stage are taken as given: steady, or the
ripple that the map's inductance makes of the injected voltage. Sensor noise is the recording's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Active, Candidate
from orchestrator.diagnosis.fitting.equations import WeakFormEquations
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import ColumnName, Fit, Model
from orchestrator.diagnosis.weak_form.batches import in_batches
from orchestrator.diagnosis.weak_form.segments import SegmentSignals, windows_of
from orchestrator.experiment_design.machine import Machine, current_of
from orchestrator.numerics.frames import to_ab
from orchestrator.numerics.types import Array
from protocols import Injection, LossHistory, ParameterRole, Segment, SegmentStage, Signals

MAX_SEGMENTS: int = 36
"""Segments of the recording, evenly spread, that predict: present knowledge is not needed to the last digit."""
PLANNED_HOLD_S: float = 0.2
"""Length of a predicted hold [s]: a part stands for the whole of what stays the same."""
PLANNED_TURN_S: float = 0.1
"""Length of a predicted turn of an injected direction [s]."""


@dataclass(frozen=True)
class Rivals:
    """Two effects that do equally well in a recording.

    Attributes
    ----------
    model : Model
        With the second in the place of the first, as strong as it takes to imitate it.
    absent : Active
        The first, its amplitudes neutral and its shape as fitted.
    coordinates : array
        Of the first's amplitudes.
    known : array
        Normal matrix of all columns over the recording.
    answering : dict
        Of columns of the recording's fit, the effects that answer to them; of others all are asked.
    """

    model: Model
    absent: Active
    coordinates: Array
    known: Array
    answering: Mapping[ColumnName, frozenset[str]]

    def asked_of(self, columns: Sequence[tuple[Active, str]]) -> list[frozenset[str] | None]:
        """The effects that are asked of each column; None for all."""
        return [self.answering.get((active.name, name)) for active, name in columns]


def rivals(setup: DiagnosisSetup, fit: Fit, first: Active, second: Candidate) -> Rivals | None:
    """Two effects made comparable, the first as it is given; None where the second cannot imitate it.

    In the model the first may be, but the second is not to be.
    """
    model = fit.model
    if second.name in model.names:
        return None
    # The second takes the first's place, and may answer as the first did.
    answering = {column: effects | {second.name} for column, effects in fit.answers.of.items()}
    neutral = {n: first.candidate.named(n).neutral for n in first.candidate.amplitudes}
    absent = Active(first.candidate, {**first.values, **neutral}, first.candidate.amplitudes)
    coordinates = np.array([first.coordinate(n) for n in first.candidate.amplitudes])
    others = model.with_active([a for a in model.active if a.name != first.name])
    fitter = _part_of(setup)
    trial = Rivals(others, absent, coordinates, np.zeros((0, 0)), answering)
    rival = second.absent()
    normal = _normal(fitter, trial, fitter.prepared.pieces, [(rival, n) for n in second.amplitudes])
    amplitudes = _imitation(normal, len(coordinates), len(second.amplitudes), coordinates)
    for name, x in zip(second.amplitudes, amplitudes, strict=True):
        rival = rival.moved(name, float(x))
    if rival.is_absent:
        return None
    rival = rival.freeing(*second.of_role(ParameterRole.SHAPE))
    both = replace(trial, model=others.with_active([*others.active, rival]))
    return replace(both, known=_normal(fitter, both, fitter.prepared.pieces))


def separation(setup: DiagnosisSetup, pair: Rivals, stage: dict[str, Any]) -> float:
    """By how much chi2 between the two grows when the stage is measured."""
    more = np.zeros_like(pair.known)
    for piece, weight in planned_pieces(setup, pair.model, stage):
        more += weight * _normal(setup.fitter, pair, [piece], with_prior=False)
    return _left(pair.known + more, pair.coordinates) - _left(pair.known, pair.coordinates)


def _part_of(setup: DiagnosisSetup) -> Fitter:
    pieces = setup.coarse_fitter.prepared.pieces
    stride = max(1, math.ceil(len(pieces) / MAX_SEGMENTS))
    prepared = replace(setup.coarse_fitter.prepared, pieces=pieces[::stride])
    return replace(setup.coarse_fitter, prepared=prepared)


def _normal(
    fitter: Fitter,
    pair: Rivals,
    pieces: Sequence[SegmentSignals],
    more: Sequence[tuple[Active, str]] = (),
    *,
    with_prior: bool = True,
) -> Array:
    """W^T W of R_s, the map, what is free in the model, `more`, and the first effect's amplitudes, which come last."""
    space, model = pair.model.space, pair.model
    wanted = [*model.free, *more, *((pair.absent, n) for n in pair.absent.candidate.amplitudes)]
    asked = pair.asked_of(wanted)
    equations = WeakFormEquations(fitter.noise, fitter.pm_flux_wb, fitter.prepared.criteria)
    width = 1 + space.directions.shape[1]
    total = np.zeros((width + len(wanted), width + len(wanted)))
    for batch in in_batches(pieces)[1]:
        state = equations.renewed(model, batch, None)
        for made, kept in zip(equations.rows(state, wanted, asked), state.frame.pieces, strict=True):
            rows = np.column_stack([made.white[:, 1], kept.white_basis, made.white[:, 2:]])
            total += rows.T @ rows
    if with_prior:
        total[1:width, 1:width] += space.prior.T @ space.prior
        free = np.arange(width, width + len(wanted) - len(pair.coordinates))
        total[free, free] += 1.0
    return total


def _imitation(normal: Array, imitated: int, rival: int, coordinates: Array) -> Array:
    """The rival's amplitudes that come nearest to the first effect."""
    inner, across = normal[:-imitated, :-imitated], normal[:-imitated, -imitated:]
    return np.asarray(np.linalg.solve(inner, across @ coordinates)[-rival:])


def _left(normal: Array, coordinates: Array) -> float:
    imitated = len(coordinates)
    inner, across = normal[:-imitated, :-imitated], normal[:-imitated, -imitated:]
    rest = normal[-imitated:, -imitated:] - across.T @ np.linalg.solve(inner, across)
    return float(coordinates @ rest @ coordinates)


def planned_pieces(setup: DiagnosisSetup, model: Model, stage: dict[str, Any]) -> list[tuple[SegmentSignals, float]]:
    """The segments that a stage would make, and how often each stands for its like."""
    kind, lasting = SegmentStage(stage["kind"]), float(stage["duration_s"])
    fs = setup.prepared.manifest.drive.sampling_frequency_hz
    still = np.zeros((round(PLANNED_HOLD_S * fs), 2))
    if kind is SegmentStage.GATES_OFF:
        off = _piece(setup, model, kind, {}, still, still, lasting)
        return [] if off is None else [(off, lasting / PLANNED_HOLD_S)]
    planned: list[tuple[SegmentSignals | None, float]] = []
    machine = Machine(setup.prepared.manifest.motor, model.r_s, model.magnetics)
    for point in stage["points_a"]:
        i_dq = np.array(point, dtype=np.float64)
        if kind is SegmentStage.RESISTANCE:
            current = still + i_dq
            for pwm in stage.get("pwm_frequencies_hz") or (None,):
                settings = {} if pwm is None else {"pwm_frequency_hz": pwm}
                piece = _piece(setup, model, kind, settings, current, model.r_s * current, lasting)
                planned.append((piece, lasting / PLANNED_HOLD_S))
        else:
            f, turn_s = stage["frequency_hz"], PLANNED_TURN_S
            for volts in stage["amplitudes_v"]:
                asked = Injection(
                    target_d_a=point[0],
                    target_q_a=point[1],
                    settle_s=1.0,
                    duration_s=turn_s,
                    amplitude_v=volts,
                    frequency_hz=f,
                    rotation_hz=1.0 / turn_s,
                )
                swinging = current_of(asked, machine, np.arange(round(turn_s * fs) + 1) / fs)
                current, voltage = swinging[:-1], machine.voltage(swinging, fs)
                settings = {"frequency_hz": f, "rotation_hz": 1.0 / turn_s, "amplitude_v": volts}
                planned.append((_piece(setup, model, kind, settings, current, voltage, lasting), lasting / turn_s))
    return [(piece, weight) for piece, weight in planned if piece is not None]


def _piece(
    setup: DiagnosisSetup,
    model: Model,
    kind: SegmentStage,
    settings: dict[str, Any],
    current: Array,
    voltage: Array,
    lasting_s: float,
) -> SegmentSignals | None:
    """A segment after the last one of the recording, in the frame of that one, as it is in the middle of its time.

    None where there are too few readings in it to tell anything.
    """
    last = setup.prepared.pieces[-1]
    s, angle = last.signals, last.segment.rotor_angle_rad
    n, fs = len(current), setup.prepared.manifest.drive.sampling_frequency_hz
    own_pwm = setup.prepared.manifest.drive.pwm_frequency_hz or fs
    i_ab = to_ab(current, angle)
    v_ab = to_ab(voltage, angle)
    end = s.start_s + len(s.v_dc) / s.sampling_frequency_hz + 1.0
    power = 1.5 * ((s.motor and s.motor.stator_resistance_ohm) or 1.0) * float(np.mean(np.sum(current**2, axis=1)))
    begin = end + 0.5 * lasting_s
    segment = Segment(
        id=f"planned-{kind.value}", stage=kind, start_s=begin, samples=n, rotor_angle_rad=angle, settings=settings
    )
    signals = Signals(
        start_s=begin,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=settings.get("pwm_frequency_hz", own_pwm),
        i_ab=i_ab,
        v_ab=v_ab,
        v_dc=np.full(n, float(np.mean(s.v_dc))),
        theta_rad=np.full(n, angle),
        resistance_ohm=np.ones(n),
        i_m_ab=i_ab,
        heat_j=np.full(n, float(s.heat_j[-1]) + 0.5 * lasting_s * power),
        losses=s.losses and _lasting(s.losses, end, lasting_s, power),
        motor=s.motor,
        drive=s.drive,
        bridge_on=kind is not SegmentStage.GATES_OFF,
        clarke_of_three=s.clarke_of_three,
    )
    windows = windows_of(segment, fs, i_ab, v_ab, setup.prepared.criteria.weak_form)
    if windows is None:
        return None
    return replace(
        last, segment=segment, held_out=False, signals=signals, windows=windows, averaged=1, before_ab=i_ab[0]
    )


def _lasting(losses: LossHistory, begin_s: float, lasting_s: float, power_w: float) -> LossHistory:
    """The loss so far, and what a planned segment adds to it."""
    begin = max(begin_s, float(losses.time_s[-1]))
    time = np.append(losses.time_s, [begin, begin + lasting_s])
    return LossHistory(time_s=time, power_w=np.append(losses.power_w, [power_w, 0.0]))
