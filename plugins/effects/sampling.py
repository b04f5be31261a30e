"""Currents that are read beside the turning point of the carrier."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from plugins.effects._batches import DoubtfulBatchEffect
from plugins.effects._vectors import Starts, doubles
from protocols import Contrast, Correction, EffectLayer, EffectParameters, SignalBatch, amplitude

MAP_DOUBT = 0.01
"""Of the inductance that a reading's ripple is told by: what a map of some hundred numbers leaves open in corners of
the plane that only a sweep's dwells reach, as seen on a simulated servo of 48 V."""


class SamplingOffset(DoubtfulBatchEffect):
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

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """The mean voltage from each reading to the next, less what R_s takes beside the readings' mean."""
        given, beside = _beside_readings(batch, p.offset_s)
        v_ab, ohm = doubles(batch.v_ab), doubles(batch.resistance_ohm)
        return Correction(
            v_ab=_between_readings(v_ab, given, beside, ohm, batch.starts, doubles(batch.sampling_frequency_hz))
        )

    def doubts_batch(self, batch: SignalBatch, p: Parameters) -> list[Correction]:
        """What R_s takes beside the readings' mean follows the map's own L, which is not that sure in its corners."""
        _, beside = _beside_readings(batch, p.offset_s)
        taken = batch.resistance_ohm[:, None] * beside
        return [Correction(v_ab=batch.v_ab + MAP_DOUBT * taken)]


def _beside_readings(batch: SignalBatch, offset_s: float) -> tuple[Array, Array]:
    """Volt-seconds that the winding was given from each row's turning point to its reading, and the current of these.

    Both of shape (N, 2).
    """
    v_ab, i_ab, ohm = doubles(batch.v_ab), doubles(batch.i_ab), doubles(batch.resistance_ohm)
    given = _given(v_ab, i_ab, ohm, doubles(batch.v_dc), offset_s, batch.starts, doubles(1.0 / batch.pwm_frequency_hz))
    if batch.inductance_ab is None:
        return given, np.zeros_like(i_ab)
    return given, _moved(doubles(batch.inductance_ab), given)


@njit(cache=True, nogil=True)
def _between_readings(v_ab: Array, given: Array, beside: Array, ohm: Array, starts: Starts, rates_hz: Array) -> Array:
    """The mean voltage (N, 2) from each reading to the next: with what was given before it, less what R_s takes."""
    out = np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        last, rate_hz = starts[s + 1] - 1, rates_hz[s]
        for k in range(starts[s], last + 1):
            after = min(k + 1, last)
            for x in range(2):
                lost = 0.5 * ohm[k] * (beside[k, x] + beside[after, x])
                out[k, x] = v_ab[k, x] + rate_hz * (given[after, x] - given[k, x]) + lost
    return out


@njit(cache=True, nogil=True)
def _given(
    v_ab: Array, i_ab: Array, ohm: Array, v_dc: Array, offset_s: float, starts: Starts, periods_s: Array
) -> Array:
    """Volt-seconds F - tau R i (N, 2) that the winding was given from each row's turning point to its reading."""
    out = np.empty_like(v_ab)
    sign = 1.0 if offset_s > 0.0 else -1.0
    for s in range(starts.shape[0] - 1):
        beyond = abs(offset_s) - 0.25 * periods_s[s]
        for k in range(starts[s], starts[s + 1]):
            out[k, 0] = -offset_s * ohm[k] * i_ab[k, 0]
            out[k, 1] = -offset_s * ohm[k] * i_ab[k, 1]
            row = k if offset_s > 0.0 else max(k - 1, starts[s])
            a, b, c = phases_of(v_ab[row, 0], v_ab[row, 1])
            centre = 0.5 * (max(a, b, c) + min(a, b, c))
            # A leg of more voltage rises earlier, by half the period for all of the bus.
            early = 0.5 * periods_s[s] / v_dc[row]
            if beyond + early * (max(a, b, c) - centre) <= 0.0:
                continue
            alpha, beta = vector_of(
                max(0.0, beyond + early * (a - centre)),
                max(0.0, beyond + early * (b - centre)),
                max(0.0, beyond + early * (c - centre)),
            )
            out[k, 0] += sign * v_dc[row] * alpha
            out[k, 1] += sign * v_dc[row] * beta
    return out


@njit(cache=True, nogil=True)
def _moved(inductance_ab: Array, flux_ab: Array) -> Array:
    """The current (N, 2) that goes with a flux, by the model's inductance at every sample."""
    out = np.empty_like(flux_ab)
    for k in range(flux_ab.shape[0]):
        aa, ab, bb = inductance_ab[k, 0], inductance_ab[k, 1], inductance_ab[k, 2]
        det = aa * bb - ab * ab
        out[k, 0] = (bb * flux_ab[k, 0] - ab * flux_ab[k, 1]) / det
        out[k, 1] = (aa * flux_ab[k, 1] - ab * flux_ab[k, 0]) / det
    return out
