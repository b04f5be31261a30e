"""From corrected signals to weak-form equations: the voltage equation of each sampling interval, summed by windows.

    y_m = sum_k w_mk [ v_k Ts - R_s int i dt - psi(i_k+1) + psi(i_k) ]  =  0 for a correct model,

written in the believed rotor frame. int i dt is the trapezoidal rule and its correction
Ts^2/12 (i'_start - i'_end): where saturation curves the ripple, the plain rule is biased.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from orchestrator.diagnosis.weak_form.batches import SegmentBatch, WindowLayout
from orchestrator.diagnosis.weak_form.derivatives import sum_basis
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.tensor_spline import CARDINAL
from orchestrator.numerics.types import Array
from protocols import SignalBatch


@dataclass(frozen=True)
class LocalMap:
    """Flux and inductance of a model at every sample of a batch, in the true frame.

    Attributes
    ----------
    i_dq : array, shape (n, 2)
        Magnetising current in the true frame [A].
    delta : array, shape (n,) or (0,)
        True minus believed angle [rad]; empty where zero throughout.
    turn : array, shape (n, 2) or (0, 2)
        Cosine and sine of delta.
    psi : array, shape (n, 2)
        Flux linkage without the magnet's [Wb].
    inductance : array, shape (n, 3)
        L_dd, L_dq, L_qq [H].
    """

    i_dq: Array
    delta: Array
    turn: Array
    psi: Array
    inductance: Array

    def part(self, at: slice) -> LocalMap:
        """The local map of a slice of the samples."""
        turned = self.delta.size > 0
        return LocalMap(
            self.i_dq[at],
            self.delta[at] if turned else self.delta,
            self.turn[at] if turned else self.turn,
            self.psi[at],
            self.inductance[at],
        )


def local_map(batch: SegmentBatch, signals: SignalBatch, magnetics: Magnetics) -> LocalMap:
    """Evaluate the magnetics at the (corrected) signals of a batch."""
    i_dq, delta = true_frame(batch, signals)
    psi, inductance = magnetics.flux_and_inductance(i_dq)
    return LocalMap(i_dq, delta, unit_vectors(delta) if delta.size else np.zeros((0, 2)), psi, inductance)


def true_frame(batch: SegmentBatch, signals: SignalBatch) -> tuple[Array, Array]:
    """Magnetising current in the true rotor frame (n, 2), and true minus believed angle (empty where zero)."""
    if signals.theta_rad is batch.signals.theta_rad:
        return to_dq(signals.i_m_ab, batch.believed_rad), np.zeros(0)
    delta = np.asarray(signals.theta_rad - batch.believed_rad, dtype=np.float64)
    if not delta.any():
        return to_dq(signals.i_m_ab, batch.believed_rad), np.zeros(0)
    return to_dq(signals.i_m_ab, signals.theta_rad), delta


def voltage_and_resistance(
    batch: SegmentBatch, signals: SignalBatch, local: LocalMap, pm_flux_wb: float
) -> tuple[Array, Array]:
    """The weak form's part by voltage and rotation of the magnet, and its R_s column, shapes (rows,) and (rows,).

    y = voltage + flux terms + R_s column + basis (change of coefficients); `signals.resistance_ohm` is over R_s.
    """
    motor = batch.signals.motor
    v, r = np.empty(batch.layout.rows[-1]), np.empty(batch.layout.rows[-1])
    _sum_intervals(
        np.ascontiguousarray(signals.v_ab),
        np.ascontiguousarray(signals.i_ab),
        np.ascontiguousarray(signals.resistance_ohm),
        local.turn,
        local.inductance,
        batch.layout,
        pm_flux_wb,
        (motor.stator_resistance_ohm or 0.0) if motor else 0.0,
        v,
        r,
    )
    return v, r


def basis(batch: SegmentBatch, local: LocalMap, magnetics: Magnetics) -> list[Array]:
    """Each segment's columns for the coefficients of the co-energy, shape (rows, coefficients)."""
    (numbers, counts), kinked = magnetics.grid.layout, magnetics.grid.kinked
    columns = []
    for j, piece in enumerate(batch.pieces):
        w, part = piece.windows, local.part(batch.signals.slice_of(j))
        waves = (w.step, w.test_functions, w.bins, w.n_bins)
        sums = sum_basis(part.i_dq, part.delta, *waves, numbers, counts, CARDINAL, kinked)
        columns.append(w.combine(sums))
    return columns


