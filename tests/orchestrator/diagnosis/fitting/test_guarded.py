"""An effect from somebody's file can neither change the recording nor be fitted without sense."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis import guarded
from orchestrator.testing._signals import exciting_signals
from plugins.effects.inverter import VoltageBias
from protocols import (
    Contrast,
    Correction,
    EffectLayer,
    EffectParameters,
    PluginError,
    Signals,
    amplitude,
    refinement,
)


class Brought:
    """What a file may hold."""

    name: ClassVar[str] = "brought"
    summary: ClassVar[str] = "A constant."
    signature: ClassVar[str] = "A constant."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        offset_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-5.0, high=5.0)

    def __init__(self, correct: Callable[[Signals], Any] | None = None) -> None:
        self._correct = correct

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        if self._correct is None:
            return Correction(v_ab=signals.v_ab - p.offset_v)
        found: Correction = self._correct(signals)
        return found


VALUES = Brought.Parameters(offset_v=0.2)


def _zero(signals: Signals) -> Correction:
    signals.v_ab[:] = 0.0
    return Correction(v_ab=signals.v_ab)


def _shift(signals: Signals) -> Correction:
    np.add(signals.i_ab, 1.0, out=signals.i_ab)
    return Correction(i_ab=signals.i_ab)


def _sorted(signals: Signals) -> Correction:
    signals.heat_j.sort()
    return Correction()


def _forgotten(signals: Signals) -> Correction:
    assert signals.losses is not None
    signals.losses.power_w[:] = 0.0
    return Correction()


@pytest.mark.parametrize("write", [_zero, _shift, _sorted, _forgotten])
def test_writing_into_the_signals_is_refused_and_changes_nothing(write: Callable[[Signals], Correction]) -> None:
    signals = exciting_signals()
    before = {n: np.array(getattr(signals, n)) for n in ("v_ab", "i_ab", "heat_j")}
    with pytest.raises(PluginError, match="brought: correct: writes into the signals"):
        guarded(Brought(write)).correct(signals, VALUES)
    for name, was in before.items():
        np.testing.assert_array_equal(getattr(signals, name), was)
        assert getattr(signals, name).flags.writeable


def test_an_effect_that_keeps_to_it_gives_what_it_would_unguarded() -> None:
    signals = exciting_signals()
    values = VoltageBias.Parameters(bias_a_v=0.2, bias_b_v=-0.1)
    behind, plain = (effect.correct(signals, values).v_ab for effect in (guarded(VoltageBias()), VoltageBias()))
    assert behind is not None
    assert plain is not None
    np.testing.assert_array_equal(behind, plain)
    assert behind.flags.writeable


def test_what_is_not_changed_is_left_out() -> None:
    assert set(guarded(Brought()).correct(exciting_signals(), VALUES).arrays) == {"v_ab"}
    assert guarded(Brought(lambda s: Correction())).correct(exciting_signals(), VALUES).arrays == {}


def test_a_part_of_the_signals_handed_back_is_a_copy_that_can_be_written_to() -> None:
    signals = exciting_signals()
    v_ab = guarded(Brought(lambda s: Correction(v_ab=s.i_ab[::-1]))).correct(signals, VALUES).v_ab
    assert v_ab is not None
    assert v_ab.flags.writeable
    assert v_ab.flags.c_contiguous
    assert not np.shares_memory(v_ab, signals.i_ab)


def test_no_correction_is_said() -> None:
    with pytest.raises(PluginError, match="returned NoneType, no Correction"):
        guarded(Brought(lambda s: None)).correct(exciting_signals(), VALUES)
    with pytest.raises(PluginError, match="returned Signals, no Correction"):
        guarded(Brought(lambda s: s)).correct(exciting_signals(), VALUES)


class WithoutAmplitude(Brought):
    class Parameters(EffectParameters):
        offset_v: float = refinement("V", neutral=0.0, prior_width=0.3, low=-5.0, high=5.0)


class LayerByNumber(Brought):
    layer = 4  # type: ignore[assignment]


class NeedsByName(Brought):
    needs = ("gates off",)  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (WithoutAmplitude, "Parameters: none has the role of an amplitude: there is nothing to fit"),
        (LayerByNumber, "layer: expected an EffectLayer, got 4"),
        (NeedsByName, "needs: expected a Contrast, got 'gates off'"),
    ],
)
def test_metadata_that_cannot_be_fitted_is_named(effect: type[Brought], told: str) -> None:
    with pytest.raises(PluginError) as caught:
        guarded(effect())
    assert str(caught.value) == f"effects: brought: {told}"
