"""From corrected signals to weak-form equations: what each interval between two samples says, summed by windows.

    y_m = sum_k w_mk [ v_k Ts - R_s int i dt - psi(i_k+1) + psi(i_k) ]  =  0 where the model is right,

written in the believed rotor frame. int i dt is the trapezoidal rule and its correction
Ts^2/12 (i'_start - i'_end): where saturation curves the ripple, the plain rule is biased.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from orchestrator.diagnosis.weak_form.derivatives import sum_basis
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.diagnosis.weak_form.windows import sum_intervals
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.tensor_spline import CARDINAL
from orchestrator.numerics.types import Array
from protocols import Signals


@dataclass(frozen=True)
class LocalMap:
    """Flux and inductance of the present model at every sample of one piece, in the true frame.

    Attributes
    ----------
    i_dq : array, shape (n, 2)
        Magnetising current in the true frame [A].
    delta : array, shape (n,) or (0,)
        True minus believed angle [rad]; empty where zero throughout.
    turn : array, shape (n, 2) or (0, 2)
        Cosine and sine of delta.
    psi : array, shape (n, 2)
        Without the magnet's own [Wb].
    inductance : array, shape (n, 3)
        L_dd, L_dq, L_qq [H].
    """

    i_dq: Array
    delta: Array
    turn: Array
    psi: Array
    inductance: Array


def local_map(piece: SegmentSignals, signals: Signals, magnetics: Magnetics) -> LocalMap:
    """Evaluate the magnetics where the (corrected) signals of a piece are."""
    i_dq, delta = true_frame(piece, signals)
    psi, inductance = magnetics.flux_and_inductance(i_dq)
    return LocalMap(i_dq, delta, unit_vectors(delta) if delta.size else np.zeros((0, 2)), psi, inductance)


def true_frame(piece: SegmentSignals, signals: Signals) -> tuple[Array, Array]:
    """Magnetising current in the true rotor frame (n, 2), and true minus believed angle (empty where zero)."""
    believed = float(piece.segment.rotor_angle_rad)
    delta = np.asarray(signals.theta_rad, dtype=np.float64) - believed
    if not delta.any():
        return to_dq(signals.i_m_ab, believed), np.zeros(0)
    return to_dq(signals.i_m_ab, signals.theta_rad), delta


def voltage_and_resistance(
    piece: SegmentSignals, signals: Signals, local: LocalMap, pm_flux_wb: float
) -> tuple[Array, Array]:
    """The weak form's known part and its R_s column, shapes (rows,) and (rows,).

    y = known + R_s * column + basis @ coefficients, with `signals.resistance_ohm` in units of R_s.
    """
    v, r = _interval_terms(
        np.ascontiguousarray(signals.v_ab),
        np.ascontiguousarray(signals.i_ab),
        np.ascontiguousarray(signals.resistance_ohm),
        local.turn,
        local.inductance,
        float(piece.segment.rotor_angle_rad),
        1.0 / signals.sampling_frequency_hz,
        pm_flux_wb,
        (piece.signals.motor.stator_resistance_ohm or 0.0) if piece.signals.motor else 0.0,
    )
    return _summed(piece, v), _summed(piece, r)


def basis(piece: SegmentSignals, local: LocalMap, magnetics: Magnetics) -> Array:
    """The weak form's columns for the coefficients of the co-energy, shape (rows, coefficients)."""
    w = piece.windows
    numbers, counts = magnetics.grid.layout
    return w.combine(sum_basis(local.i_dq, local.delta, w.step, w.hats, w.bins, w.n_bins, numbers, counts, CARDINAL))


def flux_terms(piece: SegmentSignals, local: LocalMap) -> Array:
    """The weak form's -(psi_k+1 - psi_k) by the present map, without the magnet's flux; shape (rows,)."""
    psi = to_ab(local.psi, local.delta) if local.delta.size else local.psi
    return _summed(piece, -np.diff(psi, axis=0))


def difference(
    piece: SegmentSignals, base: Signals, change: Mapping[str, Array], local: LocalMap, pm_flux_wb: float
) -> Array:
    """Change of y, to first order in the magnetics, when arrays of the signals change from what they are in `base`.

    Summed over samples, for `Windows.combine`: shape (hats, n_bins, 2).
    """

    def of(name: str) -> Array:
        known = change.get(name)
        return np.zeros((0, 2)[: getattr(base, name).ndim]) if known is None else known

    believed = float(piece.segment.rotor_angle_rad)
    x = _interval_difference(
        of("v_ab"),
        np.ascontiguousarray(base.i_ab),
        of("i_ab"),
        np.ascontiguousarray(base.resistance_ohm),
        of("resistance_ohm"),
        of("i_m_ab"),
        of("theta_rad"),
        local.i_dq,
        local.turn,
        local.psi,
        local.inductance,
        believed,
        1.0 / base.sampling_frequency_hz,
        pm_flux_wb,
    )
    w = piece.windows
    return sum_intervals(x, w.step, w.hats, w.bins, w.n_bins)


def _summed(piece: SegmentSignals, x: Array) -> Array:
    w = piece.windows
    return w.combine(sum_intervals(x, w.step, w.hats, w.bins, w.n_bins))


