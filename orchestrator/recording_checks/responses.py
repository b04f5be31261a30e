"""How the current answers the voltage: by its resistance at rest, and sample by sample under injection. Judges nothing.

Under injection, with u the ripple of the voltage and n the declared delay,

    i_k+1 - i_k = sum_j h_j u_k-n-j - r i_k

is fitted to all segments at once, h real and over lags before and after the declared delay: L is Ts / sum h along the
mean axis, and the first h that is not nil says when the voltage acts. Of voltage steps the differences are fitted, and
edges alone: what a controller answers to noise comes after it, and r would be of that noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.survey import Sighting, Survey, Vectors, parts
from orchestrator.recording_checks.vector_maps import AXES, SAME, VectorMap
from protocols import SegmentStage


@dataclass(frozen=True)
class AtRest:
    """Mean currents and voltages of holds and injections: v = a i + b conj(i) + what does not grow with the current.

    Attributes
    ----------
    i, v : complex arrays, shape (n,)
    whole_plane : bool
        False where the currents lie on a line: b is then taken for nil.
    """

    i: Vectors
    v: Vectors
    whole_plane: bool

    def law(self, i_map: VectorMap = SAME, v_map: VectorMap = SAME) -> tuple[complex, complex]:
        """a and b [ohm], with the readings mapped first: R_s and nil in a motor."""
        i, v = i_map(self.i), v_map(self.v)
        columns = [i, np.conj(i), np.ones(len(i)), _signs(i)]
        if not self.whole_plane:
            del columns[1]
        real = np.concatenate([np.stack([c, 1j * c], axis=1) for c in columns], axis=1)
        found = _least_lengths(real, v).reshape(-1, 2) @ [1.0, 1j]
        return complex(found[0]), complex(found[1]) if self.whole_plane else 0j


def _least_lengths(columns: Vectors, wanted: Vectors, rounds: int = 12) -> Array:
    """Real numbers x (m,) for which |columns @ x - wanted| adds up to least: one hold that went astray has one voice.

    By squares that are weighed anew, each with what was left of it (P. J. Huber, Robust Statistics, Wiley 1981, ch. 7).
    """
    weight = np.ones(len(wanted))
    found = np.zeros(columns.shape[1])
    for _ in range(rounds):
        rows, target = weight[:, None] * columns, weight * wanted
        of_rows, of_target = (np.concatenate([x.real, x.imag]) for x in (rows, target))
        found = np.linalg.lstsq(of_rows, of_target, rcond=1e-9)[0]
        left = np.abs(columns @ found - wanted)
        weight = 1.0 / np.sqrt(
            np.maximum(left, max(float(np.median(left)), 1e-9 * float(np.abs(wanted).max()), 1e-300))
        )
    return found


def _signs(i: Vectors) -> Vectors:
    """The vectors of the phase currents' signs, which is what an inverter's dead time and drops take."""
    phases = np.real(i[:, None] * np.conj(AXES))
    knee = 0.02 * np.abs(i).max()
    return np.asarray(np.tanh(phases / max(knee, 1e-300)) @ AXES * (2.0 / 3.0))


def at_rest(survey: Survey) -> AtRest | None:
    """Of holds and injections with enough current; None where there are too few."""
    limits = survey.criteria
    means = [(s.mean_i, s.mean_v) for s in (*survey.holds, *survey.injections)]
    i, v = (np.array(x, dtype=np.complex128) for x in (zip(*means, strict=True) if means else ((), ())))
    if not np.any(i):
        return None
    reach = np.abs(i).max()
    large = np.abs(i) > limits.least_set_point * reach
    i, v = i[large], v[large]
    if len(i) < limits.looked_at_segments:
        return None
    width = float(np.linalg.svd(parts(i), compute_uv=False).min())
    return AtRest(i, v, width > limits.least_set_point * reach)


@dataclass(frozen=True)
class Answer:
    """The current's answer under injection.

    Attributes
    ----------
    lags : array, shape (m,)
        Samples after the declared delay.
    weights : array, shape (m,)
        h_j [A/V], and their standard deviations.
    deviations : array, shape (m,)
    l_h : float
        What the steps of the current say of the inductance, of 1/L the mean over both axes.
    """

    lags: Array
    weights: Array
    deviations: Array
    l_h: float


def answer(survey: Survey, injections: Sequence[Sighting], most_lags: int | None = None) -> Answer | None:
    """Of some injections; None where there is nothing that shows it.

    A wave tells as many lags apart as half its period has samples, a sine two: there are fewer where it must be.

    Parameters
    ----------
    most_lags : int, optional
        Lags before and after the declared delay; None: as the criteria have it.
    """
    for reach in range(survey.criteria.delay_lags if most_lags is None else most_lags, -1, -1):
        found = _answer(survey, injections, np.arange(-reach, reach + 1, dtype=np.int64))
        if found is not None:
            return found
    return None


def _answer(survey: Survey, injections: Sequence[Sighting], lags: NDArray[np.int64]) -> Answer | None:
    declared = math.floor(survey.manifest.drive.voltage_delay_samples or 0.0)
    by_steps = any(seen.segment.stage is SegmentStage.STEPS for seen in injections)
    width = len(lags) if by_steps else len(lags) + 1
    moments, right = np.zeros((width, width)), np.zeros(width)
    power, count = 0.0, 0
    for seen in injections:
        columns, steps = _columns(seen, declared, lags, survey.criteria.edge)
        if steps is None:
            continue
        moments += columns @ columns.T
        right += columns @ steps
        power += float(steps @ steps)
        count += len(steps)
    size = np.sqrt(np.diag(moments))
    if count < survey.criteria.least_looked_at or not np.all(size > 0.0):
        return None
    alike = moments / np.outer(size, size)
    if np.linalg.cond(alike) > survey.criteria.told_apart:
        return None
    inverse = np.linalg.inv(alike) / np.outer(size, size)
    found = inverse @ right
    left = max(power - float(found @ right), 0.0) / count
    weights = found[: len(lags)]
    if by_steps:
        # Iron that saturates bends the current all the way to an edge, alike at all lags.
        weights = weights - np.median(weights)
    total = float(weights.sum())
    if total == 0.0:
        return None
    deviations = np.sqrt(np.maximum(np.diag(inverse) * left, 0.0))[: len(lags)]
    return Answer(lags.astype(np.float64), weights, deviations, 1.0 / (survey.sampling_frequency_hz * total))


def _columns(seen: Sighting, declared: int, lags: NDArray[np.int64], edge: float) -> tuple[Array, Array | None]:
    """Rows of alpha and beta one after the other: u at each lag, and i; of steps, their edges at each lag.

    Parameters
    ----------
    edge : float
        Part of the largest step of a voltage from which on it is an edge.
    """
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
    """A survey, and what its currents say of the motor, worked out where it is first asked for."""

    def __init__(self, survey: Survey) -> None:
        self.survey = survey

    @cached_property
    def rest(self) -> AtRest | None:
        return at_rest(self.survey)

    @cached_property
    def answer(self) -> Answer | None:
        return answer(self.survey, self.survey.injections or self.survey.of(SegmentStage.STEPS))

    @cached_property
    def resistance_ohm(self) -> float | None:
        return None if self.rest is None else self.rest.law()[0].real

    @cached_property
    def resistive_part(self) -> float:
        """Of the voltage at rest, what R_s i makes of it; the rest is an inverter's."""
        if self.rest is None or self.resistance_ohm is None:
            return 0.0
        v = float(np.linalg.norm(self.rest.v))
        return abs(self.resistance_ohm) * float(np.linalg.norm(self.rest.i)) / v if v > 0.0 else 0.0

    @cached_property
    def resistance_ratio(self) -> float | None:
        """R_s over the nameplate's; None where either is not known or none is there."""
        return _ratio(self.resistance_ohm, self.survey.manifest.motor.stator_resistance_ohm)

    @cached_property
    def inductance_ratio(self) -> float | None:
        """Inductance over the nameplate's, both of the mean of 1/L; by the least currents, where little saturates."""
        motor, seen = self.survey.manifest.motor, self.survey.injections
        few = [s for s in seen if abs(s.mean_i) < self.survey.criteria.least_set_point * self.survey.reach_a]
        # Where the current settles within a few samples, more lags would take its way there from r.
        found = answer(self.survey, few or seen, most_lags=1)
        if found is None or motor.d_inductance_h is None or motor.q_inductance_h is None:
            return None
        l_h = _exact_inductance(found.l_h, self.resistance_ohm, self.survey.sampling_frequency_hz)
        return _ratio(l_h, 2.0 / (1.0 / motor.d_inductance_h + 1.0 / motor.q_inductance_h))


