"""Resistance that is not one constant: phases that differ, a winding that warms up, skin effect in the ripple."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.frames import from_phases, to_phases
from orchestrator.numerics.types import Array
from plugins.effects._filters import low_pass
from protocols import EffectLayer, EffectParameter, ParameterRole, Signals


class PhaseResistanceImbalance:
    """Extra resistance in phases a and b beside phase c's: e = T (r_a i_a, r_b i_b, 0) [V], r in ohm."""

    name: ClassVar[str] = "phase_resistance_imbalance"
    summary: ClassVar[str] = "The phases differ in resistance."
    signature: ClassVar[str] = "Anisotropic resistance while the inductance stays symmetric."
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    family: ClassVar[str] = "phase_resistance"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("signal injection: the inductance stays isotropic",)
    gauge: ClassVar[str] = "Extra resistance common to all phases is R_s."
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="extra_a_ohm", unit="ohm", typical=0.02, prior_width=0.1, low=-2.0, high=2.0, neutral=0.0),
        EffectParameter(name="extra_b_ohm", unit="ohm", typical=0.02, prior_width=0.1, low=-2.0, high=2.0, neutral=0.0),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Subtract what the extra resistances drop, at the mean current of each interval."""
        extra = np.array([values["extra_a_ohm"], values["extra_b_ohm"], 0.0])
        if not extra.any() or not signals.bridge_on:
            return signals
        mean = 0.5 * (signals.i_ab + np.concatenate([signals.i_ab[1:], signals.i_ab[-1:]]))
        return signals.model_copy(update={"v_ab": signals.v_ab - from_phases(to_phases(mean) * extra)})


class WindingHeating:
    """Copper that warms up: R = R_0 (1 + a y), tau dy/dt = P - y, P the copper loss [W].

    a = alpha R_th [1/W], alpha = 0.39 %/K for copper; tau is the winding's thermal time constant [s].
    In the flexible form a `slow_share` of the rise comes later,
    as the iron around the copper warms up: with `slow_ratio` times tau.
    """

    name: ClassVar[str] = "winding_heating"
    summary: ClassVar[str] = "The winding warms up under its own loss, and its resistance rises."
    signature: ClassVar[str] = (
        "A residual along the current that grows with the loss so far, and is absent from the ripple."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    family: ClassVar[str] = "heating"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("repeat an anchor point at the end", "let it cool down and repeat")
    gauge: ClassVar[str] = "R_0 is the resistance at the temperature of the experiment's start."
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            name="rise_per_watt", unit="1/W", typical=0.003, prior_width=0.005, low=-0.05, high=0.1, neutral=0.0
        ),
        EffectParameter(
            name="time_constant_s",
            unit="s",
            typical=200.0,
            prior_width=1.0,
            low=5.0,
            high=20000.0,
            neutral=200.0,
            role=ParameterRole.SHAPE,
        ),
        EffectParameter(
            name="slow_share",
            unit="1",
            typical=0.0,
            prior_width=0.4,
            low=0.0,
            high=0.95,
            neutral=0.0,
            role=ParameterRole.REFINEMENT,
        ),
        EffectParameter(
            name="slow_ratio",
            unit="1",
            typical=6.0,
            prior_width=4.0,
            low=3.0,
            high=40.0,
            neutral=6.0,
            role=ParameterRole.REFINEMENT,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Raise the resistance by what the loss so far has warmed."""
        if values["rise_per_watt"] == 0.0:
            return signals
        tau = values["time_constant_s"]
        if signals.losses is None:
            # No history: as if nothing had been lost to the surroundings.
            warm = signals.heat_j / tau
        else:
            warm = _warmth(
                np.ascontiguousarray(signals.losses.time_s, dtype=np.float64),
                np.ascontiguousarray(signals.losses.power_w, dtype=np.float64),
                values["rise_per_watt"],
                np.array([tau, values.get("slow_ratio", 6.0) * tau]),
                values.get("slow_share", 0.0),
                signals.start_s,
                1.0 / signals.sampling_frequency_hz,
                len(signals.v_dc),
            )
        factor = 1.0 + values["rise_per_watt"] * warm
        return signals.model_copy(update={"resistance_ohm": signals.resistance_ohm * factor})


