"""Resistive voltage drop of the current ripple within a carrier period of a switching bridge.

The weak form takes the current as linear between readings. Pulses centred in a period cause a ripple of flux and
current that is odd about the centre and has no mean, except by resistive damping and by saturation:

    mean i - line = -L^-1 R L^-1 M / T  -  1/2 L^-1 (psi(i + x) + psi(i - x) - 2 psi(i)),
    M_a = int int int (v_a - mean) dt^3 = V_dc T^3 (d_a^3 - d_a) / 24

for each leg; the second term is averaged over ripples x, T is the carrier's period, d the duty with the zero sequence
that centres the pulses. The first is of second order in R T / L: 3e-6 of the voltage for 4 ohm and 50 mH at 10 kHz,
3e-4 for a servo of 0.5 ohm and 0.3 mH at 20 kHz, whose saturation adds a fifth of that. Source of the duties:
D. G. Holmes, T. A. Lipo, Pulse Width Modulation for Power Converters, IEEE Press 2003, chapter 5,
doi:10.1109/9780470546284. The rest integrates a circuit whose inductance is nearly constant within a period.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from protocols import Signals

MIN_INDUCTANCE_RATIO = 0.1
"""Smallest plausible inductance relative to the nameplate's: saturated iron still leaves the slot leakage."""


def carrier_ripple_voltage(piece: SegmentData, signals: Signals, magnetics: Magnetics) -> Array:
    """Voltage to add to a segment's, as a correction for the linear interpolation of the current.

    Parameters
    ----------
    signals : Signals
        Signals with the impressed voltage and the resistance.

    Returns
    -------
    array, shape (n, 2)
        Voltage in the stator frame [V].
    """
    v_ab = np.ascontiguousarray(signals.v_ab, dtype=np.float64)
    if not signals.bridge_on:
        return np.zeros_like(v_ab)
    angle = float(piece.segment.rotor_angle_rad)
    v_dc, period_s = np.ascontiguousarray(signals.v_dc, dtype=np.float64), 1.0 / signals.pwm_frequency_hz
    moment, spread = _ripple(v_ab, v_dc, period_s)
    ohm, i_dq = np.asarray(signals.resistance_ohm)[:, None], to_dq(signals.i_ab, angle)
    psi, inductance = magnetics.flux_and_inductance(i_dq)
    inductance = _believable(inductance, signals)
    damped = ohm * _through(inductance, _through(inductance, to_dq(moment, angle)))
    bent = np.zeros_like(psi)
    for axis in range(2):
        x = _through(inductance, to_dq(spread[axis], angle))
        ahead, behind = (magnetics.flux_and_inductance(i_dq + side * x)[0] for side in (1.0, -1.0))
        bend = 0.5 * _through(inductance, ahead + behind - 2.0 * psi)
        # A map under trial may be too curved: its term is limited to the ripple itself.
        bent += np.clip(bend, -np.abs(x), np.abs(x))
    return np.ascontiguousarray(to_ab(ohm * (damped + bent), angle))


def _believable(inductance: Array, signals: Signals) -> Array:
    """The inductances (n, 3), by the nameplate where a trial map's are so small that the descent would diverge."""
    motor = signals.motor
    if motor is None or motor.d_inductance_h is None or motor.q_inductance_h is None:
        return inductance
    l_d, l_q = motor.d_inductance_h, motor.q_inductance_h
    dd, dq, qq = inductance.T
    sound = (
        (dd > MIN_INDUCTANCE_RATIO * l_d)
        & (qq > MIN_INDUCTANCE_RATIO * l_q)
        & (dd * qq - dq * dq > MIN_INDUCTANCE_RATIO**2 * l_d * l_q)
    )
    return np.where(sound[:, None], inductance, np.array([l_d, 0.0, l_q]))


def _through(inductance: Array, flux: Array) -> Array:
    """L^-1 psi at every sample, shapes (n, 3), (n, 2) and (n, 2)."""
    dd, dq, qq = inductance.T
    d, q = flux.T
    det = dd * qq - dq * dq
    return np.stack([(qq * d - dq * q) / det, (dd * q - dq * d) / det], axis=1)


@njit(cache=True, nogil=True)
def _ripple(v_ab: Array, v_dc: Array, period_s: float) -> tuple[Array, Array]:
    """M / T (n, 2) [V s], and two flux vectors (2, n, 2) [Wb] whose squares sum to the ripple's mean square."""
    n = v_ab.shape[0]
    moment, spread = np.empty((n, 2)), np.empty((2, n, 2))
    for k in range(n):
        a, b, c = phases_of(v_ab[k, 0], v_ab[k, 1])
        centre = 0.5 * (max(a, b, c) + min(a, b, c))
        x, y, z = _duty((a - centre) / v_dc[k]), _duty((b - centre) / v_dc[k]), _duty((c - centre) / v_dc[k])
        m_alpha, m_beta = vector_of(x * x * x - x, y * y * y - y, z * z * z - z)
        volts = v_dc[k] * period_s * period_s / 24.0
        moment[k, 0], moment[k, 1] = volts * m_alpha, volts * m_beta
        xx, yy, zz, xy, yz, xz = _met(x, x), _met(y, y), _met(z, z), _met(x, y), _met(y, z), _met(x, z)
        square = (0.5 * v_dc[k] * period_s) ** 2
        # Mean squares of (2 a - b - c) / 3 and (b - c) / sqrt 3, as in `vector_of`.
        alpha = square * max(0.0, 4.0 * xx + yy + zz - 4.0 * xy - 4.0 * xz + 2.0 * yz) / 9.0
        beta = square * max(0.0, yy + zz - 2.0 * yz) / 3.0
        both = square * (2.0 * xy - 2.0 * xz - yy + zz) / (3.0 * np.sqrt(3.0))
        first = np.sqrt(alpha)
        across = both / first if first > 0.0 else 0.0
        spread[0, k, 0], spread[0, k, 1] = first, across
        spread[1, k, 0], spread[1, k, 1] = 0.0, np.sqrt(max(0.0, beta - across * across))
    return moment, spread


@njit(cache=True, nogil=True)
def _duty(above: float) -> float:
    return min(1.0, max(0.0, 0.5 + above))


@njit(cache=True, nogil=True)
def _met(one: float, other: float) -> float:
    """Mean product of two legs' ripples in units of (V_dc T / 2)^2, integrated up to the shorter and longer pulse."""
    x, y = min(one, other), max(one, other)
    within = (1.0 - x) * (1.0 - y) * x * x * x / 3.0
    between = x * (1.0 - y) * (0.5 * (y * y - x * x) - (y * y * y - x * x * x) / 3.0)
    return within + between + x * y * (1.0 - y) ** 3 / 3.0
