"""Currents that are sampled beside the carrier's turning point."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from plugins.effects._batches import RandomBatchEffect
from plugins.effects._vectors import Starts, doubles
from protocols import Contrast, Correction, EffectLayer, EffectParameters, SignalBatch, amplitude

MAP_ERROR_RATIO = 0.01
"""Relative error of the map's inductance in corners that only a sweep's dwells reach, as seen on a simulated servo."""


class SamplingOffset(RandomBatchEffect):
    """Currents are sampled tau after the turning point of a symmetric carrier, where a row begins; negative: before.

    Since the turning point the legs have supplied the volt-seconds F, and the resistance has dropped R i tau:

        i(t + tau) = i(t) + L^-1 (F - tau R i),    F_x = V_dc max(0, tau - (1 - d_x) T / 2)

    for each leg, T the carrier's period, d its duty with the zero sequence that centres the pulses; before the turning
    point F is that of the row before with the opposite sign. Within the zero vector F is zero and the current only
    decays. The flux still belongs to the reading, and the voltage of an interval becomes

        v_k + (F_k+1 - F_k) / Ts - tau R (i_k+1 - i_k) / Ts - R L^-1 (tau R i - F),

    the last term averaged over both rows, to first order in tau R / L with the model's L^-1. The devices' drop in the
    zero vector is neglected: it is much smaller than R i where tau R / L matters.
    Source: D. G. Holmes, T. A. Lipo, Pulse Width Modulation for Power Converters, IEEE Press 2003, chapter 5,
    doi:10.1109/9780470546284 (the duties).
    """

    name: ClassVar[str] = "sampling_offset"
    summary: ClassVar[str] = "The currents are read beside the turning point of the carrier, and hold ripple."
    signature: ClassVar[str] = (
        "R_s against the heat: holds along d and along q differ, as their inverse inductances, and exchange that "
        "as the rotor turns."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.DELAY
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_ANGLE,)
    gauge: ClassVar[str] = "Within the zero vector the inductance grows by tau R_s, as the map's own would."

    class Parameters(EffectParameters):
        offset_s: float = amplitude("s", typical=5e-6, prior_width=5e-6, low=-2e-5, high=2e-5)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """The mean voltage between readings, minus the resistive drop that their mean current does not include."""
        return Correction(v_ab=_between_readings(*_facts(batch), p.offset_s, doubles(batch.sampling_frequency_hz)))

    def random_directions_batch(self, batch: SignalBatch, p: Parameters) -> list[Correction]:
        """That resistive drop depends on the map's L, which is uncertain in the corners of the map."""
        return [Correction(v_ab=_with_random_direction(*_facts(batch), p.offset_s))]


def _facts(batch: SignalBatch) -> tuple[Array, Array, Array, Array, Array, Starts, Array]:
    """Arguments of `_given`, the model's inductance (empty without one), bounds and carrier periods of segments."""
    inductance = np.zeros((0, 3)) if batch.inductance_ab is None else doubles(batch.inductance_ab)
    courses = (doubles(batch.v_ab), doubles(batch.i_ab), doubles(batch.resistance_ohm), doubles(batch.v_dc))
    return *courses, inductance, batch.starts, doubles(1.0 / batch.pwm_frequency_hz)


@njit(cache=True, nogil=True)
def _between_readings(
    v_ab: Array,
    i_ab: Array,
    ohm: Array,
    v_dc: Array,
    inductance_ab: Array,
    starts: Starts,
    periods_s: Array,
    offset_s: float,
    rates_hz: Array,
) -> Array:
    """The mean voltage (N, 2) between readings, including `_given`, minus the additional resistive drop."""
    out = np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        first, last, rate_hz = starts[s], starts[s + 1] - 1, rates_hz[s]
        given = _given(v_ab, i_ab, ohm, v_dc, first, first, offset_s, periods_s[s])
        beside = _moved(inductance_ab, first, given)
        for k in range(first, last + 1):
            now, was = given, beside
            if k < last:
                given = _given(v_ab, i_ab, ohm, v_dc, k + 1, first, offset_s, periods_s[s])
                beside = _moved(inductance_ab, k + 1, given)
            out[k, 0] = v_ab[k, 0] + rate_hz * (given[0] - now[0]) + 0.5 * ohm[k] * (was[0] + beside[0])
            out[k, 1] = v_ab[k, 1] + rate_hz * (given[1] - now[1]) + 0.5 * ohm[k] * (was[1] + beside[1])
    return out


@njit(cache=True, nogil=True)
def _with_random_direction(
    v_ab: Array,
    i_ab: Array,
    ohm: Array,
    v_dc: Array,
    inductance_ab: Array,
    starts: Starts,
    periods_s: Array,
    offset_s: float,
) -> Array:
    """The voltage (N, 2) changed by one standard deviation of the additional resistive drop."""
    out = np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        for k in range(starts[s], starts[s + 1]):
            given = _given(v_ab, i_ab, ohm, v_dc, k, starts[s], offset_s, periods_s[s])
            beside = _moved(inductance_ab, k, given)
            out[k, 0] = v_ab[k, 0] + MAP_ERROR_RATIO * (ohm[k] * beside[0])
            out[k, 1] = v_ab[k, 1] + MAP_ERROR_RATIO * (ohm[k] * beside[1])
    return out


@njit(cache=True, nogil=True, inline="always")
def _given(
    v_ab: Array, i_ab: Array, ohm: Array, v_dc: Array, k: int, first: int, offset_s: float, period_s: float
) -> tuple[float, float]:
    """Volt-seconds F - tau R i from row k's turning point to its reading; `first` is the segment's first row."""
    given_a, given_b = -offset_s * ohm[k] * i_ab[k, 0], -offset_s * ohm[k] * i_ab[k, 1]
    beyond = abs(offset_s) - 0.25 * period_s
    row = k if offset_s > 0.0 else max(k - 1, first)
    a, b, c = phases_of(v_ab[row, 0], v_ab[row, 1])
    centre = 0.5 * (max(a, b, c) + min(a, b, c))
    # A leg with a higher voltage rises earlier, by half a period for the whole bus voltage.
    early = 0.5 * period_s / v_dc[row]
    if beyond + early * (max(a, b, c) - centre) <= 0.0:
        return given_a, given_b
    alpha, beta = vector_of(
        max(0.0, beyond + early * (a - centre)),
        max(0.0, beyond + early * (b - centre)),
        max(0.0, beyond + early * (c - centre)),
    )
    volts = v_dc[row] if offset_s > 0.0 else -v_dc[row]
    return given_a + volts * alpha, given_b + volts * beta


@njit(cache=True, nogil=True, inline="always")
def _moved(inductance_ab: Array, k: int, flux: tuple[float, float]) -> tuple[float, float]:
    """Current for a flux by the model's inductance at row k; zero without a model."""
    if inductance_ab.shape[0] == 0:
        return 0.0, 0.0
    aa, ab, bb = inductance_ab[k, 0], inductance_ab[k, 1], inductance_ab[k, 2]
    det = aa * bb - ab * ab
    return (bb * flux[0] - ab * flux[1]) / det, (aa * flux[1] - ab * flux[0]) / det