@njit(cache=True, nogil=True)
def _warmth(
    time_s: Array,
    power_w: Array,
    rise: float,
    constants_s: Array,
    slow_share: float,
    start_s: float,
    step_s: float,
    n: int,
) -> Array:
    """Lagged loss at the n samples from `start_s` on; a warmer winding loses more: P = P_0 (1 + a y)."""
    out = np.empty(n)
    fast, slow, before, after = 0.0, 0.0, 0.0, 0.0
    m, k = 0, 0
    while k < n:
        now = start_s + k * step_s
        while m + 1 < time_s.shape[0] and time_s[m] <= now:
            span = time_s[m + 1] - time_s[m]
            power = power_w[m] * (1.0 + rise * after)
            fast += (1.0 - math.exp(-span / constants_s[0])) * (power - fast)
            slow += (1.0 - math.exp(-span / constants_s[1])) * (power - slow)
            before, after = after, (1.0 - slow_share) * fast + slow_share * slow
            m += 1
        # Between the steps on both sides; beyond the last one as at its end.
        reached, end = time_s[max(m - 1, 0)], time_s[m]
        while k < n and (m + 1 == time_s.shape[0] or start_s + k * step_s < end):
            part = (start_s + k * step_s - reached) / (end - reached) if end > reached else 1.0
            out[k] = before + min(max(part, 0.0), 1.0) * (after - before)
            k += 1
    return out


class SkinEffect:
    """Extra resistance for what changes fast: e = R_x (i - i_slow) [V], i_slow behind a first-order corner.

    R_x in ohm, the corner in Hz. It stands for the current that is crowded to the conductors' surface. In the flexible
    form half of it has its corner below and half above, by the factor exp(sqrt(`variance`)).
    """

    name: ClassVar[str] = "skin_effect"
    summary: ClassVar[str] = "The ripple sees more resistance than the direct current."
    signature: ClassVar[str] = "Ripple in phase with the ripple current."
    layer: ClassVar[EffectLayer] = EffectLayer.RESISTANCE
    family: ClassVar[str] = "ripple_loss"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("inject at a second frequency",)
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="extra_ohm", unit="ohm", typical=1.0, prior_width=1.5, low=-10.0, high=20.0, neutral=0.0),
        EffectParameter(
            name="corner_hz",
            unit="Hz",
            typical=60.0,
            prior_width=1.0,
            low=5.0,
            high=1000.0,
            neutral=60.0,
            role=ParameterRole.SHAPE,
        ),
        EffectParameter(
            name="variance",
            unit="1",
            typical=0.0,
            prior_width=0.4,
            low=0.0,
            high=4.0,
            neutral=0.0,
            role=ParameterRole.REFINEMENT,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Subtract what the extra resistance drops, at the mean current of each interval."""
        if values["extra_ohm"] == 0.0 or not signals.bridge_on:
            return signals
        rate = 2.0 * math.pi * values["corner_hz"] / signals.sampling_frequency_hz
        spread = math.sqrt(values.get("variance", 0.0))
        i = np.ascontiguousarray(signals.i_ab, dtype=np.float64)
        if spread > 0.0:
            parts = [low_pass(i, math.exp(-rate * math.exp(side * spread))) for side in (-1.0, 1.0)]
            fast = i - 0.5 * (parts[0] + parts[1])
        else:
            fast = i - low_pass(i, math.exp(-rate))
        mean = 0.5 * (fast + np.concatenate([fast[1:], fast[-1:]]))
        return signals.model_copy(update={"v_ab": signals.v_ab - values["extra_ohm"] * mean})
