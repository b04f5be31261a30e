"""The current's response to the voltage: resistance at rest, impulse response under injection.

Under injection, with u the ripple of the voltage and n the declared delay,

    i_k+1 - i_k = sum_j h_j u_k-n-j - r i_k

is fitted to all segments at once, h real and over lags before and after the declared delay: L is Ts / sum h along the
mean axis, and the first nonzero h shows when the voltage acts. Of voltage steps the differences are fitted, at edges
alone: between edges the voltage is a controller's reaction to noise, and r would be of that noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.survey import (
    MAX_CONDITION_NUMBER,
    MIN_CURRENT_FRACTION,
    MIN_EDGE_FRACTION,
    MIN_SAMPLES,
    MIN_SEGMENTS,
    SegmentReadings,
    Survey,
    Vectors,
    parts,
)
from orchestrator.recording_checks.vector_maps import AXES, IDENTITY, VectorMap
from protocols import SegmentStage

MAX_LAG_SAMPLES = 3
"""Samples before and after the declared delay that the impulse response covers."""


@dataclass(frozen=True)
class SteadyState:
    """Mean currents and voltages of holds and injections: v = a i + b conj(i) + a part independent of the amplitude.

    Attributes
    ----------
    i, v : complex arrays, shape (n,)
    whole_plane : bool
        False where the currents lie on a line: b is then taken for nil.
    """

    i: Vectors
    v: Vectors
    whole_plane: bool

    def impedance(self, i_map: VectorMap = IDENTITY, v_map: VectorMap = IDENTITY) -> tuple[complex, complex]:
        """a and b [ohm], with the readings mapped first: R_s and zero in a motor."""
        i, v = i_map(self.i), v_map(self.v)
        columns = [i, np.conj(i), np.ones(len(i)), _current_signs(i)]
        if not self.whole_plane:
            del columns[1]
        real = np.concatenate([np.stack([c, 1j * c], axis=1) for c in columns], axis=1)
        coefficients = _least_absolute_deviations(real, v).reshape(-1, 2) @ [1.0, 1j]
        return complex(coefficients[0]), complex(coefficients[1]) if self.whole_plane else 0j


def _least_absolute_deviations(columns: Vectors, target: Vectors, rounds: int = 12) -> Array:
    """Real numbers x (m,) that minimise the sum of |columns @ x - target|, so that one outlying hold counts little."""
    # By iteratively reweighted least squares (P. J. Huber, Robust Statistics, Wiley 1981, ch. 7).
    weight = np.ones(len(target))
    solution = np.zeros(columns.shape[1])
    for _ in range(rounds):
        weighted = weight[:, None] * columns, weight * target
        rows, right_side = (np.concatenate([x.real, x.imag]) for x in weighted)
        solution = np.linalg.lstsq(rows, right_side, rcond=1e-9)[0]
        residual = np.abs(columns @ solution - target)
        floor = max(float(np.median(residual)), 1e-9 * float(np.abs(target).max()), 1e-300)
        weight = 1.0 / np.sqrt(np.maximum(residual, floor))
    return solution


def _current_signs(i: Vectors) -> Vectors:
    """Vectors of the phase currents' signs, along which an inverter's dead time and drops act."""
    phases = np.real(i[:, None] * np.conj(AXES))
    knee = 0.02 * np.abs(i).max()
    return np.asarray(np.tanh(phases / max(knee, 1e-300)) @ AXES * (2.0 / 3.0))


def steady_state(survey: Survey) -> SteadyState | None:
    """Means of holds and injections with enough current; None where there are too few."""
    means = [(s.mean_i, s.mean_v) for s in (*survey.holds, *survey.injections)]
    i, v = (np.array(x, dtype=np.complex128) for x in (zip(*means, strict=True) if means else ((), ())))
    if not np.any(i):
        return None
    max_current = np.abs(i).max()
    large = np.abs(i) > MIN_CURRENT_FRACTION * max_current
    i, v = i[large], v[large]
    if len(i) < MIN_SEGMENTS:
        return None
    width = float(np.linalg.svd(parts(i), compute_uv=False).min())
    return SteadyState(i, v, width > MIN_CURRENT_FRACTION * max_current)


@dataclass(frozen=True)
class ImpulseResponse:
    """The current's impulse response to the voltage under injection.

    Attributes
    ----------
    lags : array, shape (m,)
        Samples after the declared delay.
    weights : array, shape (m,)
        h_j [A/V], and their standard deviations.
    deviations : array, shape (m,)
    l_h : float
        Inductance of the mean of 1/L over both axes, from the steps of the current.
    """

    lags: Array
    weights: Array
    deviations: Array
    l_h: float


def impulse_response(
    survey: Survey, injections: Sequence[SegmentReadings], max_lag: int = MAX_LAG_SAMPLES
) -> ImpulseResponse | None:
    """The impulse response of some injections; None where it cannot be identified.

    A wave separates as many lags as half its period has samples, a sine two: lags are dropped until the rest separate.

    Parameters
    ----------
    max_lag : int
        Samples before and after the declared delay.
    """
    for lag in range(max_lag, -1, -1):
        response = _fit_response(survey, injections, np.arange(-lag, lag + 1, dtype=np.int64))
        if response is not None:
            return response
    return None


def _fit_response(
    survey: Survey, injections: Sequence[SegmentReadings], lags: NDArray[np.int64]
) -> ImpulseResponse | None:
    declared = math.floor(survey.manifest.drive.voltage_delay_samples or 0.0)
    by_steps = any(seen.segment.stage is SegmentStage.STEPS for seen in injections)
    width = len(lags) if by_steps else len(lags) + 1
    moments, right = np.zeros((width, width)), np.zeros(width)
    power, count = 0.0, 0
    for seen in injections:
        columns, steps = _columns(seen, declared, lags, MIN_EDGE_FRACTION)
        if steps is None:
            continue
        moments += columns @ columns.T
        right += columns @ steps
        power += float(steps @ steps)
        count += len(steps)
    size = np.sqrt(np.diag(moments))
    if count < MIN_SAMPLES or not np.all(size > 0.0):
        return None
    correlation = moments / np.outer(size, size)
    if np.linalg.cond(correlation) > MAX_CONDITION_NUMBER:
        return None
    inverse = np.linalg.inv(correlation) / np.outer(size, size)
    solution = inverse @ right
    variance = max(power - float(solution @ right), 0.0) / count
    weights = solution[: len(lags)]
    if by_steps:
        # Saturating iron curves the current between edges, equally at all lags.
        weights = weights - np.median(weights)
    total = float(weights.sum())
    if total == 0.0:
        return None
    deviations = np.sqrt(np.maximum(np.diag(inverse) * variance, 0.0))[: len(lags)]
    return ImpulseResponse(lags.astype(np.float64), weights, deviations, 1.0 / (survey.sampling_frequency_hz * total))


def _columns(seen: SegmentReadings, declared: int, lags: NDArray[np.int64], edge: float) -> tuple[Array, Array | None]:
    """Rows of alpha, then beta: u at each lag, and i; of steps, the edges (from `edge` of the largest) at each lag."""
    n, u, i = len(seen.i), seen.ripple_v, seen.i - seen.i.mean()
    first, last = int(declared + lags[-1]), int(n - 1 + min(declared + lags[0], 0))
    if last - first < 50:
        return np.empty((len(lags) + 1, 0)), None
    rows, by_steps = slice(first, last), seen.segment.stage is SegmentStage.STEPS
    if by_steps:
        u = np.diff(u, append=u[-1])
        u[np.abs(u) < edge * np.abs(u).max()] = 0.0
    columns = [u[first - declared - int(lag) : last - declared - int(lag)] for lag in lags]
    steps = np.diff(i)[rows]
    if by_steps:
        columns, steps = [c[:-1] for c in columns], np.diff(steps)
    else:
        columns.append(i[rows])
    return np.stack([parts(c).ravel() for c in columns]), parts(steps).ravel()


class Responses:
    """A survey and the motor's responses in it, each computed on first use."""

    def __init__(self, survey: Survey) -> None:
        self.survey = survey

    @cached_property
    def steady_state(self) -> SteadyState | None:
        return steady_state(self.survey)

    @cached_property
    def impulse_response(self) -> ImpulseResponse | None:
        return impulse_response(self.survey, self.survey.injections or self.survey.of(SegmentStage.STEPS))

    @cached_property
    def resistance_ohm(self) -> float | None:
        return None if self.steady_state is None else self.steady_state.impedance()[0].real

    @cached_property
    def resistive_part(self) -> float:
        """Part of the voltage at rest that is R_s i; the inverter's losses are the remainder."""
        if self.steady_state is None or self.resistance_ohm is None:
            return 0.0
        v = float(np.linalg.norm(self.steady_state.v))
        return abs(self.resistance_ohm) * float(np.linalg.norm(self.steady_state.i)) / v if v > 0.0 else 0.0

    @cached_property
    def resistance_ratio(self) -> float | None:
        """R_s over the nameplate's; None where either is unknown."""
        return _ratio(self.resistance_ohm, self.survey.manifest.motor.stator_resistance_ohm)

    @cached_property
    def inductance_ratio(self) -> float | None:
        """Inductance over the nameplate's, both of the mean of 1/L; at the smallest currents against saturation."""
        motor, seen = self.survey.manifest.motor, self.survey.injections
        small = [s for s in seen if abs(s.mean_i) < MIN_CURRENT_FRACTION * self.survey.max_current_a]
        # Where the current settles within a few samples, more lags would absorb the settling that r describes.
        response = impulse_response(self.survey, small or seen, max_lag=1)
        if response is None or motor.d_inductance_h is None or motor.q_inductance_h is None:
            return None
        l_h = _exact_inductance(response.l_h, self.resistance_ohm, self.survey.sampling_frequency_hz)
        return _ratio(l_h, 2.0 / (1.0 / motor.d_inductance_h + 1.0 / motor.q_inductance_h))


