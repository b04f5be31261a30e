"""The separation of two effects by a stage before it is measured, as the fitted model predicts it.

With the fitted effect in place of another one that imitates it, the whitened equations of a stage change by a. The
other effect is refitted to that change, together with R_s, the map and all other free parameters, to first order. The
remainder is the separation,

    chi2 = min over x of |a - W x|^2 + priors,

without and with the stage. The currents of the stage are given: steady, or the ripple that the map's inductance and
the injected voltage determine. Sensor noise is the recording's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.equations import WeakFormEquations
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import ColumnName, Fit, Model
from orchestrator.diagnosis.weak_form.batches import SegmentBatch, in_batches
from orchestrator.diagnosis.weak_form.segments import SegmentData, windows_of
from orchestrator.experiment_design.machine import Machine, current_of
from orchestrator.numerics.frames import to_ab
from orchestrator.numerics.types import Array
from protocols import Injection, LossHistory, ParameterRole, Segment, SegmentStage, Signals

MAX_SEGMENTS: int = 36
"""Segments of the recording, evenly spread, that enter a prediction: it needs no more precision."""
PLANNED_HOLD_S: float = 0.2
"""Length of a predicted hold [s]: the remainder is identical."""
PLANNED_TURN_S: float = 0.1
"""Length of a predicted turn of an injected direction [s]."""
COMMAND_ITERATIONS: int = 3
"""Fixed-point iterations from a planned segment's voltage to its command: each leaves a few percent of the error."""


@dataclass(frozen=True)
class ConfoundedPair:
    """Two effects that explain a recording equally well.

    Attributes
    ----------
    model : Model
        With the second effect in place of the first, at the amplitude that imitates it.
    first : Model
        With the first effect, the rest alike.
    known : array
        Normal matrix over the recording, as of `_normal`.
    answering : dict
        The effects that respond to each column of the recording's fit; to other columns all respond.
    """

    model: Model
    first: Model
    known: Array
    answering: Mapping[ColumnName, frozenset[str]]

    def responding(self, columns: Sequence[tuple[EffectTerm, str]]) -> list[frozenset[str] | None]:
        """The effects that respond to each column; None for all."""
        return [self.answering.get((active.name, name)) for active, name in columns]


def confounded_pair(
    setup: DiagnosisSetup, fit: Fit, first: EffectTerm, second: CandidateEffect
) -> ConfoundedPair | None:
    """The first effect and the second one fitted to imitate it; None where it cannot.

    The model may contain the first effect, but not the second.
    """
    model = fit.model
    if second.name in model.names:
        return None
    # The second takes the first's place, and may respond where the first did.
    answering = {column: effects | {second.name} for column, effects in fit.responses.of.items()}
    others = [a for a in model.active if a.name != first.name]
    with_first = model.with_active([*others, first])
    pieces = setup.part_fitter.prepared.pieces
    few = pieces[:: max(1, math.ceil(len(pieces) / MAX_SEGMENTS))]
    fitter = replace(setup.part_fitter, prepared=replace(setup.part_fitter.prepared, pieces=few))
    trial = ConfoundedPair(model.with_active(others), with_first, np.zeros((0, 0)), answering)
    rival = second.absent()
    normal = _normal(fitter, trial, few, [(rival, n) for n in second.amplitudes])
    # The second effect's amplitudes that come nearest to the first effect.
    amplitudes = np.linalg.solve(normal[:-1, :-1], normal[:-1, -1])[-len(second.amplitudes) :]
    for name, x in zip(second.amplitudes, amplitudes, strict=True):
        rival = rival.moved(name, float(x))
    if rival.is_absent:
        return None
    rival = rival.release(*second.of_role(ParameterRole.SHAPE))
    both = replace(trial, model=model.with_active([*others, rival]))
    return replace(both, known=_normal(fitter, both, few))


def separation(setup: DiagnosisSetup, pair: ConfoundedPair, stage: dict[str, Any]) -> float:
    """Growth of chi2 between the two effects when the stage is measured."""
    more = np.zeros_like(pair.known)
    for piece, weight in planned_pieces(setup, pair.model, stage):
        more += weight * _normal(_as_one_segment(setup.fitter, weight), pair, [piece], with_prior=False)
    return _remaining_chi2(pair.known + more) - _remaining_chi2(pair.known)


def _as_one_segment(fitter: Fitter, weight: float) -> Fitter:
    """The fitter whose model-error noise is common to the `weight` pieces of one segment, instead of each piece's own.

    A segment's mean has the variance s^2 + n^2 / w of that noise s and the readings' noise n of a piece; w pieces of a
    variance w s^2 + n^2 have the same information.
    """
    noise, factor = fitter.noise.of_model, math.sqrt(weight)
    update = {name: factor * getattr(noise, name) for name in ("offset_scatter_a", "voltage_scatter_v")}
    return fitter.with_noise(noise.model_copy(update=update))


def _normal(
    fitter: Fitter,
    pair: ConfoundedPair,
    pieces: Sequence[SegmentData],
    more: Sequence[tuple[EffectTerm, str]] = (),
    *,
    with_prior: bool = True,
) -> Array:
    """W^T W of R_s, the map, the model's free parameters, `more`, and last the change from the model to the first."""
    space, model = pair.model.space, pair.model
    wanted = [*model.free, *more]
    responding = pair.responding(wanted)
    equations = WeakFormEquations(fitter.noise, fitter.pm_flux_wb)
    width = 1 + space.directions.shape[1]
    total = np.zeros((width + len(wanted) + 1, width + len(wanted) + 1))
    for batch in in_batches(pieces).others:
        state = equations.relinearise(model, batch, None)
        swapped = equations.rows(equations.at(pair.first, state.linearisation))
        for rows_of, with_first, kept in zip(
            equations.rows(state, wanted, responding), swapped, state.linearisation.pieces, strict=True
        ):
            change = (with_first.white[:, :2] - rows_of.white[:, :2]) @ np.array([1.0, model.r_s])
            rows = np.column_stack([rows_of.white[:, 1], kept.white_basis, rows_of.white[:, 2:], change])
            total += rows.T @ rows
    if with_prior:
        total[1:width, 1:width] += space.prior.T @ space.prior
        free = np.arange(width, width + len(wanted))
        total[free, free] += 1.0
    return total


