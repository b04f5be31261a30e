"""An effect from somebody's file can neither change the recording nor be fitted without sense."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis import guarded
from orchestrator.testing._signals import exciting_signals
from plugins.effects.inverter import VoltageBias
from protocols import (
    EFFECT_HOOKS,
    Contrast,
    Correction,
    EffectLayer,
    EffectParameters,
    PluginError,
    SignalBatch,
    Signals,
    amplitude,
    hook_of,
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


def test_no_correction_is_stated() -> None:
    with pytest.raises(PluginError, match="returned NoneType, no Correction"):
        guarded(Brought(lambda s: None)).correct(exciting_signals(), VALUES)
    with pytest.raises(PluginError, match="returned Signals, no Correction"):
        guarded(Brought(lambda s: s)).correct(exciting_signals(), VALUES)


class InOneCall(Brought):
    """Does of a batch what it is given to do, and asks the same of itself for what it cannot know."""

    def __init__(self, correct: Callable[[Any], Any]) -> None:
        self._of_any: Callable[[Any], Any] = correct

    def correct_batch(self, batch: SignalBatch, p: Brought.Parameters) -> Any:
        return self._of_any(batch)

    def random_directions(self, signals: Signals, p: Brought.Parameters) -> Any:
        return self._of_any(signals)

    def random_directions_batch(self, batch: SignalBatch, p: Brought.Parameters) -> Any:
        return self._of_any(batch)

    def shows_in(self, signals: Signals) -> Any:
        return self._of_any(signals)

    def measured(self, segments: Sequence[Signals]) -> Any:
        return self._of_any(segments)


def _batch() -> SignalBatch:
    return SignalBatch.of([exciting_signals(seed) for seed in (1, 2)])


def _first_segment(batch: SignalBatch) -> None:
    batch.segment(1).v_ab[0] = 0.0


def _as_laid(batch: SignalBatch) -> None:
    batch.segments[0].v_ab[:] = 0.0


def _losses_of_all(batch: SignalBatch) -> None:
    losses = batch.segments[1].losses
    assert losses is not None
    losses.power_w[:] = 0.0


def _bounds(batch: SignalBatch) -> None:
    batch.starts[1] = 0


@pytest.mark.parametrize("method", ["correct_batch", "random_directions_batch"])
@pytest.mark.parametrize("write", [_zero, _shift, _sorted, _first_segment, _as_laid, _losses_of_all, _bounds])
def test_writing_into_a_batch_is_refused_and_changes_nothing(method: str, write: Callable[[Any], Any]) -> None:
    batch, untouched = _batch(), _batch()
    with pytest.raises(PluginError, match=f"^effects: brought: {method}: writes into the signals"):
        getattr(guarded(InOneCall(write)), method)(batch, VALUES)
    for name in ("v_ab", "i_ab", "heat_j", "starts"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(untouched, name))
        assert getattr(batch, name).flags.writeable
    for one, other in zip(batch.segments, untouched.segments, strict=True):
        assert one.losses is not None
        assert other.losses is not None
        np.testing.assert_array_equal(one.v_ab, other.v_ab)
        np.testing.assert_array_equal(one.losses.power_w, other.losses.power_w)


@pytest.mark.parametrize("write", [_zero, _shift, _sorted, _forgotten])
def test_writing_into_the_signals_that_are_read_is_refused(write: Callable[[Any], Any]) -> None:
    effect: Any = guarded(InOneCall(write))
    with pytest.raises(PluginError, match="brought: random_directions: writes into the signals"):
        effect.random_directions(exciting_signals(), VALUES)
    with pytest.raises(PluginError, match="brought: doubts: writes into the signals"):
        guarded(FormerName(write)).doubts(exciting_signals(), VALUES)  # type: ignore[attr-defined]
    with pytest.raises(PluginError, match="brought: shows_in: writes into the signals"):
        effect.shows_in(exciting_signals())
    with pytest.raises(PluginError, match="brought: measured: writes into the signals"):
        guarded(InOneCall(lambda segments: write(segments[0]))).measured([exciting_signals()])  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "name", ["correct_batch", "random_directions", "random_directions_batch", "shows_in", "measured"]
)
def test_what_an_effect_does_not_have_its_guard_has_not(name: str) -> None:
    assert not hasattr(guarded(Brought()), name)
    assert hasattr(guarded(InOneCall(lambda _: None)), name)


def test_a_correction_of_a_batch_and_doubts_are_copies_that_can_be_written_to() -> None:
    batch = _batch()
    of_batch: Any = guarded(InOneCall(lambda b: Correction(v_ab=b.i_ab[::-1])))
    of_doubts: Any = guarded(InOneCall(lambda b: (Correction(v_ab=b.i_ab), Correction(i_ab=b.v_ab))))
    found = [of_batch.correct_batch(batch, VALUES), *of_doubts.random_directions_batch(batch, VALUES)]
    assert [set(one.arrays) for one in found] == [{"v_ab"}, {"v_ab"}, {"i_ab"}]
    np.testing.assert_array_equal(found[0].v_ab, batch.i_ab[::-1])
    for array in (array for one in found for array in one.arrays.values()):
        assert array.flags.writeable
        assert array.flags.c_contiguous
        assert not any(np.shares_memory(array, of) for of in (batch.i_ab, batch.v_ab))


def test_segments_that_share_their_losses_share_them_behind_the_guard() -> None:
    one, other = _batch().segments
    together = SignalBatch.of([one, replace(other, losses=one.losses)])
    seen: list[SignalBatch] = []

    def look(batch: SignalBatch) -> Correction:
        seen.append(batch)
        return Correction()

    effect: Any = guarded(InOneCall(look))
    effect.correct_batch(together, VALUES)
    (batch,) = seen
    assert batch.segments[0].losses is batch.segments[1].losses
    assert batch.segments[0].losses is not one.losses


def test_no_correction_of_a_batch_and_no_sequence_of_doubts_is_stated() -> None:
    nothing: Any = guarded(InOneCall(lambda _: None))
    with pytest.raises(PluginError, match="brought: correct_batch: returned NoneType, no Correction"):
        nothing.correct_batch(_batch(), VALUES)
    for method, signals in (("random_directions", exciting_signals()), ("random_directions_batch", _batch())):
        with pytest.raises(PluginError, match=f"brought: {method}: returned NoneType instead of a sequence"):
            getattr(nothing, method)(signals, VALUES)
        with pytest.raises(PluginError, match=f"brought: {method}: returned int, no Correction"):
            getattr(guarded(InOneCall(lambda _: [1])), method)(signals, VALUES)


def test_what_looks_at_signals_says_behind_the_guard_what_it_says() -> None:
    shows: Any = guarded(InOneCall(lambda s: len(s.v_dc) > 10))
    assert shows.shows_in(exciting_signals()) is True
    tells: Any = guarded(InOneCall(lambda segments: Brought.Parameters(offset_v=float(len(segments)))))
    assert tells.measured([exciting_signals()] * 2).offset_v == 2.0


def test_what_an_effect_raises_by_itself_is_passed_on() -> None:
    def complain(batch: SignalBatch) -> Correction:
        raise ValueError("no such batch")

    effect: Any = guarded(InOneCall(complain))
    with pytest.raises(ValueError, match="no such batch"):
        effect.correct_batch(_batch(), VALUES)


class WithoutAmplitude(Brought):
    class Parameters(EffectParameters):
        offset_v: float = refinement("V", neutral=0.0, prior_width=0.3, low=-5.0, high=5.0)


class LayerByNumber(Brought):
    layer = 4  # type: ignore[assignment]


class NeedsByName(Brought):
    needs = ("gates off",)  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("effect", "reported"),
    [
        (WithoutAmplitude, "Parameters: none has the role of an amplitude: there is nothing to fit"),
        (LayerByNumber, "layer: expected an EffectLayer, got 4"),
        (NeedsByName, "needs: expected a Contrast, got 'gates off'"),
    ],
)
def test_metadata_that_cannot_be_fitted_is_named(effect: type[Brought], reported: str) -> None:
    with pytest.raises(PluginError) as caught:
        guarded(effect())
    assert str(caught.value) == f"effects: brought: {reported}"


class FormerName(InOneCall):
    random_directions = None  # type: ignore[assignment]

    def doubts(self, signals: Signals, p: Brought.Parameters) -> Any:
        return self._of_any(signals)


class Misspelt(Brought):
    def random_direction(self, signals: Signals, p: Brought.Parameters) -> list[Correction]:
        return [self.correct(signals, p)]


def test_a_method_that_nothing_calls_is_refused_before_anything_is_fitted() -> None:
    with pytest.raises(
        PluginError, match=r"^effects: brought: method 'random_direction' is never called: .*directions'\?$"
    ):
        guarded(Misspelt())


def test_every_method_that_is_given_signals_is_given_sealed_ones() -> None:
    effect = guarded(InOneCall(lambda given: _zero(given[0] if isinstance(given, tuple | list) else given)))
    for hook in set(EFFECT_HOOKS) - {"remarks", "derived"}:
        method = hook_of(effect, hook)
        assert method is not None
        given = {"measured": _batch().segments, "shows_in": exciting_signals(), "random_directions": exciting_signals()}
        parameters = () if hook in ("measured", "shows_in") else (VALUES,)
        with pytest.raises(PluginError, match=f"brought: {hook}: writes into the signals"):
            method(given.get(hook, _batch()), *parameters)
