"""What effects return is put into the signals from the sensors inwards, checked and not copied."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, cast

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import Active, Candidate
from orchestrator.diagnosis.fitting.corrections import apply_effects, doubts_of
from orchestrator.testing._signals import exciting_signals
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import EddyCurrents
from plugins.effects.sensors import CurrentOffset
from protocols import Contrast, Correction, Effect, EffectLayer, EffectParameters, PluginError, Signals, amplitude


def active(effect: Effect, **values: float) -> Active:
    absent = Candidate(effect, effect.Parameters.declared()).absent()
    return Active(absent.candidate, {**absent.values, **values}, ())


class Returning:
    """Returns whatever it is told to."""

    name: ClassVar[str] = "returning"
    summary: ClassVar[str] = "A test."
    signature: ClassVar[str] = "A test."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        size: float = amplitude("1", typical=1.0, prior_width=1.0, low=-5.0, high=5.0)

    def __init__(self, correct: Callable[[Signals], Any]) -> None:
        self._correct = correct

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        found: Correction = self._correct(signals)
        return found


def test_the_sensors_come_first_whatever_the_order_of_the_effects() -> None:
    signals = exciting_signals()
    eddy, offset = active(EddyCurrents(), core_loss_ohm=1000.0), active(CurrentOffset(), offset_a_a=0.1)
    one, other = (apply_effects(signals, order).signals for order in ([eddy, offset], [offset, eddy]))
    np.testing.assert_array_equal(one.i_m_ab, other.i_m_ab)


def test_what_was_changed_is_named() -> None:
    signals = exciting_signals()
    assert apply_effects(signals, [active(VoltageBias(), bias_a_v=1.0)]).changed == {"v_ab"}
    assert apply_effects(signals, [active(CurrentOffset(), offset_a_a=0.1)]).changed == {"i_ab", "i_m_ab"}
    both = [active(RotorMisalignment(), angle_rad=0.1), active(EddyCurrents(), core_loss_ohm=1000.0)]
    assert apply_effects(signals, both).changed == {"theta_rad", "i_m_ab", "v_ab"}


def test_an_array_is_taken_as_it_is() -> None:
    signals = exciting_signals()
    v_ab = np.zeros_like(signals.v_ab)
    after = apply_effects(signals, [active(Returning(lambda s: Correction(v_ab=v_ab)), size=1.0)]).signals
    assert after.v_ab is v_ab
    assert after.i_ab is signals.i_ab


def test_an_effect_that_is_absent_is_not_asked() -> None:
    def complain(signals: Signals) -> Correction:
        raise AssertionError("asked")

    signals = exciting_signals()
    after = apply_effects(signals, [active(Returning(complain))])
    assert after.changed == frozenset()
    assert after.signals is signals


def test_while_all_gates_are_off_only_the_sensors_effects_are_there() -> None:
    signals = exciting_signals().model_copy(update={"bridge_on": False})
    effects = [active(DeadTime(), voltage_v=8.0), active(CurrentOffset(), offset_a_a=0.1)]
    assert apply_effects(signals, effects).changed == {"i_ab", "i_m_ab"}


@pytest.mark.parametrize(
    ("returned", "told"),
    [
        (lambda s: s, "returned Signals instead of a Correction"),
        (lambda s: None, "returned NoneType instead of a Correction"),
        (lambda s: Correction(v_ab=s.v_ab[1:]), r"v_ab has shape \(9999, 2\), not \(10000, 2\)"),
        (lambda s: Correction(v_ab=cast(Any, [0.0])), "v_ab has shape None"),
        (lambda s: Correction(theta_rad=np.zeros(len(s.v_dc), dtype=int)), "theta_rad is of type int64"),
        (lambda s: Correction(v_ab=s.v_ab * np.nan), "v_ab is not finite"),
        (lambda s: Correction(v_ab=s.nothing), "AttributeError"),
    ],
)
def test_what_signals_cannot_be_is_refused_in_one_line(returned: Callable[[Signals], Any], told: str) -> None:
    with pytest.raises(PluginError, match=f"effects: returning: correct: .*{told}"):
        apply_effects(exciting_signals(), [active(Returning(returned), size=1.0)])


class Doubting(Returning):
    """Doubts what it is told to."""

    def doubts(self, signals: Signals, p: Returning.Parameters) -> list[Any]:
        return [self._correct(signals)]


def test_what_an_effect_cannot_know_is_asked_where_it_is_there() -> None:
    signals = exciting_signals()
    doubting = Doubting(lambda s: Correction(i_ab=s.i_ab + 0.1))
    (doubt,) = doubts_of(active(doubting, size=1.0), signals)
    assert doubt.changed == {"i_ab", "i_m_ab"}
    np.testing.assert_allclose(doubt.signals.i_m_ab - signals.i_m_ab, 0.1)
    assert doubts_of(active(doubting), signals) == []
    assert doubts_of(active(doubting, size=1.0), signals.model_copy(update={"bridge_on": False})) == []
    assert doubts_of(active(VoltageBias(), bias_a_v=1.0), signals) == []


def test_a_doubt_that_signals_cannot_have_is_refused_in_one_line() -> None:
    doubting = Doubting(lambda s: Correction(v_ab=s.v_ab * np.nan))
    with pytest.raises(PluginError, match="effects: returning: doubts: v_ab is not finite"):
        doubts_of(active(doubting, size=1.0), exciting_signals())
    doubting.doubts = lambda s, p: None  # type: ignore[method-assign,assignment,return-value]
    with pytest.raises(PluginError, match="effects: returning: doubts: returned NoneType instead of a sequence"):
        doubts_of(active(doubting, size=1.0), exciting_signals())
