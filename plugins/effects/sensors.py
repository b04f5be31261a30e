"""Errors of the current sensors: gain, offset, drift, nonlinearity, a phase that is not read.

With two sensors, in phases a and b, the third current is computed; with three, all form the vector, and the zero
sequence drops out. A recording without phase currents is treated as one of two sensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.frames import from_phases, from_two_phases, to_phases
from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array, Indices
from orchestrator.numerics.zero_sequence import gains_of
from plugins.effects._batches import BatchEffect, of_three_readings
from plugins.effects._vectors import Starts, doubles, less_constant, times_matrix
from protocols import (
    Contrast,
    Correction,
    EffectLayer,
    EffectParameters,
    MeasurableEffect,
    SegmentDependentEffect,
    SignalBatch,
    Signals,
    amplitude,
    refinement,
)

_LOG_ROUNDING = 1e-3
"""Sum of three logged phases over their largest that the rounding of a log explains."""
_ACROSS = 0.5 * math.sqrt(3.0)
"""Current of phases b and -c for one along beta."""


def _vectors(read: Array, three: bool) -> Array:
    """Vectors (n, 2) that a drive with two or three sensors computes from readings (n, 3)."""
    return from_phases(read) if three else from_two_phases(read[:, 0], read[:, 1])


@lru_cache(maxsize=32)
def _inverse_gain(gains: tuple[float, float, float], three: bool) -> Array:
    """The matrix (2, 2) that corrects vectors read by sensors with these gains."""
    return np.asarray(np.linalg.inv(_vectors(to_phases(np.eye(2)) * np.array(gains), three)))


class CurrentGainMismatch(BatchEffect, MeasurableEffect):
    """Gains 1 + g/2 of sensor a and 1 - g/2 of sensor b, g dimensionless; i_c = -i_a - i_b, or as a third one reads."""

    name: ClassVar[str] = "current_gain_mismatch"
    summary: ClassVar[str] = "The current sensors of phases a and b differ in gain."
    signature: ClassVar[str] = (
        "Residual against each phase's current: a and b have opposite slopes; the ripple's inductance differs "
        "with its direction, too."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A gain common to both sensors scales R_s and the flux together."

    class Parameters(EffectParameters):
        gain_a_minus_b: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Divide each sensor's reading by its gain."""
        half = 0.5 * p.gain_a_minus_b
        gains = (1.0 + half, 1.0 - half, 1.0)
        inverse_gains = np.stack([_inverse_gain(gains, three) for three in (False, True)])
        return Correction(i_ab=times_matrix(batch.i_ab, batch.starts, inverse_gains[of_three_readings(batch)]))

    def measured(self, signals: Sequence[Signals]) -> Parameters | None:
        """The mismatch from the sum of three readings; None without three sensors or if insignificant."""
        gains = gains_of(signals)
        value = None if gains is None else gains.differ((1.0, -1.0, 0.0))
        return None if value is None else self.Parameters(gain_a_minus_b=value)


