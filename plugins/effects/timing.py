"""Errors in time: voltage that acts late, and a current sensor that lags."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from protocols import Contrast, Correction, EffectLayer, EffectParameters, Signals, amplitude


class VoltageDelay:
    """v(t - T_d) [V]: each command acts T_d later than the record says; T_d in s.

    Over one interval the mean voltage is then (1 - T_d/Ts) v_k + (T_d/Ts) v_k-1.
    A whole sample at 4 kHz is within the bounds.
    """

    name: ClassVar[str] = "voltage_delay"
    summary: ClassVar[str] = "The voltage acts later than commanded."
    signature: ClassVar[str] = "Ripple in quadrature, at the edges of the injected wave."
    layer: ClassVar[EffectLayer] = EffectLayer.DELAY
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_INJECTION_FREQUENCY,)
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        delay_s: float = amplitude("s", typical=1e-5, prior_width=2e-5, low=-1e-4, high=3e-4)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """The mean voltage of each interval."""
        late = p.delay_s * signals.sampling_frequency_hz
        whole = math.floor(late)
        part = late - whole
        index = np.arange(len(signals.v_ab))
        near = np.clip(index - whole, 0, len(index) - 1)
        far = np.clip(index - whole - 1, 0, len(index) - 1)
        return Correction(v_ab=(1.0 - part) * signals.v_ab[near] + part * signals.v_ab[far])


class CurrentFilter:
    """First-order lag of the current sensors: tau dm/dt = i - m [A], tau in s.

    While tau is well below a sampling interval, a sample lags a current that is piecewise linear by tau times
    its slope in the interval before: i = m + tau di/dt. Where it is long it falls with the ripple's frequency; a
    delay of the voltage does not. A lead is none: a wrong declared delay is the voltage's.
    """

    name: ClassVar[str] = "current_filter"
    summary: ClassVar[str] = "The current sensors lag."
    signature: ClassVar[str] = "Ripple in quadrature, as from a late voltage, but acting on the current."
    layer: ClassVar[EffectLayer] = EffectLayer.CURRENT_SENSORS
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_INJECTION_FREQUENCY,)
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        time_constant_s: float = amplitude("s", typical=5e-6, prior_width=1e-5, low=0.0, high=3e-5)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """The current before the lag."""
        i = signals.i_ab
        if signals.i_smooth_ab is not None:
            # A slope with the reading's own noise in it would be taken for signal by a fit. Where a model on trial
            # leads the smooth current far away, the reading leads it back.
            span = np.ptp(i, axis=0)
            i = np.clip(signals.i_smooth_ab, i - span, i + span)
        part = p.time_constant_s * signals.sampling_frequency_hz
        return Correction(i_ab=signals.i_ab + part * np.diff(i, axis=0, prepend=i[:1]))
