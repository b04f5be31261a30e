"""An effect from somebody's file can neither change the recording nor be fitted without sense."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis import guarded
from orchestrator.testing._signals import exciting_signals
from plugins.effects.inverter import VoltageBias
from protocols import EffectLayer, EffectParameter, ParameterRole, PluginError, Signals

VALUES = {"offset_v": 0.2}
Correct = Callable[[Signals, Mapping[str, float]], Any]


class Brought:
    """What a file may hold."""

    name: ClassVar[str] = "brought"
    summary: ClassVar[str] = "A constant."
    signature: ClassVar[str] = "A constant."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    family: ClassVar[str] = "constant"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ()
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="offset_v", unit="V", typical=0.15, prior_width=0.3, low=-5.0, high=5.0, neutral=0.0),
    )

    def __init__(self, correct: Correct | None = None) -> None:
        self._correct = correct or (lambda s, v: s.model_copy(update={"v_ab": s.v_ab - v["offset_v"]}))

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        found: Signals = self._correct(signals, values)
        return found


def _zero(signals: Signals) -> Signals:
    signals.v_ab[:] = 0.0
    return signals


def _shift(signals: Signals) -> Signals:
    np.add(signals.i_ab, 1.0, out=signals.i_ab)
    return signals


def _sorted(signals: Signals) -> Signals:
    signals.heat_j.sort()
    return signals


@pytest.mark.parametrize("write", [_zero, _shift, _sorted])
def test_writing_into_the_signals_is_refused_and_changes_nothing(write: Callable[[Signals], Signals]) -> None:
    signals = exciting_signals()
    before = {n: np.array(getattr(signals, n)) for n in ("v_ab", "i_ab", "heat_j")}
    with pytest.raises(PluginError, match="brought: correct: writes into the signals"):
        guarded(Brought(lambda s, _: write(s))).correct(signals, VALUES)
    for name, was in before.items():
        np.testing.assert_array_equal(getattr(signals, name), was)
        assert getattr(signals, name).flags.writeable


def test_values_cannot_be_changed_either() -> None:
    def tamper(signals: Signals, values: Mapping[str, float]) -> Signals:
        values["offset_v"] = 1.0  # type: ignore[index]
        return signals

    values = dict(VALUES)
    with pytest.raises(TypeError):
        guarded(Brought(tamper)).correct(exciting_signals(), values)
    assert values == VALUES


def test_an_effect_that_keeps_to_it_gives_what_it_would_unguarded() -> None:
    signals = exciting_signals()
    values = {"bias_a_v": 0.2, "bias_b_v": -0.1}
    np.testing.assert_array_equal(
        guarded(VoltageBias()).correct(signals, values).v_ab, VoltageBias().correct(signals, values).v_ab
    )


def test_what_is_not_changed_stays_the_same_array() -> None:
    signals = exciting_signals()
    after = guarded(Brought()).correct(signals, VALUES)
    assert after.i_ab is signals.i_ab
    assert after.i_m_ab is signals.i_m_ab
    assert after.v_ab.flags.writeable
    assert guarded(Brought(lambda s, _: s)).correct(signals, VALUES) is signals


def test_what_an_effect_may_not_change_is_not_taken_from_it() -> None:
    signals = exciting_signals()
    changed = {"heat_j": np.zeros_like(signals.heat_j), "start_s": 7.0, "sampling_frequency_hz": 1.0}
    after = guarded(Brought(lambda s, _: s.model_copy(update=changed))).correct(signals, VALUES)
    assert after.heat_j is signals.heat_j
    assert (after.start_s, after.sampling_frequency_hz) == (signals.start_s, signals.sampling_frequency_hz)


def test_a_part_of_the_signals_handed_back_is_a_copy_that_can_be_written_to() -> None:
    signals = exciting_signals()
    after = guarded(Brought(lambda s, _: s.model_copy(update={"v_ab": s.i_ab[::-1]}))).correct(signals, VALUES)
    assert after.v_ab.flags.writeable
    assert after.v_ab.flags.c_contiguous
    assert not np.shares_memory(after.v_ab, signals.i_ab)


def test_no_signals_is_said() -> None:
    with pytest.raises(PluginError, match="returned NoneType"):
        guarded(Brought(lambda s, v: None)).correct(exciting_signals(), VALUES)


PLAIN = Brought.parameters[0]


@pytest.mark.parametrize(
    ("parameters", "told"),
    [
        ((), "nothing to fit"),
        ((PLAIN.model_copy(update={"role": ParameterRole.REFINEMENT}),), "nothing to fit"),
        ((PLAIN, PLAIN), "names repeat"),
        (({"name": "offset_v"},), "expected EffectParameter, got dict"),
        ((PLAIN.model_copy(update={"typical": 0.0}),), "typical 0"),
        ((PLAIN.model_copy(update={"low": 6.0}),), "low 6 is not below high 5"),
        ((PLAIN.model_copy(update={"prior_width": 0.0}),), "prior_width 0 is not positive"),
        ((PLAIN.model_copy(update={"typical": 7.0}),), "typical 7 is not between"),
        ((PLAIN.model_copy(update={"high": float("inf")}),), "high is inf"),
        ((PLAIN, PLAIN.model_copy(update={"name": "s", "role": ParameterRole.SHAPE})), "low -5 of a shape"),
    ],
)
def test_metadata_that_cannot_be_fitted_is_named(parameters: tuple[Any, ...], told: str) -> None:
    class Wrong(Brought):
        pass

    Wrong.parameters = parameters
    with pytest.raises(PluginError) as caught:
        guarded(Wrong())
    assert told in str(caught.value)
    assert str(caught.value).startswith("effects: brought: parameters")