def _exact_inductance(l_h: float, resistance_ohm: float | None, sampling_frequency_hz: float) -> float:
    """L of Ts / L' = (1 - exp(-R Ts / L)) / R, with L' the voltage over the current's slope within a sample.

    L' itself where R is not known, or where the current has settled within the sample.
    """
    settled = (resistance_ohm or 0.0) / (sampling_frequency_hz * l_h)
    return l_h * settled / -math.log1p(-settled) if 0.0 < settled < 1.0 else l_h


def _ratio(value: float | None, unit: float | None) -> float | None:
    return value / unit if value is not None and unit is not None and value > 0.0 else None


def shares(injections: Sequence[Sighting]) -> tuple[float, float] | None:
    """How much of the steps of i_alpha and of i_beta the voltage explains, whichever way; None without injection."""
    power, told = np.zeros(2), np.zeros(2)
    for seen in injections:
        steps = parts(np.diff(seen.i))
        u = parts(seen.ripple_v)
        late = np.concatenate([u[2 - k : len(u) - 2 - k] for k in (-1, 0, 1)], axis=1)
        wanted = steps[2 : len(steps) - 1]
        found = np.linalg.lstsq(late.T @ late, late.T @ wanted, rcond=1e-9)[0]
        power += np.square(wanted).sum(axis=0)
        told += np.einsum("ij,ij->j", found, late.T @ wanted)
    if not np.any(power):
        return None
    alpha, beta = told / np.where(power > 0.0, power, 1.0)
    return float(alpha), float(beta)
