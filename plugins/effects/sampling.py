"""Currents that are read beside the turning point of the carrier."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from protocols import Contrast, Correction, EffectLayer, EffectParameters, Signals, amplitude


class SamplingOffset:
    """Currents are read tau after the turning point of a symmetric carrier, where a row begins; negative: before.

    Since the turning point the legs have given the volt-seconds F, and the resistance has taken R i tau:

        i(t + tau) = i(t) + L^-1 (F - tau R i),    F_x = V_dc max(0, tau - (1 - d_x) T / 2)

    of each leg, T the carrier's period, d its duty with the zero sequence that centres the pulses; before the turning
    point, of the row before and with the other sign. Read within the zero vector, where F is nil, the current has
    merely decayed. The flux is then still what belongs to the reading, and what changes is an interval's voltage,

        v_k + (F_k+1 - F_k) / Ts - tau R (i_k+1 - i_k) / Ts - R L^-1 (tau R i - F),

    the last of both rows' mean; first order in tau R / L, with the model's own L^-1. What the devices drop in the zero
    vector is left out: it is small beside R i where tau R / L counts.
    Source: D. G. Holmes, T. A. Lipo, Pulse Width Modulation for Power Converters, IEEE Press 2003, chapter 5,
    doi:10.1109/9780470546284 (the duties).
    """

    name: ClassVar[str] = "sampling_offset"
    summary: ClassVar[str] = "The currents are read beside the turning point of the carrier, and hold ripple."
    signature: ClassVar[str] = "Resistance that differs between d and q as their inverse inductances, and turns along."
    layer: ClassVar[EffectLayer] = EffectLayer.DELAY
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_ANGLE,)
    gauge: ClassVar[str] = "Within the zero vector the inductance grows by tau R_s, as the map's own would."

    class Parameters(EffectParameters):
        offset_s: float = amplitude("s", typical=5e-6, prior_width=5e-6, low=-2e-5, high=2e-5)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """The mean voltage from each reading to the next, less what R_s takes beside the readings' mean."""
        v_ab, i_ab, v_dc = (
            np.ascontiguousarray(x, dtype=np.float64) for x in (signals.v_ab, signals.i_ab, signals.v_dc)
        )
        given = _given(v_ab, v_dc, p.offset_s, 1.0 / signals.pwm_frequency_hz)
        taken = p.offset_s * signals.resistance_ohm[:, None] * i_ab
        beside = np.zeros_like(i_ab)
        if signals.psi_ab is not None:
            beside = _moved(i_ab, np.ascontiguousarray(signals.psi_ab, dtype=np.float64), taken - given)
        ahead = _next(given - taken) - (given - taken)
        lost = 0.5 * signals.resistance_ohm[:, None] * (beside + _next(beside))
        return Correction(v_ab=v_ab + signals.sampling_frequency_hz * ahead - lost)


def _next(x: Array) -> Array:
    """Each row's successor; the last is its own."""
    return np.concatenate([x[1:], x[-1:]])


@njit(cache=True, nogil=True)
def _given(v_ab: Array, v_dc: Array, offset_s: float, period_s: float) -> Array:
    """Volt-seconds (n, 2) that the legs have given from each row's turning point to its reading."""
    out = np.zeros_like(v_ab)
    beyond = abs(offset_s) - 0.25 * period_s
    sign = 1.0 if offset_s > 0.0 else -1.0
    for k in range(v_ab.shape[0]):
        row = k if offset_s > 0.0 else max(k - 1, 0)
        a, b, c = phases_of(v_ab[row, 0], v_ab[row, 1])
        centre = 0.5 * (max(a, b, c) + min(a, b, c))
        # A leg of more voltage rises earlier, by half the period for all of the bus.
        early = 0.5 * period_s / v_dc[row]
        if beyond + early * (max(a, b, c) - centre) <= 0.0:
            continue
        alpha, beta = vector_of(
            max(0.0, beyond + early * (a - centre)),
            max(0.0, beyond + early * (b - centre)),
            max(0.0, beyond + early * (c - centre)),
        )
        out[k, 0] = sign * v_dc[row] * alpha
        out[k, 1] = sign * v_dc[row] * beta
    return out


@njit(cache=True, nogil=True)
def _moved(i_ab: Array, psi_ab: Array, flux_ab: Array, window: int = 64, least: float = 1e-8) -> Array:
    """The current (n, 2) that goes with a flux, by the slope of the model's currents over its fluxes in each window.

    Noise moves a held current enough to tell it; where fluxes lie on a line but for the part `least`, nothing does.
    """
    n = i_ab.shape[0]
    out = np.zeros_like(flux_ab)
    for first in range(0, n, window):
        last = min(first + window, n)
        i, psi = i_ab[first:last], psi_ab[first:last]
        square, product, mean_i, mean_psi = np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2), np.zeros(2)
        for k in range(last - first):
            for x in range(2):
                mean_i[x] += i[k, x] / (last - first)
                mean_psi[x] += psi[k, x] / (last - first)
        for k in range(last - first):
            for x in range(2):
                for y in range(2):
                    square[x, y] += (psi[k, x] - mean_psi[x]) * (psi[k, y] - mean_psi[y])
                    product[x, y] += (i[k, x] - mean_i[x]) * (psi[k, y] - mean_psi[y])
        det = square[0, 0] * square[1, 1] - square[0, 1] * square[1, 0]
        if det <= least * (square[0, 0] + square[1, 1]) ** 2:
            continue
        for x in range(2):
            by_alpha = (product[x, 0] * square[1, 1] - product[x, 1] * square[1, 0]) / det
            by_beta = (product[x, 1] * square[0, 0] - product[x, 0] * square[0, 1]) / det
            for k in range(first, last):
                out[k, x] = by_alpha * flux_ab[k, 0] + by_beta * flux_ab[k, 1]
    return out