class ThirdCurrentSensor(BatchEffect, SegmentDependentEffect, MeasurableEffect):
    """Gain 1 + g of sensor c where three sensors make the vector: it is stretched along phase c by 2/3 g.

    Its offset moves the vector as those of a and b do, and is reported as theirs.
    """

    name: ClassVar[str] = "third_current_sensor"
    summary: ClassVar[str] = "The third current sensor differs in gain from the other two."
    signature: ClassVar[str] = (
        "Residual against each phase's current: the slope of c differs from those of a and b, which are alike; "
        "so does the inductance along c."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = (
        "A gain common to all sensors scales R_s and the flux together: +g of c is -g of a and b."
        " Crosstalk between sensors stretches in the same way, but also rotates."
    )

    class Parameters(EffectParameters):
        gain_c_minus_1: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)

    def shows_in(self, signals: Signals) -> bool:
        """Whether the vector may be computed from three sensors."""
        return signals.clarke_of_three is not False

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Divide the third reading by its gain; segments with two sensors are unchanged."""
        third = [self.shows_in(s) for s in batch.segments]
        if not any(third):
            return Correction()
        inverse_gains = np.stack([np.eye(2), _inverse_gain((1.0, 1.0, 1.0 + p.gain_c_minus_1), True)])
        return Correction(i_ab=times_matrix(batch.i_ab, batch.starts, inverse_gains[np.array(third, dtype=np.intp)]))

    def measured(self, signals: Sequence[Signals]) -> Parameters | None:
        """The gain error from the sum of three readings; None without three sensors or if insignificant."""
        gains = gains_of(signals)
        value = None if gains is None else gains.differ((-0.5, -0.5, 1.0))
        return None if value is None else self.Parameters(gain_c_minus_1=value)


class ShuntReconstruction(BatchEffect, SegmentDependentEffect):
    """Three low-side shunts read g_j i_j + o, and the leg with the largest command is minus the sum of the others.

    The lower switch of that leg is on too briefly for its shunt to be read. With the sum S of all three, the vector is
    that of three sensors, less S in the missing leg alone, whose vector u has a length of 2/3:

        r = M i - u S,    M i the vector of (g_a i_a, g_b i_b, g_c i_c),    S = sum_j g_j i_j + 3 o.

    It is solved for i. Every zero sequence of the modulation leaves the missing leg the same. The last command before
    the reading decides; where a row is the mean of many readings, u is the mean of theirs. Gains are given by
    g_a - g_b and g_c - (g_a + g_b) / 2, with a mean of 1. Offsets that differ from shunt to shunt move the vector by a
    constant besides, and are a `CurrentOffset`.
    """

    name: ClassVar[str] = "shunt_reconstruction"
    summary: ClassVar[str] = "Of three unequal low-side shunts one is not read, but minus the sum of the others."
    signature: ClassVar[str] = (
        "Residual on the current plane: it changes by sectors, where another phase's voltage becomes the largest."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A gain common to all shunts scales R_s and the flux together."

    class Parameters(EffectParameters):
        gain_a_minus_b: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)
        gain_c_minus_ab: float = amplitude("1", typical=0.01, prior_width=0.02, low=-0.2, high=0.2)
        common_offset_a: float = amplitude("A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5)

    def shows_in(self, signals: Signals) -> bool:
        """Whether a phase may be reconstructed: not where three logged readings have a sum of their own."""
        if not signals.bridge_on:
            return False
        if signals.i_abc is None or signals.clarke_of_three is None:
            return True
        largest = float(np.abs(signals.i_abc).max())
        return bool(np.abs(signals.i_abc.sum(axis=1)).max() <= _LOG_ROUNDING * largest)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Solve the readings for the currents; without any gate on, nothing is reconstructed."""
        half, third = 0.5 * p.gain_a_minus_b, p.gain_c_minus_ab / 3.0
        gains = np.array([1.0 + half - third, 1.0 - half - third, 1.0 + 2.0 * third])
        # What the end of an interval has beside its mean makes it the command that came last.
        commands = batch.v_ab if batch.v_late_ab is None else batch.v_ab + batch.v_late_ab
        parts = np.zeros((0, 3)) if batch.largest_command_abc is None else doubles(batch.largest_command_abc)
        rows = (doubles(batch.i_ab), doubles(commands), parts, batch.starts, _rows_to_command(batch))
        return Correction(i_ab=_of_two_shunts(*rows, gains, 3.0 * p.common_offset_a))


_OFF = 1 << 30
"""In place of a number of rows: no gate is on."""


def _rows_to_command(batch: SignalBatch) -> Indices:
    """Rows from a reading to the voltage of the last command before it, (segments,); `_OFF` with all gates off."""
    declared = 0.0 if batch.drive is None else batch.drive.voltage_delay_samples or 0.0
    return np.array([math.floor(declared) - 1 if s.bridge_on else _OFF for s in batch.segments], dtype=np.intp)


