"""The effect's conformance kit. Whether an effect has the right sign and size is for the plugin's own tests."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from orchestrator.testing._kit import PLUGIN_NAME, Kit
from orchestrator.testing._signals import SIGNAL_ARRAYS, exciting_signals, largest_change
from protocols import Effect, EffectLayer, ParameterRole, Signals

VISIBLE = 1e-6
"""Smallest change by a typical effect, relative to the largest value of the signal it acts on."""
NEUTRAL = 1e-3
"""Largest change at the neutral values, as a part of the change at the typical ones."""


class EffectConformance(Kit, ABC):
    """Says whether an effect plugin keeps the contract of `protocols.Effect`.

    Subclass it in a test file, in a class whose name begins with ``Test``, and give one method,
    ``make_effect()``. Where the kit's signals (a saturation-free motor under trapezoids with
    injection, warming up, rotor at 0.4 rad) do not excite the effect, override ``signals()``.
    """

    @abstractmethod
    def make_effect(self) -> Effect:
        """A new effect."""

    def signals(self) -> Signals:
        """Signals in which the effect shows."""
        return exciting_signals()

    def _values(self, which: str) -> dict[str, float]:
        return {parameter.name: getattr(parameter, which) for parameter in self.make_effect().parameters}

    def _correct(self, values: Mapping[str, float]) -> Signals:
        return self.make_effect().correct(self.signals(), values)

    def test_entry_point_leads_to_the_effect(self) -> None:
        self.require_entry_point("fluxbench.effects", type(self.make_effect()))

    def test_class_keeps_the_contract(self) -> None:
        effect = self.make_effect()
        assert isinstance(effect, Effect), "methods or attributes of protocols.Effect are missing"
        assert isinstance(effect.layer, EffectLayer), f"layer is {effect.layer!r}; expected an EffectLayer"
        for text in ("summary", "signature", "family"):
            assert getattr(effect, text).strip(), f"{text} is empty"
        for group in ("twins", "experiments"):
            assert all(entry.strip() for entry in getattr(effect, group)), f"{group} holds an empty entry"
        assert effect.experiments or not effect.twins, "twins without an experiment that tells them apart"
        assert effect.name not in effect.twins, "an effect is not its own twin"

    def test_parameters_are_coherent(self) -> None:
        parameters = self.make_effect().parameters
        assert parameters, "an effect without a parameter cannot be fitted"
        names = [p.name for p in parameters]
        assert len(set(names)) == len(names), f"parameter names repeat: {names}"
        for p in parameters:
            assert PLUGIN_NAME.match(p.name), f"{p.name!r} is no name for a parameter"
            assert p.unit.strip(), f"{p.name}: no unit (a plain ratio has the unit 1)"
            numbers = (p.low, p.high, p.neutral, p.typical, p.prior_width)
            assert all(map(math.isfinite, numbers)), f"{p.name}: not all numbers are finite"
            assert p.low < p.high, f"{p.name}: low is not below high"
            assert p.low <= p.neutral <= p.high, f"{p.name}: neutral is out of bounds"
            assert p.low <= p.typical <= p.high, f"{p.name}: typical is out of bounds"
            assert p.prior_width > 0.0, f"{p.name}: prior_width must be positive"
            assert p.role is not ParameterRole.SHAPE or p.low > 0.0, f"{p.name}: a shape is positive, its low is not"
        amplitudes = [p for p in parameters if p.role is ParameterRole.AMPLITUDE]
        assert amplitudes, "no parameter has the role of an amplitude"
        for p in amplitudes:
            assert p.typical != p.neutral, f"{p.name}: an amplitude whose typical value is the neutral one"

    def test_neutral_values_change_nothing(self) -> None:
        change = largest_change(self.signals(), self._correct(self._values("neutral")))
        assert change <= self._unseen(), f"the neutral values change a signal by {change:.2g} of its size"

    def _unseen(self) -> float:
        """Change that counts as none: a neutral value that is a bound only comes near to it."""
        if not any(p.strong_when_small for p in self.make_effect().parameters):
            return 1e-9
        return NEUTRAL * largest_change(self.signals(), self._correct(self._values("typical")))

    def test_nothing_happens_while_all_amplitudes_are_neutral(self) -> None:
        parameters = self.make_effect().parameters
        silenced = {p.name: p.neutral for p in parameters if p.role is ParameterRole.AMPLITUDE}
        change = largest_change(self.signals(), self._correct(self._values("typical") | silenced))
        assert change <= self._unseen(), f"with neutral amplitudes, shapes alone change a signal by {change:.2g}"

    def test_typical_values_show(self) -> None:
        change = largest_change(self.signals(), self._correct(self._values("typical")))
        assert change >= VISIBLE, f"the typical values change no signal by more than {change:.2g} of its size"

    def test_input_is_not_modified(self) -> None:
        signals = self.signals()
        before = {name: getattr(signals, name).tobytes() for name in SIGNAL_ARRAYS}
        for name in SIGNAL_ARRAYS:
            getattr(signals, name).flags.writeable = False
        self.make_effect().correct(signals, self._values("typical"))
        changed = [name for name in SIGNAL_ARRAYS if getattr(signals, name).tobytes() != before[name]]
        assert not changed, f"modified in place: {changed}"

    def test_same_input_gives_the_same_output(self) -> None:
        effect, values = self.make_effect(), self._values("typical")
        first = effect.correct(self.signals(), values)
        effect.correct(exciting_signals(seed=7), values)
        second = effect.correct(self.signals(), values)
        apart = largest_change(first, second)
        assert apart == 0.0, "an earlier call is remembered: effects are pure functions"

    def test_shape_and_clock_are_kept(self) -> None:
        before, after = self.signals(), self._correct(self._values("typical"))
        assert isinstance(after, Signals), f"correct returned {type(after).__name__}"
        for name in ("start_s", "sampling_frequency_hz", "pwm_frequency_hz"):
            assert getattr(after, name) == getattr(before, name), f"{name} was changed"
        for name in SIGNAL_ARRAYS:
            assert getattr(after, name).shape == getattr(before, name).shape, f"{name} has another shape"

    def test_every_value_within_bounds_gives_finite_signals(self) -> None:
        for parameter in self.make_effect().parameters:
            for bound in ("low", "high"):
                values = self._values("typical") | {parameter.name: getattr(parameter, bound)}
                after = self._correct(values)
                for name in SIGNAL_ARRAYS:
                    assert np.isfinite(getattr(after, name)).all(), f"{name} not finite at {bound} of {parameter.name}"
