"""The effect's conformance kit. Whether an effect has the right sign and size is for the plugin's own tests."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from orchestrator.registry.plugin_methods import hook_problem
from orchestrator.registry.plugins import PLUGIN_NAME
from orchestrator.testing._effect_batches import EffectBatchChecks
from orchestrator.testing._effect_physics import EffectPhysicsChecks
from orchestrator.testing._kit import Kit
from orchestrator.testing._signals import SIGNAL_ARRAYS, exciting_signals, largest_change
from protocols import Contrast, Correction, Effect, EffectLayer, ParameterRole, Signals, hook_of


class EffectConformance(EffectPhysicsChecks, EffectBatchChecks, Kit, ABC):
    """Checks that an effect plugin keeps the contract of `protocols.Effect`.

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

    def _corrected(self, values: Mapping[str, float]) -> Signals:
        effect, signals = self.make_effect(), self.signals()
        return signals.corrected(effect.correct(signals, effect.Parameters(**values)))

    def test_entry_point_leads_to_the_effect(self) -> None:
        self.require_entry_point("fluxbench.effects", type(self.make_effect()))

    def test_class_keeps_the_contract(self) -> None:
        effect = self.make_effect()
        assert isinstance(effect, Effect), "methods or attributes of protocols.Effect are missing"
        assert isinstance(effect.layer, EffectLayer), f"layer is {effect.layer!r}; expected an EffectLayer"
        for text in ("summary", "signature"):
            assert getattr(effect, text).strip(), f"{text} is empty"
        problem = hook_problem(type(effect))
        assert problem is None, problem
        unknown = [need for need in effect.needs if not isinstance(need, Contrast)]
        assert not unknown, f"needs holds {unknown}; expected members of protocols.Contrast"

    def test_parameters_can_be_fitted(self) -> None:
        parameters = self.make_effect().Parameters.declared()
        for p in parameters:
            assert PLUGIN_NAME.match(p.name), f"{p.name!r} is no name for a parameter"
            assert p.problem() is None, f"{p.name}: {p.problem()}"
        assert any(p.role is ParameterRole.AMPLITUDE for p in parameters), "no parameter has the role of an amplitude"

    def test_neutral_values_change_nothing(self) -> None:
        change = largest_change(self.signals(), self._corrected(self._values("neutral")))
        assert change <= self._unseen(), (
            f"with every parameter at its neutral value a signal changes by {change:.2g} of its size; expected none"
        )

    def _unseen(self) -> float:
        """Change that counts as none: a neutral value that is a bound only comes near to it."""
        if not any(p.strong_when_small for p in self.make_effect().Parameters.declared()):
            return 1e-9
        return 1e-3 * largest_change(self.signals(), self._corrected(self._values("typical")))

    def test_nothing_happens_while_all_amplitudes_are_neutral(self) -> None:
        parameters = self.make_effect().Parameters.declared()
        silenced = {p.name: p.neutral for p in parameters if p.role is ParameterRole.AMPLITUDE}
        change = largest_change(self.signals(), self._corrected(self._values("typical") | silenced))
        assert change <= self._unseen(), (
            f"with all amplitudes neutral and the shapes typical a signal changes by {change:.2g} of its size: only an "
            "amplitude may make the effect appear"
        )

    def test_typical_values_show(self) -> None:
        """By a millionth at least of the largest value of a signal that they act on."""
        change = largest_change(self.signals(), self._corrected(self._values("typical")))
        assert change >= 1e-6, (
            f"with typical values no signal changes by more than {change:.2g} of its size, at least 1e-6 is expected: "
            "the typical values are too small, or override signals() with some in which the effect shows"
        )

    def test_input_is_not_modified(self) -> None:
        effect, signals = self.make_effect(), self.signals()
        before = {name: getattr(signals, name).tobytes() for name in SIGNAL_ARRAYS}
        for name in SIGNAL_ARRAYS:
            getattr(signals, name).flags.writeable = False
        effect.correct(signals, effect.Parameters(**self._values("typical")))
        changed = [name for name in SIGNAL_ARRAYS if getattr(signals, name).tobytes() != before[name]]
        assert not changed, (
            f"correct() modified its input in place: {', '.join(changed)}; return new arrays in the Correction"
        )

    def test_same_input_gives_the_same_output(self) -> None:
        effect, signals = self.make_effect(), self.signals()
        parameters = effect.Parameters(**self._values("typical"))
        first = signals.corrected(effect.correct(signals, parameters))
        effect.correct(exciting_signals(seed=7), parameters)
        second = signals.corrected(effect.correct(signals, parameters))
        assert largest_change(first, second) == 0.0, (
            "an earlier call changes the result of the next: keep no state, use the arguments of correct() alone"
        )

    def test_a_correction_is_returned_in_the_shape_of_the_signals(self) -> None:
        effect, signals = self.make_effect(), self.signals()
        result: object = effect.correct(signals, effect.Parameters(**self._values("typical")))
        assert isinstance(result, Correction), f"correct returned {type(result).__name__} instead of a Correction"
        for name, array in result.arrays.items():
            shape = getattr(signals, name).shape
            assert array.shape == shape, f"{name} has shape {array.shape} instead of {shape}"
            assert array.dtype.kind == "f", f"{name} is of type {array.dtype}"

    def test_random_directions_are_corrections_of_finite_signals(self) -> None:
        """Of an effect that says what it cannot know."""
        effect, signals = self.make_effect(), self.signals()
        hook = hook_of(effect, "random_directions")
        for direction in () if hook is None else hook(signals, effect.Parameters(**self._values("typical"))):
            assert isinstance(direction, Correction), f"random_directions returned {type(direction).__name__}s"
            after = signals.corrected(direction)
            for name in SIGNAL_ARRAYS:
                assert getattr(after, name).shape == getattr(signals, name).shape, f"{name} has another shape"
                assert np.isfinite(getattr(after, name)).all(), f"{name} is not finite"

    def test_every_value_within_bounds_gives_finite_signals(self) -> None:
        for parameter in self.make_effect().Parameters.declared():
            for bound in ("low", "high"):
                values = self._values("typical") | {parameter.name: getattr(parameter, bound)}
                after = self._corrected(values)
                for name in SIGNAL_ARRAYS:
                    assert np.isfinite(getattr(after, name)).all(), f"{name} not finite at {bound} of {parameter.name}"
