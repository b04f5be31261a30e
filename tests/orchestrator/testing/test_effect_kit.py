"""The effect kit passes an effect that keeps the contract, and fails each one that breaks it in one way."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.testing import EffectConformance
from protocols import (
    Contrast,
    Correction,
    Effect,
    EffectLayer,
    EffectParameters,
    SignalBatch,
    Signals,
    amplitude,
    refinement,
    shape,
)
from tests.orchestrator.testing.kit_runner import failures


class ExampleEffect:
    """A constant error of the voltage along alpha."""

    name: ClassVar[str] = "example"
    summary: ClassVar[str] = "The voltage is off by a constant."
    signature: ClassVar[str] = "A constant residual in the stator frame."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.GATES_OFF,)
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        bias_a_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-2.0, high=2.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, p.bias_a_v)

    def _less(self, signals: Signals, bias_v: float) -> Correction:
        return Correction(v_ab=signals.v_ab - [bias_v, 0.0])


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

    layer = EffectLayer.IRON

    class Parameters(EffectParameters):
        core_loss_ohm: float = amplitude(
            "ohm", typical=1e3, prior_width=1e3, low=100.0, high=1e7, neutral=1e7, strong_when_small=True
        )

    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction(i_m_ab=signals.i_m_ab - signals.v_ab / p.core_loss_ohm)


def test_passes_an_effect_that_is_absent_only_in_the_limit(tmp_path: Path) -> None:
    assert failures(kit_for(SeenThroughAResistor), tmp_path) == {}


class InOneCall(ExampleEffect):
    """Takes voltage with the current of a sample before, the less the higher the PWM frequency is."""

    def correct(self, signals: Signals, p: Any) -> Correction:
        return self.correct_batch(SignalBatch.of([signals]), p)

    def random_directions(self, signals: Signals, p: Any) -> Sequence[Correction]:
        return [Correction(v_ab=signals.v_ab * (1.0 + 0.1 * p.bias_a_v))]

    def correct_batch(self, batch: SignalBatch, p: Any) -> Correction:
        share = batch.per_sample(1e4 / batch.pwm_frequency_hz)
        return Correction(v_ab=batch.v_ab - self.late(batch) * np.outer(share, [p.bias_a_v, 0.0]))

    def random_directions_batch(self, batch: SignalBatch, p: Any) -> Sequence[Correction]:
        return [Correction(v_ab=batch.v_ab * (1.0 + 0.1 * p.bias_a_v))]

    def late(self, batch: SignalBatch) -> np.ndarray:
        """The current a sample before, in each segment the first one twice."""
        before = np.arange(batch.samples) - 1
        before[batch.starts[:-1]] = batch.starts[:-1]
        return np.asarray(batch.i_ab[before])


def test_passes_an_effect_that_is_evaluated_on_batches(tmp_path: Path) -> None:
    assert failures(kit_for(InOneCall), tmp_path, only="batch") == {}


class LooksBeyondASegment(InOneCall):
    def late(self, batch: SignalBatch) -> np.ndarray:
        return np.concatenate([batch.i_ab[:1], batch.i_ab[:-1]])


class TakesOneFrequencyForAll(InOneCall):
    def correct_batch(self, batch: SignalBatch, p: Any) -> Correction:
        share = 1e4 / batch.pwm_frequency_hz[0]
        return Correction(v_ab=batch.v_ab - share * self.late(batch) * [p.bias_a_v, 0.0])


class DropsASampleOfABatch(InOneCall):
    def correct_batch(self, batch: SignalBatch, p: Any) -> Correction:
        correction = super().correct_batch(batch, p)
        return correction if len(batch.segments) == 1 else Correction(v_ab=batch.v_ab[1:])


class WorksInPlaceOnBatches(InOneCall):
    def correct_batch(self, batch: SignalBatch, p: Any) -> Correction:
        batch.v_ab.flags.writeable = True
        batch.v_ab[:, 0] -= p.bias_a_v
        return Correction(v_ab=batch.v_ab)


class DoubtsBatchesLess(InOneCall):
    def random_directions_batch(self, batch: SignalBatch, p: Any) -> Sequence[Correction]:
        return [Correction(v_ab=batch.v_ab)]


class DoubtsOnlyBatches(ExampleEffect):
    def random_directions_batch(self, batch: SignalBatch, p: Any) -> Sequence[Correction]:
        return []


class NotNeutralAtNeutral(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, p.bias_a_v + 1e-3)


class DoesNothing(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction()


class WorksInPlace(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        signals.v_ab[:, 0] -= p.bias_a_v
        return Correction(v_ab=signals.v_ab)


class WorksAroundTheLock(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        signals.v_ab.flags.writeable = True
        signals.v_ab[:, 0] -= p.bias_a_v
        return Correction(v_ab=signals.v_ab)


class Remembers(ExampleEffect):
    def __init__(self) -> None:
        self.calls = 0

    def correct(self, signals: Signals, p: Any) -> Correction:
        self.calls += 1
        return self._less(signals, p.bias_a_v * self.calls)


class DropsASample(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction(v_ab=signals.v_ab[1:])


class ReturnsSignals(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Any:
        return signals


class ReturnsWholeNumbers(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Any:
        return Correction(v_ab=np.zeros(signals.v_ab.shape, dtype=int))


class NotFiniteAtABound(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._less(signals, float(p.bias_a_v / np.float64(2.0 - p.bias_a_v)))


class NotFiniteQuietly(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, np.inf if p.bias_a_v == 2.0 else p.bias_a_v)


class NoParameters(ExampleEffect):
    class Parameters(EffectParameters):
        pass


class NoAmplitude(ExampleEffect):
    class Parameters(EffectParameters):
        bias_a_v: float = refinement("V", neutral=0.0, prior_width=0.3, low=-2.0, high=2.0)


class ShapeActsAlone(ExampleEffect):
    class Parameters(EffectParameters):
        bias_a_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-2.0, high=2.0)
        knee_a: float = shape("A", typical=0.15, prior_width=1.0, low=0.05, high=2.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, p.bias_a_v + p.knee_a - 0.05)


class SumsOverTime(ExampleEffect):
    """One number for the whole segment instead of one for each sample."""

    class Parameters(EffectParameters):
        rise: float = amplitude("1/A^2", typical=1e-6, prior_width=1e-6, low=-1e-3, high=1e-3)

    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction(v_ab=signals.v_ab * (1.0 + p.rise * np.sum(signals.i_ab**2)))


class WrongPower(ExampleEffect):
    """A resistance that grows with the current squared, declared as a resistance."""

    class Parameters(EffectParameters):
        extra_ohm: float = amplitude("ohm", typical=0.1, prior_width=0.1, low=-2.0, high=2.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        i = signals.i_ab
        return Correction(v_ab=signals.v_ab - p.extra_ohm * np.sum(i**2, axis=1, keepdims=True) * i)


class NoSignature(ExampleEffect):
    signature = ""


class LayerByNumber(ExampleEffect):
    layer = 4  # type: ignore[assignment]


class NeedsByName(ExampleEffect):
    needs = ("a reading with the gates off",)  # type: ignore[assignment]


class Staircase(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, 0.05 * round(p.bias_a_v / 0.05))


class ZeroSlope(ExampleEffect):
    """Goes with the square: nothing begins at zero."""

    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, p.bias_a_v * abs(p.bias_a_v) / 0.15)


class WrongUnit(ExampleEffect):
    """A voltage that is declared in amperes."""

    class Parameters(EffectParameters):
        bias_a_v: float = amplitude("A", typical=0.15, prior_width=0.3, low=-2.0, high=2.0)


class HiddenSize(ExampleEffect):
    """Bends at half an ampere, whatever the machine."""

    def correct(self, signals: Signals, p: Any) -> Correction:
        return Correction(v_ab=signals.v_ab - p.bias_a_v * np.tanh(signals.i_ab / 0.5))


class Millivolts(ExampleEffect):
    class Parameters(EffectParameters):
        bias_a_v: float = amplitude("V", typical=150.0, prior_width=300.0, low=-2000.0, high=2000.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, 1e-3 * p.bias_a_v)


class WrongLayer(ExampleEffect):
    layer = EffectLayer.CURRENT_SENSORS


class SensorThatCommands(ExampleEffect):
    """Reads another current, and with it another voltage, also where there is none."""

    layer = EffectLayer.CURRENT_SENSORS

    class Parameters(EffectParameters):
        offset_a: float = amplitude("A", typical=0.01, prior_width=0.01, low=-1.0, high=1.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        i_ab = signals.i_ab - [p.offset_a, 0.0]
        return Correction(i_ab=i_ab) if signals.bridge_on else Correction(i_ab=i_ab, v_ab=4.0 * i_ab)


class GoesWithTheTimeOfDay(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        return self._less(signals, p.bias_a_v * (1.0 + 0.1 * np.sin(signals.start_s)))


class CarriesOn(ExampleEffect):
    """Goes on from where the segment before has ended."""

    end_s = last_a = 0.0

    def correct(self, signals: Signals, p: Any) -> Correction:
        before = self.last_a if signals.start_s > self.end_s > 0.0 else 0.0
        self.end_s, self.last_a = signals.start_s + 0.1, float(signals.i_ab[-1, 0])
        return self._less(signals, p.bias_a_v * (1.0 + 0.1 * np.sign(before)))


class TakesSeconds(ExampleEffect):
    def correct(self, signals: Signals, p: Any) -> Correction:
        time.sleep(0.3)
        return super().correct(signals, p)


class ATwinThatNobodyKnows(ExampleEffect):
    needs = ("dead_tim",)  # type: ignore[assignment]


class MisspeltMethod(ExampleEffect):
    def random_direction(self, signals: Signals, p: Any) -> Sequence[Correction]:
        return [self.correct(signals, p)]


MUTATIONS: list[tuple[type[ExampleEffect], str]] = [
    (LooksBeyondASegment, "batch_is_corrected"),
    (TakesOneFrequencyForAll, "batch_is_corrected"),
    (DropsASampleOfABatch, "batch_is_corrected"),
    (WorksInPlaceOnBatches, "batch_is_not_modified"),
    (DoubtsBatchesLess, "random_directions_of_a_batch"),
    (DoubtsOnlyBatches, "random_directions_of_a_batch"),
    (Staircase, "has_a_slope"),
    (ZeroSlope, "has_a_slope"),
    (WrongUnit, "machine_of_another_size"),
    (HiddenSize, "machine_of_another_size"),
    (Millivolts, "a_volt_is_a_volt"),
    (WrongLayer, "its_layer_is_about"),
    (SensorThatCommands, "bridge_is_off"),
    (GoesWithTheTimeOfDay, "time_shows_only"),
    (CarriesOn, "no_earlier_segment"),
    (TakesSeconds, "answers_quickly"),
    (ATwinThatNobodyKnows, "class_keeps_the_contract"),
    (MisspeltMethod, "class_keeps_the_contract"),
    (NotNeutralAtNeutral, "neutral_values"),
    (DoesNothing, "typical_values_show"),
    (WorksInPlace, "input_is_not_modified"),
    (WorksAroundTheLock, "input_is_not_modified"),
    (Remembers, "same_input"),
    (DropsASample, "shape_of_the_signals"),
    (ReturnsSignals, "a_correction_is_returned"),
    (ReturnsWholeNumbers, "a_correction_is_returned"),
    (NotFiniteAtABound, "finite_signals"),
    (NotFiniteQuietly, "finite_signals"),
    (NoParameters, "parameters_can_be_fitted"),
    (NoAmplitude, "parameters_can_be_fitted"),
    (ShapeActsAlone, "amplitudes_are_neutral"),
    (SumsOverTime, "later_sample_changes_nothing"),
    (NoSignature, "class_keeps_the_contract"),
    (LayerByNumber, "class_keeps_the_contract"),
    (NeedsByName, "class_keeps_the_contract"),
]


@pytest.mark.parametrize(("effect", "check"), MUTATIONS, ids=[f"{e.__name__}-{c}" for e, c in MUTATIONS])
def test_fails_an_effect_that_breaks_the_contract(tmp_path: Path, effect: type[ExampleEffect], check: str) -> None:
    assert failures(kit_for(effect), tmp_path, only=check), f"{effect.__name__} passes {check}"


@pytest.mark.parametrize(
    ("effect", "cause"),
    [
        (WrongUnit, "bias_a_v is declared in A, but scales like a quantity in V: correct its unit"),
        (WrongPower, "extra_ohm is declared in ohm, but scales like a quantity in ohm/A^2: correct its unit"),
        (HiddenSize, "the code has a constant in A, V or ohm: make it a parameter, or take it from signals.motor"),
    ],
)
def test_an_effect_that_does_not_scale_with_the_machine_is_told_why(
    tmp_path: Path, effect: type[ExampleEffect], cause: str
) -> None:
    (message,) = failures(kit_for(effect), tmp_path, only="of_another_size").values()
    assert cause in message
    assert "the effect should scale alike, but differs by" in message


class LooksAhead(ExampleEffect):
    """A shift with the wrong sign: each sample gets a current of 50 samples later."""

    class Parameters(EffectParameters):
        extra_ohm: float = amplitude("ohm", typical=0.2, prior_width=0.3, low=-20.0, high=20.0)

    def correct(self, signals: Signals, p: Any) -> Correction:
        later = np.concatenate([signals.i_ab[50:], np.repeat(signals.i_ab[-1:], 50, axis=0)])
        return Correction(v_ab=signals.v_ab - p.extra_ohm * later)


@pytest.mark.parametrize(
    ("effect", "said", "declared"),
    [(LooksAhead, "looks 50 samples (5 ms) ahead", 50), (SumsOverTime, "From the first sample on", math.inf)],
)
def test_an_effect_that_looks_ahead_is_told_by_how_many_samples(
    tmp_path: Path, effect: type[ExampleEffect], said: str, declared: float
) -> None:
    kit, check = kit_for(effect), "later_sample_changes_nothing"
    (message,) = failures(kit, tmp_path / "undeclared", only=check).values()
    assert said in message
    assert f"write look_ahead_samples = {'math.inf' if math.isinf(declared) else declared}" in message
    type(kit).look_ahead_samples = declared
    assert failures(kit, tmp_path / "declared", only=check) == {}
    type(kit).look_ahead_samples = 49
    assert failures(kit, tmp_path / "less", only=check) != {}