def _remaining_chi2(normal: Array) -> float:
    across = normal[:-1, -1]
    return float(normal[-1, -1] - across @ np.linalg.solve(normal[:-1, :-1], across))


def planned_pieces(setup: DiagnosisSetup, model: Model, stage: dict[str, Any]) -> list[tuple[SegmentData, float]]:
    """The segments of a stage, each with the number of segments that it represents."""
    kind, lasting = SegmentStage(stage["kind"]), float(stage["duration_s"])
    fs = setup.prepared.manifest.drive.sampling_frequency_hz
    still = np.zeros((round(PLANNED_HOLD_S * fs), 2))
    planned: list[tuple[SegmentData | None, float]] = []
    if kind is SegmentStage.GATES_OFF:
        planned.append((_piece(setup, kind, {}, still, still, lasting), lasting / PLANNED_HOLD_S))
    machine = Machine(setup.prepared.manifest.motor, model.r_s, model.magnetics)
    for point in stage.get("points_a", ()):
        i_dq = np.array(point, dtype=np.float64)
        if kind is SegmentStage.RESISTANCE:
            current = still + i_dq
            for pwm in stage.get("pwm_frequencies_hz") or (None,):
                settings = {} if pwm is None else {"pwm_frequency_hz": pwm}
                piece = _piece(setup, kind, settings, current, model.r_s * current, lasting)
                planned.append((piece, lasting / PLANNED_HOLD_S))
        else:
            f, turn_s = stage["frequency_hz"], PLANNED_TURN_S
            for volts in stage["amplitudes_v"]:
                injection = Injection(
                    target_d_a=point[0],
                    target_q_a=point[1],
                    settle_s=1.0,
                    duration_s=turn_s,
                    amplitude_v=volts,
                    frequency_hz=f,
                    rotation_hz=1.0 / turn_s,
                )
                swinging = current_of(injection, machine, np.arange(round(turn_s * fs) + 1) / fs)
                current, voltage = swinging[:-1], machine.voltage(swinging, fs)
                settings = {"frequency_hz": f, "rotation_hz": 1.0 / turn_s, "amplitude_v": volts}
                planned.append((_piece(setup, kind, settings, current, voltage, lasting), lasting / turn_s))
    found = [(piece, weight) for piece, weight in planned if piece is not None]
    if kind is SegmentStage.GATES_OFF or not found:
        return found
    commanded = _as_commanded(setup.fitter, model, [piece for piece, _ in found])
    return [(piece, weight) for piece, (_, weight) in zip(commanded, found, strict=True)]


def _as_commanded(fitter: Fitter, model: Model, pieces: Sequence[SegmentData]) -> list[SegmentData]:
    """Segments whose voltage at the terminals is given, with the commands that the drive would log instead.

    A command is what the model's effects correct to that voltage, the winding's change of resistance included. Two
    effects that act alike on the recording would seem to differ wherever a plan lacks the losses that both see there.
    """
    equations = WeakFormEquations(fitter.noise, fitter.pm_flux_wb)
    given = np.concatenate([piece.signals.v_ab for piece in pieces])
    for _ in range(COMMAND_ITERATIONS):
        corrected = equations.relinearise(model, SegmentBatch.of(pieces), None).cascade.corrected
        warmed = (corrected.resistance_ohm - model.r_s)[:, None] * corrected.i_ab
        missing = np.split(given + warmed - corrected.v_ab, corrected.starts[1:-1])
        pieces = [
            replace(piece, signals=replace(piece.signals, v_ab=piece.signals.v_ab + more))
            for piece, more in zip(pieces, missing, strict=True)
        ]
    return list(pieces)


def _piece(
    setup: DiagnosisSetup,
    kind: SegmentStage,
    settings: dict[str, Any],
    current: Array,
    voltage: Array,
    lasting_s: float,
) -> SegmentData | None:
    """A segment after the recording's last, in its frame, with the heat at mid-time; None with too few readings."""
    last = setup.prepared.pieces[-1]
    s, angle = last.signals, last.segment.rotor_angle_rad
    n, fs = len(current), setup.prepared.manifest.drive.sampling_frequency_hz
    own_pwm = setup.prepared.manifest.drive.pwm_frequency_hz or fs
    i_ab = to_ab(current, angle)
    v_ab = to_ab(voltage, angle)
    end = s.start_s + len(s.v_dc) / s.sampling_frequency_hz + 1.0
    power = 1.5 * ((s.motor and s.motor.stator_resistance_ohm) or 1.0) * float(np.mean(np.sum(current**2, axis=1)))
    begin = end + 0.5 * lasting_s
    losses = s.losses
    if losses is not None:
        heated = max(end, float(losses.time_s[-1]))
        time_s = np.append(losses.time_s, [heated, heated + lasting_s])
        losses = LossHistory(time_s=time_s, power_w=np.append(losses.power_w, [power, 0.0]))
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
        losses=losses,
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
