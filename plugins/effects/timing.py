"""Errors in time: voltage that acts late, and a current sensor that lags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from protocols import EffectLayer, EffectParameter, Signals


class VoltageDelay:
    """v(t - T_d) [V]: each command acts T_d later than the record says; T_d in s.

    Over one interval the mean voltage is then (1 - T_d/Ts) v_k + (T_d/Ts) v_k-1.
    """

    name: ClassVar[str] = "voltage_delay"
    summary: ClassVar[str] = "The voltage acts later than commanded."
    signature: ClassVar[str] = "Ripple in quadrature, at the edges of the injected wave."
    layer: ClassVar[EffectLayer] = EffectLayer.DELAY
    family: ClassVar[str] = "timing"
    twins: ClassVar[tuple[str, ...]] = ("current_filter",)
    experiments: ClassVar[tuple[str, ...]] = ("inject at a second frequency", "sample the current at a second phase")
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="delay_s", unit="s", typical=1e-5, prior_width=2e-5, low=-1e-4, high=2e-4, neutral=0.0),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """The mean voltage of each interval."""
        if values["delay_s"] == 0.0:
            return signals
        late = values["delay_s"] * signals.sampling_frequency_hz
        whole = math.floor(late)
        part = late - whole
        index = np.arange(len(signals.v_ab))
        near = np.clip(index - whole, 0, len(index) - 1)
        far = np.clip(index - whole - 1, 0, len(index) - 1)
        return signals.model_copy(update={"v_ab": (1.0 - part) * signals.v_ab[near] + part * signals.v_ab[far]})


class CurrentFilter:
    """First-order lag of the current sensors: tau dm/dt = i - m [A], tau in s.

    While tau is well below a sampling interval, a sample lags a current that is piecewise linear by tau times
    its slope in the interval before: i = m + tau di/dt.
    """

    name: ClassVar[str] = "current_filter"
    summary: ClassVar[str] = "The current sensors lag."
    signature: ClassVar[str] = "Ripple in quadrature, as from a late voltage, but acting on the current."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    family: ClassVar[str] = "timing"
    twins: ClassVar[tuple[str, ...]] = ("voltage_delay",)
    experiments: ClassVar[tuple[str, ...]] = ("sample the current at a second phase",)
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            name="time_constant_s", unit="s", typical=5e-6, prior_width=1e-5, low=-3e-5, high=3e-5, neutral=0.0
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """The current before the lag."""
        if values["time_constant_s"] == 0.0:
            return signals
        # A slope with the reading's own noise in it would be taken for signal by a fit.
        i = signals.i_ab if signals.i_smooth_ab is None else signals.i_smooth_ab
        part = values["time_constant_s"] * signals.sampling_frequency_hz
        change = part * np.diff(i, axis=0, prepend=i[:1])
        return signals.model_copy(update={"i_ab": signals.i_ab + change, "i_m_ab": signals.i_m_ab + change})