@njit(cache=True, nogil=True)
def _of_two_shunts(
    i_ab: Array, commands_ab: Array, parts: Array, starts: Starts, ahead: Indices, gains: Array, offsets: float
) -> Array:
    """Currents (N, 2) from readings of two shunts each; `offsets` is the sum of all shunts' [A].

    The missing leg is by `parts` (N, 3), or where these are empty or zeros, by the largest of the commands.
    """
    out = i_ab.copy()
    # Vector and sum of the gained phases of a unit current along alpha and beta.
    aa, ba = vector_of(gains[0], -0.5 * gains[1], -0.5 * gains[2])
    ab, bb = vector_of(0.0, _ACROSS * gains[1], -_ACROSS * gains[2])
    sum_a, sum_b = gains[0] - 0.5 * (gains[1] + gains[2]), _ACROSS * (gains[1] - gains[2])
    for s in range(starts.shape[0] - 1):
        if ahead[s] == _OFF:
            continue
        first, last = starts[s], starts[s + 1] - 1
        for k in range(first, last + 1):
            a, b, c = 0.0, 0.0, 0.0
            if parts.shape[0] > 0:
                a, b, c = parts[k, 0], parts[k, 1], parts[k, 2]
            if a + b + c == 0.0:
                row = min(max(k + ahead[s], first), last)
                v_a, v_b, v_c = phases_of(commands_ab[row, 0], commands_ab[row, 1])
                if v_a >= v_b and v_a >= v_c:
                    a = 1.0
                elif v_b >= v_c:
                    b = 1.0
                else:
                    c = 1.0
            u, w = vector_of(a, b, c)
            r_a, r_b = i_ab[k, 0] + u * offsets, i_ab[k, 1] + w * offsets
            m_aa, m_ab, m_ba, m_bb = aa - u * sum_a, ab - u * sum_b, ba - w * sum_a, bb - w * sum_b
            det = m_aa * m_bb - m_ab * m_ba
            out[k, 0], out[k, 1] = (m_bb * r_a - m_ab * r_b) / det, (m_aa * r_b - m_ba * r_a) / det
    return out