def flux_terms(batch: SegmentBatch, local: LocalMap) -> Array:
    """The weak form's -(psi_k+1 - psi_k) by the map, without the magnet's flux; shape (rows,)."""
    psi = to_ab(local.psi, local.delta) if local.delta.size else local.psi
    out = np.empty(batch.layout.rows[-1])
    _sum_steps(psi, batch.layout, out)
    return out


def change_of_rows(
    batch: SegmentBatch,
    base: SignalBatch,
    change: Mapping[str, Array],
    local: LocalMap,
    pm_flux_wb: float,
    out: Array | None = None,
) -> Array:
    """Change of y (rows,), to first order in the magnetics, for changes of the arrays in `base`.

    Parameters
    ----------
    out : array, shape (rows,), optional
        Array for the result.
    """

    def of(name: str) -> Array:
        known = change.get(name)
        return np.zeros((0, 2)[: getattr(base, name).ndim]) if known is None else known

    rows = np.empty(batch.layout.rows[-1]) if out is None else out
    if change.keys() == {"v_ab"}:
        _sum_voltages(np.ascontiguousarray(change["v_ab"]), batch.layout, rows)
        return rows
    _sum_changes(
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
        batch.layout,
        pm_flux_wb,
        rows,
    )
    return rows


@njit(cache=True, nogil=True, inline="always")
def _add(sums: Array, layout: WindowLayout, k: int, x_d: float, x_q: float) -> None:
    """Add the vector of the interval after sample k to the test functions on both sides of it."""
    j = layout.before[k]
    b = layout.bins[k]
    w0 = layout.weights[k, 0]
    w1 = layout.weights[k, 1]
    sums[j, b, 0] += w0 * x_d
    sums[j, b, 1] += w0 * x_q
    sums[j + 1, b, 0] += w1 * x_d
    sums[j + 1, b, 1] += w1 * x_q


@njit(cache=True, nogil=True, inline="always")
def _sums(layout: WindowLayout, s: int) -> Array:
    """Zero sums by a segment's test functions, bins and axes, padded by one before the first and after the last."""
    return np.zeros((layout.test_functions[s] + 3, layout.n_bins[s], 2))


@njit(cache=True, nogil=True)
def _combine(sums: Array, layout: WindowLayout, s: int, out: Array) -> None:
    """A segment's rows from its `_sums`, weighted by the modes."""
    n_bins, n_modes, first = layout.n_bins[s], layout.n_modes[s], layout.mode_starts[s]
    row = layout.rows[s]
    for j in range(1, layout.test_functions[s] + 1):
        for m in range(n_modes):
            d = 0.0
            q = 0.0
            for b in range(n_bins):
                weight = layout.modes[first + m * n_bins + b]
                d += weight * sums[j, b, 0]
                q += weight * sums[j, b, 1]
            out[row] = 0.0 if layout.unread[s] == 0 else d
            out[row + 1] = 0.0 if layout.unread[s] == 1 else q
            row += 2


@njit(cache=True, nogil=True)
def _sum_steps(x: Array, layout: WindowLayout, out: Array) -> None:
    """Rows of -(x_k+1 - x_k), x (n, 2) in the believed rotor frame."""
    for s in range(layout.test_functions.shape[0]):
        first = layout.starts[s]
        sums = _sums(layout, s)
        for k in range(first, layout.starts[s + 1] - 1):
            _add(sums, layout, k, x[k, 0] - x[k + 1, 0], x[k, 1] - x[k + 1, 1])
        _combine(sums, layout, s, out)


@njit(cache=True, nogil=True)
def _sum_intervals(
    v_ab: Array,
    i_ab: Array,
    resistance: Array,
    turn: Array,
    inductance: Array,
    layout: WindowLayout,
    pm_flux: float,
    nominal_ohm: float,
    v_out: Array,
    r_out: Array,
) -> None:
    for s in range(layout.test_functions.shape[0]):
        first = layout.starts[s]
        c = layout.cos[s]
        sn = layout.sin[s]
        ts = layout.interval_s[s]
        sixth = ts * ts / 12.0
        v_sums = _sums(layout, s)
        r_sums = _sums(layout, s)
        for k in range(first, layout.starts[s + 1] - 1):
            vd = c * v_ab[k, 0] + sn * v_ab[k, 1]
            vq = -sn * v_ab[k, 0] + c * v_ab[k, 1]
            id0 = c * i_ab[k, 0] + sn * i_ab[k, 1]
            iq0 = -sn * i_ab[k, 0] + c * i_ab[k, 1]
            id1 = c * i_ab[k + 1, 0] + sn * i_ab[k + 1, 1]
            iq1 = -sn * i_ab[k + 1, 0] + c * i_ab[k + 1, 1]
            # i' = L^-1 (v - R i) at both ends; the small error of the angle is negligible in a correction.
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
            v_d = vd * ts
            v_q = vq * ts
            if turn.shape[0] > 0:
                v_d -= pm_flux * (turn[k + 1, 0] - turn[k, 0])
                v_q -= pm_flux * (turn[k + 1, 1] - turn[k, 1])
            _add(v_sums, layout, k, v_d, v_q)
            r_d = -r * (0.5 * ts * (id0 + id1) + _bounded(sixth * gd, ts * (id1 - id0) / 6.0))
            r_q = -r * (0.5 * ts * (iq0 + iq1) + _bounded(sixth * gq, ts * (iq1 - iq0) / 6.0))
            _add(r_sums, layout, k, r_d, r_q)
        _combine(v_sums, layout, s, v_out)
        _combine(r_sums, layout, s, r_out)


