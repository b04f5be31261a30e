"""What a stage that nobody has measured yet would tell of two effects: predicted by the fitted model, decides nothing.

One effect, as it was fitted, makes an error a in the whitened equations of a stage; its rival is refitted to that,
together with R_s, the map and everything else that is free, to first order. What it cannot imitate is the separation,

    chi2 = min over x of |a - W x|^2 + priors,

of what there is and of what there would be with the stage. Currents of the stage are taken as given: steady, or the
ripple that the map's inductance makes of the injected voltage. Sensor noise is the recording's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.baseline import Start
from orchestrator.diagnosis.fitting.candidates import Active, Candidate
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.weak_form.segments import Piece, windows_of
from orchestrator.numerics.frames import to_ab
from orchestrator.numerics.types import Array
from protocols import ParameterRole, Segment, SegmentStage, Signals

_MOST_PIECES = 36
"""Of the recording, evenly spread: what is known already need not be known to the last digit."""
_LONGEST_S = 0.2
"""Of a hold: as long as it is the same all through, a part stands for the whole."""
_TURN_S = 0.1


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
    """

    model: Model
    absent: Active
    coordinates: Array
    known: Array


def rivals(start: Start, fit: Fit, first: str, second: Candidate) -> Rivals | None:
    """The two effects made comparable; None where the first is not in the model, or the second cannot imitate it."""
    own = next((a for a in fit.model.active if a.name == first), None)
    if own is None or second.name in fit.model.names:
        return None
    neutral = {n: own.candidate.named(n).neutral for n in own.candidate.amplitudes}
    absent = Active(own.candidate, {**own.values, **neutral}, own.candidate.amplitudes)
    coordinates = np.array([own.coordinate(n) for n in own.candidate.amplitudes])
    others = fit.model.with_active([a for a in fit.model.active if a.name != first])
    fitter = _part_of(start)
    trial = Rivals(others, absent, coordinates, np.zeros((0, 0)))
    rival = second.absent()
    normal = _normal(fitter, trial, fitter.prepared.pieces, [(rival, n) for n in second.amplitudes])
    found = _imitation(normal, len(coordinates), len(second.amplitudes), coordinates)
    for name, x in zip(second.amplitudes, found, strict=True):
        rival = rival.moved(name, float(x))
    if rival.is_absent:
        return None
    rival = rival.freeing(*second.of_role(ParameterRole.SHAPE))
    both = replace(trial, model=others.with_active([*others.active, rival]))
    return replace(both, known=_normal(fitter, both, fitter.prepared.pieces))


def separation(start: Start, pair: Rivals, stage: dict[str, Any]) -> float:
    """By how much chi2 between the two grows when the stage is measured."""
    fitter = replace(start.fitter, threads=1)
    more = np.zeros_like(pair.known)
    for piece, weight in planned_pieces(start, pair.model, stage):
        more += weight * _normal(fitter, pair, [piece], with_prior=False)
    return _left(pair.known + more, pair.coordinates) - _left(pair.known, pair.coordinates)


def _part_of(start: Start) -> Fitter:
    pieces = start.coarse.prepared.pieces
    stride = max(1, math.ceil(len(pieces) / _MOST_PIECES))
    prepared = replace(start.coarse.prepared, pieces=pieces[::stride])
    return replace(start.coarse, prepared=prepared, threads=1)


def _normal(
    fitter: Fitter,
    pair: Rivals,
    pieces: Sequence[Piece],
    more: Sequence[tuple[Active, str]] = (),
    *,
    with_prior: bool = True,
) -> Array:
    """W^T W of R_s, the map, what is free in the model, `more`, and the first effect's amplitudes, which come last."""
    space, model = pair.model.space, pair.model
    wanted = [*model.free, *more, *((pair.absent, n) for n in pair.absent.candidate.amplitudes)]
    # Planned segments have no ids of their own: what a fitter remembers of one must not serve the next.
    here = replace(fitter, prepared=replace(fitter.prepared, pieces=tuple(pieces)), _raw_basis={})
    frame = here.frame(model)
    width = 1 + space.directions.shape[1]
    total = np.zeros((width + len(wanted), width + len(wanted)))
    for piece, kept in zip(pieces, frame.pieces, strict=True):
        white = here._piece_rows(model, piece, kept, wanted).white
        rows = np.column_stack([white[:, 1], kept.white_basis, white[:, 2:]])
        total += rows.T @ rows
    if with_prior:
        total[1:width, 1:width] += space.prior.T @ space.prior
        free = np.arange(width, width + len(wanted) - len(pair.coordinates))
        total[free, free] += 1.0
    return total


