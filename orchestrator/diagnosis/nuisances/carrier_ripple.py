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

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.windows import Windows
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.tensor_spline import CARDINAL, EvenSpline
from orchestrator.numerics.types import Array
from protocols import Signals

MIN_INDUCTANCE_RATIO = 0.1
"""Smallest plausible inductance relative to the nameplate's: saturated iron still leaves the slot leakage."""


@dataclass(frozen=True)
class CarrierRipple:
    """What the ripple within a carrier period takes of a segment's voltage, at a model.

    Attributes
    ----------
    moment : array, shape (n, 2)
        M / T above in the believed rotor frame [V s^2].
    inductance : array, shape (n, 3)
        The model's L_dd, L_dq, L_qq [H].
    square : array, shape (n, 3)
        Mean squares and product of the ripple current along d and q: dd, dq, qq [A^2].
    ohm : array, shape (n, 1)
    i_dq : array, shape (n, 2)
        Current in the believed rotor frame [A].
    angle : float
        Believed rotor angle [rad].
    interval_s : float
        Sampling interval [s].
    """

    moment: Array
    inductance: Array
    square: Array
    ohm: Array
    i_dq: Array
    angle: float
    interval_s: float

    @classmethod
    def of(cls, piece: SegmentData, signals: Signals, magnetics: Magnetics) -> CarrierRipple | None:
        """The ripple of a segment's signals with the impressed voltage and R_s; None where no bridge switches."""
        if not signals.bridge_on:
            return None
        v_ab = np.ascontiguousarray(signals.v_ab, dtype=np.float64)
        angle = float(piece.segment.rotor_angle_rad)
        v_dc, period_s = np.ascontiguousarray(signals.v_dc, dtype=np.float64), 1.0 / signals.pwm_frequency_hz
        moment, spread = _ripple(v_ab, v_dc, period_s)
        i_dq = to_dq(signals.i_ab, angle)
        inductance = _believable(magnetics.flux_and_inductance(i_dq)[1], signals)
        along = np.stack([_through(inductance, to_dq(one, angle)) for one in spread])
        square = np.stack([along[..., a] * along[..., b] for a, b in AXES], axis=-1).sum(axis=0)
        ohm = np.asarray(signals.resistance_ohm, dtype=np.float64)[:, None]
        interval_s = 1.0 / signals.sampling_frequency_hz
        return cls(to_dq(moment, angle), inductance, square, ohm, i_dq, angle, interval_s)

    def damped(self, change_h: Array | float = 0.0) -> Array:
        """Voltage to add in the stator frame, the first term above (n, 2) [V]; `change_h` (3,) of the inductance."""
        inductance = self.inductance + change_h
        volts = self.ohm**2 * _through(inductance, _through(inductance, self.moment))
        return np.ascontiguousarray(to_ab(volts, self.angle))

    def bent(self) -> Array:
        """The second term above per derivative of the co-energy, (n, 2, 7) as of `columns_by_derivatives`."""
        dd, dq, qq = self.inductance.T
        gain = np.stack([np.stack([qq, -dq], axis=1), np.stack([-dq, dd], axis=1)], axis=1)
        gain *= self.ohm[:, :, None] / (dd * qq - dq * dq)[:, None, None]
        half = 0.5 * self.square * np.array([1.0, 2.0, 1.0])
        out = np.zeros((len(half), 2, 7))
        out[:, :, 3:6] = gain[:, :, :1] * half[:, None]
        out[:, :, 4:7] += gain[:, :, 1:] * half[:, None]
        return out

    def columns(self, by_derivatives: Array, windows: Windows, grid: EvenSpline) -> Array:
        """Columns (rows, coefficients) of a voltage in the rotor frame that is linear in the co-energy's derivatives.

        Parameters
        ----------
        by_derivatives : array, shape (n, 2, 7)
            Voltage along d and q by W_dd, W_dq, W_qq, W_ddd, W_ddq, W_dqq and W_qqq at every sample.
        """
        (numbers, counts), w = grid.layout, windows
        shape = (w.test_functions, w.n_bins, 2, grid.size)
        weights = self.interval_s * by_derivatives
        return w.combine(
            _sum_derivatives(self.i_dq, weights, w.step, w.bins, shape, numbers, counts, CARDINAL, grid.kinked)
        )


AXES = (0, 0), (0, 1), (1, 1)
"""Axes of the three numbers of a symmetric matrix."""


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
def _sum_derivatives(
    i_dq: Array,
    weights: Array,
    step: float,
    bins: NDArray[np.int64],
    shape: tuple[int, int, int, int],
    numbers: Array,
    counts: NDArray[np.int64],
    pieces: Array,
    kinked: Array,
) -> Array:
    """Sums of the co-energy's derivatives by weights (n, 2, 7) per coefficient, shaped as `sum_basis`; none beyond it.

    The third derivatives take the place of the ripple's second difference, which spans little of a cell.
    """
    out = np.zeros(shape)
    nq = shape[3] // (counts[0] + 5)
    x, y, values = np.empty((4, 6)), np.empty((4, 7)), np.empty(7)
    for k in range(i_dq.shape[0] - 1):
        u = (0.5 * (i_dq[k, 0] + i_dq[k + 1, 0]) - numbers[0]) / numbers[1]
        v = (0.5 * (i_dq[k, 1] + i_dq[k + 1, 1]) - numbers[2]) / numbers[3]
        m, n = math.floor(u), math.floor(v)
        if m < 0 or n < 0 or m >= counts[0] or n >= counts[1]:
            continue
        _derivatives(pieces, u - m, numbers[1], x)
        _derivatives(pieces, v - n, numbers[3], y)
        functions = 6
        if kinked.shape[0] > 0 and kinked[n].any():
            functions = 7
            _derivatives(kinked[n : n + 1], v - n, numbers[3], y[:, 6:])
        place = (k + 0.5) / step
        before, b = math.floor(place), bins[k]
        for r in range(6):
            for s in range(functions):
                for j in range(7):
                    along_q = j if j < 3 else j - 3
                    values[j] = x[(2 if j < 3 else 3) - along_q, r] * y[along_q, s]
                d, q = 0.0, 0.0
                for j in range(7):
                    d += weights[k, 0, j] * values[j]
                    q += weights[k, 1, j] * values[j]
                col = (m + r) * nq + (counts[2 + n + s] if s < 6 else nq - 1)
                for side in range(2):
                    function = before - 1 + side
                    if 0 <= function < shape[0]:
                        share = place - before if side == 1 else 1.0 - (place - before)
                        out[function, b, 0, col] += share * d
                        out[function, b, 1, col] += share * q
    return out


@njit(cache=True, nogil=True)
def _derivatives(pieces: Array, t: float, cell: float, out: Array) -> None:
    """Each polynomial at t, and its first three derivatives by t times the cell's side."""
    for r in range(pieces.shape[0]):
        value, first, second, third = 0.0, 0.0, 0.0, 0.0
        for p in range(5, -1, -1):
            third = third * t + 3.0 * second
            second = second * t + 2.0 * first
            first = first * t + value
            value = value * t + pieces[r, p]
        out[0, r], out[1, r], out[2, r], out[3, r] = value, first / cell, second / cell**2, third / cell**3


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