@njit(cache=True, nogil=True)
def _bounded(bend: float, limit: float) -> float:
    """The area between a current's course and its chord, where a trial map's inductance may be far too small.

    The slopes at both ends differ by at most twice the chord's while the current moves one way.
    """
    return max(-abs(limit), min(abs(limit), bend))


@njit(cache=True, nogil=True)
def _sum_voltages(dv: Array, layout: WindowLayout, out: Array) -> None:
    """Rows of a change of the voltage alone, (n, 2) in the stator frame: summed there, then rotated."""
    for s in range(layout.test_functions.shape[0]):
        sums = _sums(layout, s)
        for k in range(layout.starts[s], layout.starts[s + 1] - 1):
            _add(sums, layout, k, dv[k, 0], dv[k, 1])
        c = layout.interval_s[s] * layout.cos[s]
        sn = layout.interval_s[s] * layout.sin[s]
        for j in range(1, layout.test_functions[s] + 1):
            for b in range(layout.n_bins[s]):
                alpha, beta = sums[j, b, 0], sums[j, b, 1]
                sums[j, b, 0] = c * alpha + sn * beta
                sums[j, b, 1] = c * beta - sn * alpha
        _combine(sums, layout, s, out)


@njit(cache=True, nogil=True)
def _sum_changes(
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
    layout: WindowLayout,
    pm_flux: float,
    out: Array,
) -> None:
    has_v = dv.shape[0] > 0
    has_i = di.shape[0] > 0
    has_r = dr.shape[0] > 0
    has_m = dim.shape[0] > 0
    has_t = dtheta.shape[0] > 0
    turned = turn.shape[0] > 0
    for s in range(layout.test_functions.shape[0]):
        first = layout.starts[s]
        c = layout.cos[s]
        sn = layout.sin[s]
        ts = layout.interval_s[s]
        sums = _sums(layout, s)
        old_d, old_q, ohm_d, ohm_q = 0.0, 0.0, 0.0, 0.0
        for k in range(first, layout.starts[s + 1]):
            # Flux change at this sample, in the believed frame.
            pd = 0.0
            pq = 0.0
            if has_m or has_t:
                ct = c
                st = sn
                cd = 1.0
                sd = 0.0
                if turned:
                    cd = turn[k, 0]
                    sd = turn[k, 1]
                    ct = c * cd - sn * sd
                    st = sn * cd + c * sd
                xd = 0.0
                xq = 0.0
                if has_m:
                    xd = ct * dim[k, 0] + st * dim[k, 1]
                    xq = -st * dim[k, 0] + ct * dim[k, 1]
                if has_t:
                    # Change of the current in a frame rotated by dtheta: -dtheta J i.
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
                od = resistance[k] * (c * di[k, 0] + sn * di[k, 1])
                oq = resistance[k] * (-sn * di[k, 0] + c * di[k, 1])
            if has_r:
                od += dr[k] * (c * i_ab[k, 0] + sn * i_ab[k, 1])
                oq += dr[k] * (-sn * i_ab[k, 0] + c * i_ab[k, 1])
            if k > first:
                x_d = old_d - pd - 0.5 * ts * (ohm_d + od)
                x_q = old_q - pq - 0.5 * ts * (ohm_q + oq)
                if has_v:
                    x_d += ts * (c * dv[k - 1, 0] + sn * dv[k - 1, 1])
                    x_q += ts * (-sn * dv[k - 1, 0] + c * dv[k - 1, 1])
                _add(sums, layout, k - 1, x_d, x_q)
            old_d, old_q, ohm_d, ohm_q = pd, pq, od, oq
        _combine(sums, layout, s, out)