class CurrentOffset(BatchEffect):
    """Sensors a and b read i + o [A]; a computed phase c reads i_c - o_a - o_b, a third sensor i_c.

    Three offsets o_a, o_b, o_c are seen as o_a - o_c and o_b - o_c.
    """

    name: ClassVar[str] = "current_offset"
    summary: ClassVar[str] = "The current sensors read a constant beside the current."
    signature: ClassVar[str] = (
        "Residual against each phase's current: a constant of minus R_s times the offset in each phase, with the "
        "gates off too, and a shifted map."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.GATES_OFF,)
    gauge: ClassVar[str] = "Only readings with the gates off tell it from a voltage bias of R_s times the offset."
    remedy: ClassVar[str] = "subtract it from the readings of each sensor"

    class Parameters(EffectParameters):
        offset_a_a: float = amplitude("A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5)
        offset_b_a: float = amplitude("A", typical=0.015, prior_width=0.02, low=-0.5, high=0.5)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the offsets."""
        return Correction(i_ab=less_constant(batch.i_ab, batch.starts, _offsets(batch, p.offset_a_a, p.offset_b_a)))


def _offsets(batch: SignalBatch, a: float, b: float) -> Array:
    """The vector read at zero current with offsets of sensors a and b, shape (segments, 2)."""
    read = np.array([[a, b, 0.0]])
    return np.concatenate([_vectors(read, three) for three in (False, True)])[of_three_readings(batch)]


class CurrentOffsetDrift(BatchEffect):
    """Offsets of sensors a and b that grow with time: o(t) = rate (1 - exp(-s t)) / s [A], s = `settling_per_s`.

    t counts from the start of the experiment, and o(0) is a `CurrentOffset`. In the simple form s is 0 and the offset
    is rate t: electronics that warm up more slowly than the experiment lasts.
    """

    name: ClassVar[str] = "current_offset_drift"
    summary: ClassVar[str] = "The current sensors' offsets drift as the experiment goes on."
    signature: ClassVar[str] = (
        "Residual against each phase's current: constants of minus R_s times the offset, which grow with time "
        "and so scatter."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        rate_a_a_per_s: float = amplitude("A/s", typical=2e-4, prior_width=3e-4, low=-0.01, high=0.01)
        rate_b_a_per_s: float = amplitude("A/s", typical=2e-4, prior_width=3e-4, low=-0.01, high=0.01)
        settling_per_s: float = refinement("1/s", neutral=0.0, prior_width=0.01, low=0.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the drift at each sample's time."""
        rates = _offsets(batch, p.rate_a_a_per_s, p.rate_b_a_per_s)
        times = (doubles(batch.start_s), doubles(batch.sampling_frequency_hz))
        return Correction(i_ab=_less_drift(doubles(batch.i_ab), batch.starts, *times, rates, p.settling_per_s))


@njit(cache=True, nogil=True)
def _less_drift(
    i_ab: Array, starts: Starts, start_s: Array, rate_hz: Array, drifts: Array, settling_per_s: float
) -> Array:
    """Vectors (N, 2) minus settling drifts with initial rates (segments, 2)."""
    out = np.empty_like(i_ab)
    for s in range(starts.shape[0] - 1):
        a, b = drifts[s, 0], drifts[s, 1]
        for k in range(starts[s], starts[s + 1]):
            grown = start_s[s] + (k - starts[s]) / rate_hz[s]
            if settling_per_s != 0.0:
                grown = -math.expm1(-settling_per_s * grown) / settling_per_s
            out[k, 0] = i_ab[k, 0] - grown * a
            out[k, 1] = i_ab[k, 1] - grown * b
    return out


class CurrentNonlinearity(BatchEffect):
    """Every sensor reads i + h i^2 + k i^3 [A], as with a core that begins to saturate in one or both directions.

    h is `square_per_a`, k `cubic_per_a2`; an amplifier may have only one of them.
    """

    name: ClassVar[str] = "current_nonlinearity"
    summary: ClassVar[str] = "The current sensors' characteristic is curved."
    signature: ClassVar[str] = (
        "Residual against each phase's current: it bends with the square or the cube of the current, as does the map."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        cubic_per_a2: float = amplitude("1/A^2", typical=3e-4, prior_width=1e-3, low=-0.02, high=0.02)
        square_per_a: float = amplitude("1/A", typical=1e-3, prior_width=3e-3, low=-0.02, high=0.02)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Solve m = i + h i^2 + k i^3 for i in each sensor, by a bounded Newton step and a fixed-point step."""
        clarke = np.stack([_vectors(np.eye(3), three) for three in (False, True)])[of_three_readings(batch)]
        curve = (p.square_per_a, p.cubic_per_a2)
        return Correction(i_ab=_straightened(doubles(batch.i_ab), batch.starts, *curve, clarke))


@njit(cache=True, nogil=True)
def _straightened(i_ab: Array, starts: Starts, square: float, cubic: float, clarke: Array) -> Array:
    """Vectors (N, 2) without squares and cubes of the phase currents, by each segment's Clarke matrix (3, 2)."""
    out = i_ab.copy()
    for s in range(starts.shape[0] - 1):
        for k in range(starts[s], starts[s + 1]):
            phases = phases_of(i_ab[k, 0], i_ab[k, 1])
            for x in range(3):
                read = phases[x]
                error = read * (square + cubic * read)
                # Newton step, bounded where the characteristic is not monotonic.
                near = read * (1.0 - error / (1.0 + abs(read * (2.0 * square + 3.0 * cubic * read))))
                more = near * near * (square + cubic * near)
                out[k, 0] -= more * clarke[s, x, 0]
                out[k, 1] -= more * clarke[s, x, 1]
    return out