@njit(cache=True, nogil=True)
def _interval_terms(
    v_ab: Array,
    i_ab: Array,
    resistance: Array,
    turn: Array,
    inductance: Array,
    believed: float,
    ts: float,
    pm_flux: float,
    nominal_ohm: float,
) -> tuple[Array, Array]:
    n = i_ab.shape[0]
    v_out = np.empty((n - 1, 2))
    r_out = np.empty((n - 1, 2))
    c = math.cos(believed)
    s = math.sin(believed)
    sixth = ts * ts / 12.0
    for k in range(n - 1):
        vd = c * v_ab[k, 0] + s * v_ab[k, 1]
        vq = -s * v_ab[k, 0] + c * v_ab[k, 1]
        id0 = c * i_ab[k, 0] + s * i_ab[k, 1]
        iq0 = -s * i_ab[k, 0] + c * i_ab[k, 1]
        id1 = c * i_ab[k + 1, 0] + s * i_ab[k + 1, 1]
        iq1 = -s * i_ab[k + 1, 0] + c * i_ab[k + 1, 1]
        # i' = L^-1 (v - R i) at both ends; the frame's small error does not matter in a correction.
        ed0 = vd - nominal_ohm * id0
        eq0 = vq - nominal_ohm * iq0
        ed1 = vd - nominal_ohm * id1
        eq1 = vq - nominal_ohm * iq1
        det0 = inductance[k, 0] * inductance[k, 2] - inductance[k, 1] ** 2
        det1 = inductance[k + 1, 0] * inductance[k + 1, 2] - inductance[k + 1, 1] ** 2
        gd = 0.0
        gq = 0.0
        if det0 > 0.0 and det1 > 0.0:
            gd = (inductance[k, 2] * ed0 - inductance[k, 1] * eq0) / det0
            gq = (inductance[k, 0] * eq0 - inductance[k, 1] * ed0) / det0
            gd -= (inductance[k + 1, 2] * ed1 - inductance[k + 1, 1] * eq1) / det1
            gq -= (inductance[k + 1, 0] * eq1 - inductance[k + 1, 1] * ed1) / det1
        r = 0.5 * (resistance[k] + resistance[k + 1])
        v_out[k, 0] = vd * ts
        v_out[k, 1] = vq * ts
        r_out[k, 0] = -r * (0.5 * ts * (id0 + id1) + sixth * gd)
        r_out[k, 1] = -r * (0.5 * ts * (iq0 + iq1) + sixth * gq)
        if turn.shape[0] > 0:
            v_out[k, 0] -= pm_flux * (turn[k + 1, 0] - turn[k, 0])
            v_out[k, 1] -= pm_flux * (turn[k + 1, 1] - turn[k, 1])
    return v_out, r_out


@njit(cache=True, nogil=True)
def _interval_difference(
    dv: Array,
    i_ab: Array,
    di: Array,
    resistance: Array,
    dr: Array,
    dim: Array,
    dtheta: Array,
    i_dq: Array,
    turn: Array,
    psi: Array,
    inductance: Array,
    believed: float,
    ts: float,
    pm_flux: float,
) -> Array:
    n = i_ab.shape[0]
    out = np.zeros((n - 1, 2))
    c = math.cos(believed)
    s = math.sin(believed)
    has_v = dv.shape[0] > 0
    has_i = di.shape[0] > 0
    has_r = dr.shape[0] > 0
    has_m = dim.shape[0] > 0
    has_t = dtheta.shape[0] > 0
    old_d = 0.0
    old_q = 0.0
    ohm_d = 0.0
    ohm_q = 0.0
    for k in range(n):
        # Flux change at this sample, in the believed frame.
        pd = 0.0
        pq = 0.0
        if has_m or has_t:
            ct = c
            st = s
            cd = 1.0
            sd = 0.0
            if turn.shape[0] > 0:
                cd = turn[k, 0]
                sd = turn[k, 1]
                ct = c * cd - s * sd
                st = s * cd + c * sd
            xd = 0.0
            xq = 0.0
            if has_m:
                xd = ct * dim[k, 0] + st * dim[k, 1]
                xq = -st * dim[k, 0] + ct * dim[k, 1]
            if has_t:
                # The current seen from the frame turned by dtheta: -dtheta J i.
                xd += dtheta[k] * i_dq[k, 1]
                xq -= dtheta[k] * i_dq[k, 0]
            fd = inductance[k, 0] * xd + inductance[k, 1] * xq
            fq = inductance[k, 1] * xd + inductance[k, 2] * xq
            if has_t:
                fd -= dtheta[k] * psi[k, 1]
                fq += dtheta[k] * (psi[k, 0] + pm_flux)
            pd = cd * fd - sd * fq
            pq = sd * fd + cd * fq
        # Change of R i at this sample.
        od = 0.0
        oq = 0.0
        if has_i:
            od = resistance[k] * (c * di[k, 0] + s * di[k, 1])
            oq = resistance[k] * (-s * di[k, 0] + c * di[k, 1])
        if has_r:
            od += dr[k] * (c * i_ab[k, 0] + s * i_ab[k, 1])
            oq += dr[k] * (-s * i_ab[k, 0] + c * i_ab[k, 1])
        if k > 0:
            out[k - 1, 0] += old_d - pd - 0.5 * ts * (ohm_d + od)
            out[k - 1, 1] += old_q - pq - 0.5 * ts * (ohm_q + oq)
        if has_v and k < n - 1:
            out[k, 0] += ts * (c * dv[k, 0] + s * dv[k, 1])
            out[k, 1] += ts * (-s * dv[k, 0] + c * dv[k, 1])
        old_d, old_q, ohm_d, ohm_q = pd, pq, od, oq
    return out
