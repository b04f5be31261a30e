"""Excerpts of waveforms for figures: measured and simulated current in ripple and trapezoid, and flux loops.

Segments are chosen by the recording alone, so that all steps of a ladder show the same ones.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.simulation import simulated_current
from orchestrator.diagnosis.selection.contrasts import MIN_AMPLITUDE_RATIO
from orchestrator.diagnosis.weak_form.equations import true_frame
from orchestrator.diagnosis.weak_form.segments import AXES, Axis, SegmentData, swept_axis
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.types import Array
from protocols import CurrentExcerpt, FluxLoop, SegmentStage, SignalBatch

MAX_POINTS: int = 400
"""Maximum number of points of one curve."""
RIPPLE_PERIODS: int = 2
"""Number of injection periods shown."""
MAX_TRAPEZOID_S: float = 2.5
"""Longest part of a sweep shown [s]."""
SIMULATION_SETTLING_S: float = 0.1
"""Simulated time before a ripple is shown [s]: the first current is a noisy sample."""


def excerpts(fit: Fit) -> tuple[CurrentExcerpt, ...]:
    """Ripple at one injection point, at two amplitudes where there are two, and one period of a trapezoid."""
    pieces = fit.prepared.pieces
    ripples = (_ripple_excerpt(fit, k) for k in ripple_pair(pieces, MIN_AMPLITUDE_RATIO))
    trapezoid = (_trapezoid_excerpt(fit, k) for k in _trapezoid(pieces))
    return tuple(e for e in itertools.chain(ripples, trapezoid) if e is not None)


def flux_loops(fit: Fit) -> tuple[FluxLoop, ...]:
    """The last period of one sweep on each axis, and of one on both: the one with the least current held."""
    best: dict[Axis, tuple[float, int]] = {}
    for k, piece in enumerate(fit.prepared.pieces):
        if piece.stage is not SegmentStage.CLASSICAL:
            continue
        axis, held = _swept(piece)
        if axis not in best or held < best[axis][0]:
            best[axis] = (held, k)
    return tuple(_loop(fit, best[axis][1], axis) for axis in AXES if axis in best)


def ripple_pair(pieces: Sequence[SegmentData], ratio: float) -> tuple[int, ...]:
    """Two injection segments at one point whose amplitudes differ by a ratio, smaller first; or one; or none."""
    points = [k for k, p in enumerate(pieces) if p.stage is SegmentStage.INJECTION]
    if not points:
        return ()
    current = np.array([_mean_current(pieces[k]) for k in points])
    volts = np.array([_amplitude(pieces[k]) for k in points])
    from_zero = np.linalg.norm(current, axis=1)
    reach = float(from_zero.max()) or 1.0
    distances = np.linalg.norm(current[:, None] - current, axis=2)
    is_pair = (volts > ratio * volts[:, None]) & (volts[:, None] > 0.0) & (distances < 0.15 * reach)
    if not is_pair.any():
        return (points[int(np.argmin(from_zero))],)
    # Distances below a hundredth of the range are equal; among those, the point nearest zero is chosen.
    merit = np.round(100.0 * distances / reach) + 0.5 * from_zero[:, None] / reach
    small, large = np.unravel_index(int(np.argmin(np.where(is_pair, merit, np.inf))), merit.shape)
    return points[int(small)], points[int(large)]


def _mean_current(piece: SegmentData) -> Array:
    return np.asarray(to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad).mean(axis=0))


def _amplitude(piece: SegmentData) -> float:
    """Amplitude of the injected voltage [V]: the set point, else the rms of its vector about the mean."""
    requested = piece.segment.settings.get("amplitude_v")
    if isinstance(requested, int | float) and requested > 0:
        return float(requested)
    return float(np.linalg.norm(np.std(piece.signals.v_ab, axis=0)))


def _ripple_excerpt(fit: Fit, index: int) -> CurrentExcerpt | None:
    """A few periods from an edge of injection along +d, so that two amplitudes are in phase."""
    piece = fit.prepared.pieces[index]
    fs, n = piece.signals.sampling_frequency_hz, len(piece.signals.v_dc)
    if piece.segment.settings.get("frequency_hz") is None or not (period := piece.windows.period):
        return None
    shown = math.ceil(RIPPLE_PERIODS * period) + 1
    settled = round(SIMULATION_SETTLING_S * fs)
    turn = round(fs / float(piece.segment.settings.get("rotation_hz") or 1.0))
    stop = min(n, settled + turn + shown)
    if stop < settled + 2 * shown:
        return None
    v_d = to_dq(piece.signals.v_ab[:stop], piece.segment.rotor_angle_rad)[:, 0]
    first = settled + _push(v_d[settled:], round(period / 2), shown)
    predicted, measured = _currents(fit, index, first + shown)
    return _excerpt(piece, measured[first:], predicted[first:], 1, _amplitude(piece))


def _push(v: Array, half: int, shown: int) -> int:
    """Index where v is high for half a period and low for the next with the largest difference."""
    total = np.concatenate([[0.0], np.cumsum(v)])
    count = max(len(v) - max(shown, 2 * half), 1)
    k = np.arange(count)
    return int(np.argmax(2.0 * total[k + half] - total[k] - total[k + 2 * half]))


def _trapezoid(pieces: Sequence[SegmentData]) -> Iterator[int]:
    """A held-out sweep where there is one, else the first."""
    sweeps = [k for k, p in enumerate(pieces) if p.stage is SegmentStage.CLASSICAL]
    yield from sorted(sweeps, key=lambda k: (not pieces[k].held_out, k))[:1]


def _trapezoid_excerpt(fit: Fit, index: int) -> CurrentExcerpt:
    """The second period where there is one, as the first may start elsewhere."""
    piece = fit.prepared.pieces[index]
    shown = min(_period(piece), _samples(piece, MAX_TRAPEZOID_S))
    first = shown - 1 if 2 * shown - 1 <= len(piece.signals.v_dc) else 0
    predicted, measured = _currents(fit, index, first + shown)
    stride = math.ceil(shown / MAX_POINTS)
    return _excerpt(piece, measured[first:], predicted[first:], stride, None)


def _excerpt(
    piece: SegmentData, measured: Array, predicted: Array, stride: int, amplitude: float | None
) -> CurrentExcerpt:
    i_d, i_q = measured.mean(axis=0)
    return CurrentExcerpt(
        segment=piece.segment.id,
        stage=piece.stage.value,
        i_d_a=float(i_d),
        i_q_a=float(i_q),
        amplitude_v=amplitude,
        time_s=np.arange(len(measured))[::stride] / piece.signals.sampling_frequency_hz,
        measured_a=np.ascontiguousarray(measured[::stride]),
        predicted_a=np.ascontiguousarray(predicted[::stride]),
    )


def _currents(fit: Fit, index: int, samples: int) -> tuple[Array, Array]:
    """Predicted and measured current in the believed frame, (samples, 2) each."""
    # The magnetising current's error, in the true frame, is rotated back and added to the measured current.
    piece = fit.prepared.pieces[index]
    predicted, corrected = simulated_current(fit, index, samples)
    batch, _ = fit.linearisation.base_of(index)
    _, delta = true_frame(batch, fit.corrected(index))
    measured = to_dq(piece.signals.i_ab[: len(predicted)], piece.segment.rotor_angle_rad)
    return measured + _believed(predicted - corrected, delta), measured


def _believed(x_dq: Array, delta: Array) -> Array:
    """From the true frame to the believed one; `delta` is empty where they are the same."""
    return to_ab(x_dq, delta[: len(x_dq)]) if delta.size else x_dq


def _loop(fit: Fit, index: int, axis: Axis) -> FluxLoop:
    """Flux over one period in the believed frame: corrected int (v - R i) dt, and psi(i)."""
    piece = fit.prepared.pieces[index]
    corrected = fit.corrected(index)
    ts = 1.0 / piece.signals.sampling_frequency_hz
    batch, base = fit.linearisation.base_of(index)
    i_true, delta = true_frame(batch, corrected)
    last = slice(len(i_true) - _period(piece), len(i_true))
    magnet = np.array([_magnet_wb(piece), 0.0])
    psi, _ = fit.model.magnetics.flux_and_inductance(i_true[last])
    model = _believed(psi + magnet, delta[last])
    measured = _integral(corrected, fit.model.r_s / float(base.resistance_ohm[0]), last, ts)
    measured = to_dq(measured, piece.segment.rotor_angle_rad)
    i_dq = to_dq(piece.signals.i_ab[last], piece.segment.rotor_angle_rad)
    stride = math.ceil(len(i_dq) / MAX_POINTS)
    return FluxLoop(
        segment=piece.segment.id,
        swept_axis=axis,
        i_dq=np.ascontiguousarray(i_dq[::stride]),
        psi_measured=np.ascontiguousarray(measured[::stride]),
        psi_model=np.ascontiguousarray((model - model[0])[::stride]),
        noise_wb=_integrated_noise_wb(fit, piece, 0.5 * ts * len(i_dq)),
    )


def _integrated_noise_wb(fit: Fit, piece: SegmentData, time_s: float) -> float:
    """Standard deviation of R_s int i dt by the noise of the readings alone: a random walk."""
    noise, ts = fit.linearisation.noise, 1.0 / piece.signals.sampling_frequency_hz
    variance = 0.5 * np.trace(noise.of(piece)) * (1.0 + noise.correlation) / (1.0 - noise.correlation)
    return float(fit.model.r_s * np.sqrt(variance * ts * time_s))


def _magnet_wb(piece: SegmentData) -> float:
    """The magnet's flux by the nameplate, 0 where unknown [Wb]."""
    motor = piece.signals.motor
    return (motor.pm_flux_wb if motor is not None else None) or 0.0


def _integral(signals: SignalBatch, factor: float, part: slice, ts: float) -> Array:
    """int (v - R i) dt from the part's first sample on, stator frame, shape (n, 2) [Wb]."""
    drop = (factor * signals.resistance_ohm[part, None]) * signals.i_ab[part]
    steps = ts * (signals.v_ab[part][:-1] - 0.5 * (drop[1:] + drop[:-1]))
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def _swept(piece: SegmentData) -> tuple[Axis, float]:
    """The axis that a sweep moves, and the magnitude of the constant current on the other."""
    axis = swept_axis(piece.segment, piece.signals.i_ab)
    i_d, i_q = np.abs(_mean_current(piece))
    return axis, {"d": float(i_q), "q": float(i_d), "dq": 0.0}[axis]


def _period(piece: SegmentData) -> int:
    """Samples in a period of a sweep; all samples where the period is unknown."""
    period = piece.segment.settings.get("period_s")
    requested = float(period) if isinstance(period, int | float) and period > 0 else math.inf
    return _samples(piece, requested)


def _samples(piece: SegmentData, seconds: float) -> int:
    n = len(piece.signals.v_dc)
    return n if math.isinf(seconds) else min(n, round(seconds * piece.signals.sampling_frequency_hz) + 1)
