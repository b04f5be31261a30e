"""Somebody's own effects, as a file brings them along: two losses of voltage that one PWM frequency cannot part."""

from typing import ClassVar

import numpy as np

from protocols import Contrast, Correction, EffectLayer, EffectParameters, RealArray, Signals, amplitude, shape

_PHASES = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])


class _Lost:
    """A voltage against the sign of each phase current, rounded within a current."""

    signature: ClassVar[str] = "A step in each phase current."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_PWM_FREQUENCY,)
    gauge: ClassVar[str] = "What is lost in proportion to the current is resistance."

    class Parameters(EffectParameters):
        lost_v: float = amplitude("V", typical=1.0, prior_width=2.0, low=-5.0, high=5.0)
        rounding_a: float = shape("A", typical=0.05, prior_width=1.0, low=1e-3, high=1.0)

    def _signs(self, signals: Signals, p: Parameters) -> RealArray:
        mean = 0.5 * (signals.i_ab + np.concatenate([signals.i_ab[1:], signals.i_ab[-1:]]))
        return np.asarray(np.tanh(mean @ _PHASES.T / p.rounding_a) @ _PHASES * (2.0 / 3.0))


class LostAtEdges(_Lost):
    """In proportion to how often a leg switches."""

    name: ClassVar[str] = "lost_at_edges"
    summary: ClassVar[str] = "Every edge loses voltage against the current."

    def correct(self, signals: Signals, p: _Lost.Parameters) -> Correction:
        own = (signals.drive and signals.drive.pwm_frequency_hz) or signals.pwm_frequency_hz
        return Correction(v_ab=signals.v_ab - p.lost_v * signals.pwm_frequency_hz / own * self._signs(signals, p))


class LostInSwitches(_Lost):
    """Always the same."""

    name: ClassVar[str] = "lost_in_switches"
    summary: ClassVar[str] = "Every switch loses voltage against the current."

    def correct(self, signals: Signals, p: _Lost.Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab - p.lost_v * self._signs(signals, p))
