"""Variable resistance: imbalance of phases, heating, temperature, and skin effect in the ripple."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.frames import from_phases, to_phases
from orchestrator.numerics.types import Array
from plugins.effects._batches import BatchEffect
from plugins.effects._filters import high_pass_means
from plugins.effects._losses import along_losses
from plugins.effects._vectors import doubles, minus_interval_means
from protocols import (
    Contrast,
    Correction,
    DriveRecord,
    EffectLayer,
    EffectParameters,
    LossHistory,
    SegmentDependentEffect,
    SignalBatch,
    Signals,
    amplitude,
    refinement,
    shape,
)

COPPER_PER_K = 0.00393
"""Relative change of copper's resistance, at 20 degrees Celsius."""


class PhaseResistanceImbalance(BatchEffect):
    """Resistance of phases a and b in excess of phase c's: e = T (r_a i_a, r_b i_b, 0) [V], T Clarke's.

    In the flexible form it heats up, like a bad joint: r (1 + `rise_per_watt` y), y the winding's loss through a lag of
    `rise_s`; the distribution of the loss over the phases is neglected.
    """

    name: ClassVar[str] = "phase_resistance_imbalance"
    summary: ClassVar[str] = "The phases differ in resistance."
    signature: ClassVar[str] = (
        "Residual against each phase's current: one phase's slope differs from the others'; the ripple is as the "
        "model's."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = (
        "Extra resistance common to all phases is R_s; a leg whose voltage gain exceeds one looks "
        "the same at one rotor angle."
    )

    at_the_bench: ClassVar[str] = (
        "measure between each pair of terminals with four wires: of three pairs, the two with the odd phase differ"
    )

    class Parameters(EffectParameters):
        extra_a_ohm: float = amplitude("ohm", typical=0.02, prior_width=0.1, low=-2.0, high=2.0)
        extra_b_ohm: float = amplitude("ohm", typical=0.02, prior_width=0.1, low=-2.0, high=2.0)
        rise_per_watt: float = refinement("1/W", neutral=0.0, prior_width=0.005, low=0.0, high=0.1)
        rise_s: float = refinement("s", neutral=30.0, prior_width=30.0, low=1.0, high=1000.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the drop of the extra resistances at the mean current of each interval."""
        ohm = from_phases(to_phases(np.eye(2)) * np.array([p.extra_a_ohm, p.extra_b_ohm, 0.0]))
        i_ab = batch.i_ab
        if p.rise_per_watt > 0.0:
            risen = _warm(batch, 0.0, np.full(2, p.rise_s), 0.0)
            risen *= p.rise_per_watt
            risen += 1.0
            i_ab = i_ab * risen[:, None]
        return Correction(v_ab=minus_interval_means(batch.v_ab, batch.starts, i_ab, ohm))


class WindingHeating(BatchEffect):
    """Winding heating: R = R_0 (1 + a y), tau dy/dt = P - y, P the copper loss [W].

    a = alpha R_th [1/W], alpha = 0.39 %/K for copper; tau is the winding's thermal time constant [s]. In the flexible
    form a `slow_share` of the rise has the time constant `slow_ratio` tau of the iron around the copper.
    """

    name: ClassVar[str] = "winding_heating"
    summary: ClassVar[str] = "The winding warms up under its own loss, and its resistance rises."
    signature: ClassVar[str] = (
        "R_s against the heat: it rises. Residuals along the current, with its sign, grow as the winding warms; "
        "none in the ripple."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    needs: ClassVar[tuple[Contrast, ...]] = ()
    remedy: ClassVar[str] = "the winding's R_s is the cold one of model.json, and rises by so much with its loss"
    gauge: ClassVar[str] = (
        "R_s is the resistance at the experiment's start temperature; the thermal resistance is a copper winding's."
    )

    at_the_bench: ClassVar[str] = "log the winding's temperature, and leave pauses between currents"

    class Parameters(EffectParameters):
        rise_per_watt: float = amplitude("1/W", typical=0.003, prior_width=0.005, low=0.0, high=0.1)
        time_constant_s: float = shape("s", typical=200.0, prior_width=1.0, low=1.0, high=20000.0)
        slow_share: float = refinement("1", neutral=0.0, prior_width=0.4, low=0.0, high=0.95)
        slow_ratio: float = refinement("1", neutral=6.0, prior_width=4.0, low=3.0, high=40.0)

    def derived(self, p: Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
        """The thermal resistance R_th = a / alpha, of a copper winding."""
        return {"thermal_resistance": (p.rise_per_watt / COPPER_PER_K, "K/W")}

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Raise the resistance by the heating so far."""
        warm = _warm(batch, p.rise_per_watt, p.time_constant_s * np.array([1.0, p.slow_ratio]), p.slow_share)
        warm *= p.rise_per_watt
        warm += 1.0
        warm *= batch.resistance_ohm
        return Correction(resistance_ohm=warm)


def _warm(batch: SignalBatch, rise: float, constants_s: Array, slow_share: float) -> Array:
    """The copper loss through lags of two time constants, at the samples [W], shape (N,); as `_warmth`."""

    def warm(losses: LossHistory) -> Array:
        return np.asarray(_warmth(doubles(losses.time_s), doubles(losses.power_w), rise, constants_s, slow_share))

    # Without a history: adiabatic heating.
    return along_losses(batch, warm, lambda: batch.heat_j / constants_s[0])


@njit(cache=True, nogil=True)
def _warmth(time_s: Array, power_w: Array, rise: float, constants_s: Array, slow_share: float) -> Array:
    """Lagged loss at the times of a history, from zero; a warmer winding loses more: P = P_0 (1 + a y)."""
    out = np.zeros(time_s.shape[0])
    fast, slow = 0.0, 0.0
    for m in range(time_s.shape[0] - 1):
        span = time_s[m + 1] - time_s[m]
        power = power_w[m] * (1.0 + rise * out[m])
        fast += (1.0 - math.exp(-span / constants_s[0])) * (power - fast)
        slow += (1.0 - math.exp(-span / constants_s[1])) * (power - slow)
        out[m + 1] = (1.0 - slow_share) * fast + slow_share * slow
    return out


class ResistanceWithTemperature(BatchEffect, SegmentDependentEffect):
    """Resistance that follows the logged temperature: R = R_0 (1 + alpha (T - T_0)), T_0 the first that was logged.

    alpha [1/K] is 0.39 %/K for a thermometer in a copper winding, less where only a part of the resistance follows the
    thermometer: the transistors' r_on on the heat sink, or a winding that it is not in.
    """

    name: ClassVar[str] = "resistance_with_temperature"
    summary: ClassVar[str] = "The resistance follows the temperature that was logged."
    signature: ClassVar[str] = (
        "R_s against the heat: it rises and falls with the thermometer, as do residuals along the current, with "
        "its sign."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "R_s is the resistance at the first temperature that was logged."

    class Parameters(EffectParameters):
        per_k: float = amplitude("1/K", typical=0.0039, prior_width=0.004, low=0.0, high=0.02)

    def shows_in(self, signals: Signals) -> bool:
        """Whether a logged temperature differs from the first one by at least a kelvin."""
        return signals.temperature_c is not None and float(np.abs(_warmer_k(signals)).max()) >= 1.0

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Scale the resistance with the temperature; segments without a thermometer are unchanged."""
        if all(s.temperature_c is None for s in batch.segments):
            return Correction()
        warmer_k = np.concatenate([_warmer_k(s) for s in batch.segments])
        return Correction(resistance_ohm=batch.resistance_ohm * (1.0 + p.per_k * warmer_k))


def _warmer_k(signals: Signals) -> Array:
    """Temperature minus the first reading [K], shape (n,); zeros without a thermometer."""
    if signals.temperature_c is None:
        return np.zeros(len(signals.v_dc))
    first = signals.temperature_c[0] if signals.start_temperature_c is None else signals.start_temperature_c
    return np.asarray(signals.temperature_c - first, dtype=np.float64)


class SkinEffect(BatchEffect):
    """More resistance and less inductance for fast currents: e = R_x (i - i_slow) [V], i_slow behind a first-order lag.

    R_x in ohm, the corner frequency w_c / 2 pi in Hz. At the frequency w the resistance is larger by
    R_x w^2 / (w^2 + w_c^2), and the inductance by R_x w_c / (w^2 + w_c^2), which falls as w rises. It models current
    displacement in the conductors, and eddy currents in solid parts such as magnets and housing: a shorted turn that
    couples to the winding has this law. In the flexible form `low_share` of it has a corner lower, and the rest one
    higher, by the factor exp(sqrt(`variance`)).
    """

    name: ClassVar[str] = "skin_effect"
    summary: ClassVar[str] = "The ripple sees more resistance and less inductance than slow currents."
    signature: ClassVar[str] = (
        "Ripple: larger than the model's, in a flux loop that is steeper: the sweep shows more inductance than "
        "the ripple, and the fitted map lies between."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    at_the_bench: ClassVar[str] = (
        "measure resistance and inductance with a bridge at two frequencies, below and above the corner"
    )

    class Parameters(EffectParameters):
        extra_ohm: float = amplitude("ohm", typical=1.0, prior_width=1.5, low=0.0, high=20.0)
        corner_hz: float = shape("Hz", typical=60.0, prior_width=1.0, low=5.0, high=1000.0)
        variance: float = refinement("1", neutral=0.0, prior_width=0.4, low=0.0, high=4.0)
        low_share: float = refinement("1", neutral=0.5, prior_width=0.2, low=0.05, high=0.95)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the mean drop of the extra resistance in each interval."""
        rates = doubles(2.0 * math.pi * p.corner_hz / batch.sampling_frequency_hz)
        spread = math.sqrt(p.variance)
        # The readings' fast noise would be amplified.
        i = doubles(batch.i_ab if batch.i_smooth_ab is None else batch.i_smooth_ab)
        fast = high_pass_means(i, batch.starts, rates * math.exp(-spread))
        if spread > 0.0:
            faster = high_pass_means(i, batch.starts, rates * math.exp(spread))
            fast *= p.low_share
            faster *= 1.0 - p.low_share
            fast += faster
        fast *= -p.extra_ohm
        fast += batch.v_ab
        return Correction(v_ab=fast)