def _imitation(normal: Array, own: int, rival: int, coordinates: Array) -> Array:
    """The rival's amplitudes that come nearest to the first effect."""
    inner, across = normal[:-own, :-own], normal[:-own, -own:]
    return np.asarray(np.linalg.solve(inner, across @ coordinates)[-rival:])


def _left(normal: Array, coordinates: Array) -> float:
    own = len(coordinates)
    inner, across = normal[:-own, :-own], normal[:-own, -own:]
    rest = normal[-own:, -own:] - across.T @ np.linalg.solve(inner, across)
    return float(coordinates @ rest @ coordinates)


def planned_pieces(start: Start, model: Model, stage: dict[str, Any]) -> list[tuple[Piece, float]]:
    """The segments that a stage would make, and how often each stands for its like."""
    kind = SegmentStage(stage["kind"])
    fs = start.prepared.manifest.drive.sampling_frequency_hz
    if kind is SegmentStage.GATES_OFF:
        still = np.zeros((round(_LONGEST_S * fs), 2))
        return [(_piece(start, model, kind, {}, still, still), stage["duration_s"] / _LONGEST_S)]
    found = []
    for point in stage["points_a"]:
        i_dq = np.array(point, dtype=np.float64)
        if kind is SegmentStage.RESISTANCE:
            current = np.tile(i_dq, (round(_LONGEST_S * fs), 1))
            for pwm in stage.get("pwm_frequencies_hz") or (None,):
                settings = {} if pwm is None else {"pwm_frequency_hz": pwm}
                piece = _piece(start, model, kind, settings, current, model.r_s * current)
                found.append((piece, stage["duration_s"] / _LONGEST_S))
        else:
            f = stage["frequency_hz"]
            for volts in stage["amplitudes_v"]:
                current, voltage = _ripple(model, i_dq, fs, f, volts)
                settings = {"frequency_hz": f, "rotation_hz": 1.0 / _TURN_S, "amplitude_v": volts}
                found.append((_piece(start, model, kind, settings, current, voltage), stage["duration_s"] / _TURN_S))
    return found


def _ripple(model: Model, i_dq: Array, fs: float, frequency_hz: float, volts: float) -> tuple[Array, Array]:
    """Current and voltage of one turn of a square wave at an operating point, dq."""
    t = np.arange(round(_TURN_S * fs)) / fs
    sign = np.where((t * frequency_hz + 1e-9) % 1.0 < 0.5, 1.0, -1.0)
    turn = 2 * math.pi * t / _TURN_S
    injected = volts * sign[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    flux = np.vstack([np.zeros(2), np.cumsum(injected, axis=0)[:-1]]) / fs
    period = max(1, round(fs / frequency_hz))
    mean = np.ones(period) / period
    padded = np.pad(flux, ((period, period), (0, 0)), mode="reflect")
    middle = np.stack([np.convolve(axis, mean, "same") for axis in padded.T])
    swing = flux - middle[:, period:-period].T
    l_dd, l_dq, l_qq = model.magnetics.flux_and_inductance(i_dq[None])[1][0]
    inverse = np.linalg.inv(np.array([[l_dd, l_dq], [l_dq, l_qq]]))
    current = i_dq + swing @ inverse.T
    return current, model.r_s * i_dq + injected


def _piece(
    start: Start, model: Model, kind: SegmentStage, settings: dict[str, Any], current: Array, voltage: Array
) -> Piece:
    """A segment after the last one of the recording, in the frame of that one."""
    last = start.prepared.pieces[-1]
    s, angle = last.signals, last.segment.rotor_angle_rad
    n, fs = len(current), start.prepared.manifest.drive.sampling_frequency_hz
    own_pwm = start.prepared.manifest.drive.pwm_frequency_hz or fs
    i_ab = to_ab(current, angle)
    v_ab = to_ab(voltage, angle)
    begin = s.start_s + len(s.v_dc) / s.sampling_frequency_hz + 1.0
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
        heat_j=np.full(n, float(s.heat_j[-1])),
        losses=s.losses,
        motor=s.motor,
        drive=s.drive,
        bridge_on=kind is not SegmentStage.GATES_OFF,
    )
    windows = windows_of(segment, fs, i_ab, v_ab, start.prepared.criteria.weak_form)
    assert windows is not None
    return replace(
        last, segment=segment, held_out=False, signals=signals, windows=windows, averaged=1, before_ab=i_ab[0]
    )
