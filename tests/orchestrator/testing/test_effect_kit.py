"""The effect kit passes an effect that keeps the contract, and fails each one that breaks it in one way."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.testing import EffectConformance
from protocols import Effect, EffectLayer, EffectParameter, ParameterRole, Signals
from tests.orchestrator.testing.kit_runner import failures

BIAS = EffectParameter(name="bias_a_v", unit="V", typical=0.15, prior_width=0.3, low=-2.0, high=2.0, neutral=0.0)


class ExampleEffect:
    """A constant error of the voltage along alpha."""

    name: ClassVar[str] = "example"
    summary: ClassVar[str] = "The voltage is off by a constant."
    signature: ClassVar[str] = "A constant residual in the stator frame."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    family: ClassVar[str] = "bias"
    twins: ClassVar[tuple[str, ...]] = ("current_offset",)
    experiments: ClassVar[tuple[str, ...]] = ("a reading with the gates off",)
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (BIAS,)

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        return signals.model_copy(update={"v_ab": signals.v_ab - [values["bias_a_v"], 0.0]})


def kit_for(effect: type[ExampleEffect]) -> EffectConformance:
    class Kit(EffectConformance):
        registered = False

        def make_effect(self) -> Effect:
            return effect()

    return Kit()


def test_passes_an_effect_that_keeps_the_contract(tmp_path: Path) -> None:
    assert failures(kit_for(ExampleEffect), tmp_path) == {}


class SeenThroughAResistor(ExampleEffect):
    """Absent at an infinite resistance, for which the bound stands."""

    parameters = (
        EffectParameter(
            name="core_loss_ohm",
            unit="ohm",
            typical=1e3,
            prior_width=1e3,
            low=100.0,
            high=1e7,
            neutral=1e7,
            strong_when_small=True,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        return signals.model_copy(update={"i_m_ab": signals.i_m_ab - signals.v_ab / values["core_loss_ohm"]})


def test_passes_an_effect_that_is_absent_only_in_the_limit(tmp_path: Path) -> None:
    assert failures(kit_for(SeenThroughAResistor), tmp_path) == {}


class NotNeutralAtNeutral(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        return super().correct(signals, {"bias_a_v": values["bias_a_v"] + 1e-3})


class DoesNothing(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        return signals


class WorksInPlace(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        signals.v_ab[:, 0] -= values["bias_a_v"]
        return signals


class WorksAroundTheLock(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        signals.v_ab.flags.writeable = True
        signals.v_ab[:, 0] -= values["bias_a_v"]
        return signals


class Remembers(ExampleEffect):
    def __init__(self) -> None:
        self.calls = 0

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        self.calls += 1
        return super().correct(signals, {"bias_a_v": values["bias_a_v"] * self.calls})


class DropsASample(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        shorter: dict[str, Any] = {name: getattr(signals, name)[1:] for name in ("i_ab", "v_ab")}
        return signals.model_copy(update=shorter)


class MovesTheClock(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        return super().correct(signals, values).model_copy(update={"start_s": 0.0})


class NotFiniteAtABound(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        with np.errstate(divide="ignore", invalid="ignore"):
            bias = values["bias_a_v"] / (2.0 - values["bias_a_v"])
            return super().correct(signals, {"bias_a_v": float(np.float64(bias))})


class NotFiniteQuietly(ExampleEffect):
    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        bias = np.inf if values["bias_a_v"] == BIAS.high else values["bias_a_v"]
        return super().correct(signals, {"bias_a_v": bias})


class NeutralOutOfBounds(ExampleEffect):
    parameters = (BIAS.model_copy(update={"low": 0.1}),)


class TypicalOutOfBounds(ExampleEffect):
    parameters = (BIAS.model_copy(update={"typical": 3.0}),)


class NoUnit(ExampleEffect):
    parameters = (BIAS.model_copy(update={"unit": " "}),)


class SameNameTwice(ExampleEffect):
    parameters = (BIAS, BIAS)


class NoParameters(ExampleEffect):
    parameters = ()


class ShapeMayBeZero(ExampleEffect):
    parameters = (BIAS, BIAS.model_copy(update={"name": "knee_a", "role": ParameterRole.SHAPE}))


class NoAmplitude(ExampleEffect):
    parameters = (BIAS.model_copy(update={"role": ParameterRole.REFINEMENT}),)


class ShapeActsAlone(ExampleEffect):
    parameters = (
        BIAS,
        BIAS.model_copy(update={"name": "knee_a", "role": ParameterRole.SHAPE, "low": 0.05, "neutral": 0.05}),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        return super().correct(signals, {"bias_a_v": values["bias_a_v"] + values["knee_a"] - 0.05})


class NoSignature(ExampleEffect):
    signature = ""


class LayerByNumber(ExampleEffect):
    layer = 4  # type: ignore[assignment]


class TwinsWithoutExperiment(ExampleEffect):
    experiments = ()


class ItsOwnTwin(ExampleEffect):
    twins = ("example",)


class EmptyTwin(ExampleEffect):
    twins = ("",)


MUTATIONS: list[tuple[type[ExampleEffect], str]] = [
    (NotNeutralAtNeutral, "neutral_values"),
    (DoesNothing, "typical_values_show"),
    (WorksInPlace, "input_is_not_modified"),
    (WorksAroundTheLock, "input_is_not_modified"),
    (Remembers, "same_input"),
    (DropsASample, "shape_and_clock"),
    (MovesTheClock, "shape_and_clock"),
    (NotFiniteAtABound, "finite_signals"),
    (NotFiniteQuietly, "finite_signals"),
    (NeutralOutOfBounds, "parameters_are_coherent"),
    (TypicalOutOfBounds, "parameters_are_coherent"),
    (NoUnit, "parameters_are_coherent"),
    (SameNameTwice, "parameters_are_coherent"),
    (NoParameters, "parameters_are_coherent"),
    (ShapeMayBeZero, "parameters_are_coherent"),
    (NoAmplitude, "parameters_are_coherent"),
    (ShapeActsAlone, "amplitudes_are_neutral"),
    (NoSignature, "class_keeps_the_contract"),
    (LayerByNumber, "class_keeps_the_contract"),
    (TwinsWithoutExperiment, "class_keeps_the_contract"),
    (ItsOwnTwin, "class_keeps_the_contract"),
    (EmptyTwin, "class_keeps_the_contract"),
]


@pytest.mark.parametrize(("effect", "check"), MUTATIONS, ids=[f"{e.__name__}-{c}" for e, c in MUTATIONS])
def test_fails_an_effect_that_breaks_the_contract(tmp_path: Path, effect: type[ExampleEffect], check: str) -> None:
    assert failures(kit_for(effect), tmp_path, only=check), f"{effect.__name__} passes {check}"