def _exact_inductance(l_h: float, resistance_ohm: float | None, sampling_frequency_hz: float) -> float:
    """L of Ts / L' = (1 - exp(-R Ts / L)) / R, with L' the voltage over the current's slope within a sample."""
    # L' itself where R is not known, or where the current settles within the sample.
    decay = (resistance_ohm or 0.0) / (sampling_frequency_hz * l_h)
    return l_h * decay / -math.log1p(-decay) if 0.0 < decay < 1.0 else l_h


def _ratio(value: float | None, unit: float | None) -> float | None:
    return value / unit if value is not None and unit is not None and value > 0.0 else None


def explained_shares(injections: Sequence[SegmentReadings]) -> tuple[float, float] | None:
    """Share of the steps of i_alpha and of i_beta that the voltage explains; None without injection."""
    power, explained = np.zeros(2), np.zeros(2)
    for seen in injections:
        steps = parts(np.diff(seen.i))
        u = parts(seen.ripple_v)
        late = np.concatenate([u[2 - k : len(u) - 2 - k] for k in (-1, 0, 1)], axis=1)
        target = steps[2 : len(steps) - 1]
        solution = np.linalg.lstsq(late.T @ late, late.T @ target, rcond=1e-9)[0]
        power += np.square(target).sum(axis=0)
        explained += np.einsum("ij,ij->j", solution, late.T @ target)
    if not np.any(power):
        return None
    alpha, beta = explained / np.where(power > 0.0, power, 1.0)
    return float(alpha), float(beta)
