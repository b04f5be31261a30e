"""What effects return is put into the signals from the sensors inwards, and so are changes of one of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, cast

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.corrections import (
    SECANT_STEP,
    Cascade,
    apply_effects,
    random_directions_of,
    step_of,
)
from orchestrator.testing._signals import exciting_signals
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import EddyCurrents, SlotHarmonics
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset
from protocols import (
    Contrast,
    Correction,
    Effect,
    EffectLayer,
    EffectParameters,
    PluginError,
    SignalBatch,
    Signals,
    amplitude,
)
from tests.orchestrator.diagnosis.pieces import plan, prepared


def active(effect: Effect, **values: float) -> EffectTerm:
    absent = CandidateEffect(effect, effect.Parameters.declared()).absent()
    return EffectTerm(absent.candidate, {**absent.values, **values}, ())


def one_segment(**changed: Any) -> SignalBatch:
    return SignalBatch.of([replace(exciting_signals(), **changed)])


class Returning:
    """Returns whatever it is reported to."""

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
    signals = one_segment()
    eddy, offset = active(EddyCurrents(), core_loss_ohm=1000.0), active(CurrentOffset(), offset_a_a=0.1)
    one, other = (apply_effects(signals, order).signals for order in ([eddy, offset], [offset, eddy]))
    np.testing.assert_array_equal(one.i_m_ab, other.i_m_ab)


def test_what_was_changed_is_named() -> None:
    signals = one_segment()
    assert apply_effects(signals, [active(VoltageBias(), bias_a_v=1.0)]).changed == {"v_ab"}
    assert apply_effects(signals, [active(CurrentOffset(), offset_a_a=0.1)]).changed == {"i_ab", "i_m_ab"}
    both = [active(RotorMisalignment(), angle_rad=0.1), active(EddyCurrents(), core_loss_ohm=1000.0)]
    assert apply_effects(signals, both).changed == {"theta_rad", "i_m_ab", "v_ab"}


def test_an_array_is_taken_as_it_is() -> None:
    signals = one_segment()
    v_ab = np.zeros_like(signals.v_ab)
    after = apply_effects(signals, [active(Returning(lambda s: Correction(v_ab=v_ab)), size=1.0)]).signals
    assert after.v_ab is v_ab
    assert after.i_ab is signals.i_ab


def test_an_effect_that_is_absent_is_not_requested() -> None:
    def complain(signals: Signals) -> Correction:
        raise AssertionError("requested")

    signals = one_segment()
    after = apply_effects(signals, [active(Returning(complain))])
    assert after.changed == frozenset()
    assert after.signals is signals


def test_while_all_gates_are_off_only_the_sensors_effects_are_there() -> None:
    signals = one_segment(bridge_on=False)
    effects = [active(DeadTime(), voltage_v=8.0), active(CurrentOffset(), offset_a_a=0.1)]
    assert apply_effects(signals, effects).changed == {"i_ab", "i_m_ab"}


@pytest.mark.parametrize(
    ("returned", "reported"),
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
def test_what_signals_cannot_be_is_refused_in_one_line(returned: Callable[[Signals], Any], reported: str) -> None:
    with pytest.raises(PluginError, match=f"effects: returning: correct: .*{reported}"):
        apply_effects(one_segment(), [active(Returning(returned), size=1.0)])


class Doubting(Returning):
    """Doubts what it is reported to."""

    def random_directions(self, signals: Signals, p: Returning.Parameters) -> list[Any]:
        return [self._correct(signals)]


def test_what_an_effect_cannot_know_is_requested_where_it_is_there() -> None:
    signals = one_segment()
    doubting = Doubting(lambda s: Correction(i_ab=s.i_ab + 0.1))
    (doubt,) = random_directions_of(active(doubting, size=1.0), signals)
    assert doubt.changed == {"i_ab", "i_m_ab"}
    np.testing.assert_allclose(doubt.signals.i_m_ab - signals.i_m_ab, 0.1)
    assert random_directions_of(active(doubting), signals) == []
    assert random_directions_of(active(doubting, size=1.0), one_segment(bridge_on=False)) == []
    assert random_directions_of(active(VoltageBias(), bias_a_v=1.0), signals) == []


def test_a_doubt_that_signals_cannot_have_is_refused_in_one_line() -> None:
    doubting = Doubting(lambda s: Correction(v_ab=s.v_ab * np.nan))
    with pytest.raises(PluginError, match="effects: returning: random_directions: v_ab is not finite"):
        random_directions_of(active(doubting, size=1.0), one_segment())
    doubting.random_directions = lambda s, p: None  # type: ignore[method-assign,assignment,return-value]
    with pytest.raises(PluginError, match="effects: returning: random_directions: returned NoneType, no sequence"):
        random_directions_of(active(doubting, size=1.0), one_segment())


def three_segments(*, bridge_on: bool = True) -> SignalBatch:
    """Unlike each other in all that segments may be unlike in."""
    whole = exciting_signals()
    parts = []
    for k, (first, last) in enumerate(((0, 3000), (3000, 3700), (5000, 9000))):
        cut = {name: getattr(whole, name)[first:last] for name in (*ARRAYS, "i_abc", "temperature_c")}
        facts = {"start_s": 10.0 + 3.0 * k, "pwm_frequency_hz": 1e4 * (1 + k % 2), "turned_rad": 0.2 * k}
        parts.append(replace(whole, **{**cut, **facts, "bridge_on": bridge_on}))
    return SignalBatch.of(parts)


ARRAYS = (
    *("i_ab", "v_ab", "v_late_ab", "v_dc", "theta_rad", "resistance_ohm", "i_m_ab", "heat_j", "psi_ab"),
    "inductance_ab",
)


def _lag(s: Signals) -> Correction:
    """Each sample what the one before it was: what no segment takes from another."""
    before = np.concatenate([s.i_ab[:1], s.i_ab[:-1]])
    return Correction(i_ab=before, v_ab=s.v_ab * (s.pwm_frequency_hz / 1e4), theta_rad=s.theta_rad + s.turned_rad)


class InOneCall(Returning):
    """The same for a whole batch."""

    def correct_batch(self, batch: SignalBatch, p: Returning.Parameters) -> Correction:
        found: Correction = self._whole(batch)
        return found

    def __init__(self, whole: Callable[[SignalBatch], Any]) -> None:
        super().__init__(_never)
        self._whole = whole


def _never(signals: Signals) -> Correction:
    raise AssertionError("requested segment by segment")


def _lag_of_all(batch: SignalBatch) -> Correction:
    before = np.concatenate([batch.i_ab[:1], batch.i_ab[:-1]])
    before[batch.starts[:-1]] = batch.i_ab[batch.starts[:-1]]
    v_ab = batch.v_ab * (batch.per_sample(batch.pwm_frequency_hz) / 1e4)[:, None]
    return Correction(i_ab=before, v_ab=v_ab, theta_rad=batch.theta_rad + batch.per_sample(batch.turned_rad))


def test_an_effect_gives_the_same_in_one_call_as_segment_by_segment() -> None:
    batch = three_segments()
    by_segment = apply_effects(batch, [active(Returning(_lag), size=1.0)])
    at_once = apply_effects(batch, [active(InOneCall(_lag_of_all), size=1.0)])
    assert by_segment.changed == at_once.changed == {"i_ab", "i_m_ab", "v_ab", "theta_rad"}
    for name in ARRAYS:
        one, other = getattr(by_segment.signals, name), getattr(at_once.signals, name)
        np.testing.assert_array_equal(one, other, err_msg=name)
    for k in range(len(batch.segments)):
        alone = apply_effects(SignalBatch.of([batch.segment(k)]), [active(Returning(_lag), size=1.0)]).signals
        np.testing.assert_array_equal(by_segment.signals.segment(k).i_m_ab, alone.i_m_ab)


def test_an_effect_that_can_is_requested_in_one_call_of_a_single_segment_too() -> None:
    apply_effects(one_segment(), [active(InOneCall(_lag_of_all), size=1.0)])


def test_what_an_effect_changes_in_some_segments_stays_as_it_is_in_the_others() -> None:
    batch = three_segments()

    def second_only(s: Signals) -> Correction:
        return Correction(theta_rad=s.theta_rad + 1.0) if len(s.v_dc) == 700 else Correction(v_ab=2.0 * s.v_ab)

    after = apply_effects(batch, [active(Returning(second_only), size=1.0)])
    assert after.changed == {"theta_rad", "v_ab"}
    for k, there in enumerate(batch.segments):
        now = after.signals.segment(k)
        np.testing.assert_array_equal(now.theta_rad, there.theta_rad + (1.0 if k == 1 else 0.0))
        np.testing.assert_array_equal(now.v_ab, there.v_ab * (1.0 if k == 1 else 2.0))


def test_a_late_voltage_that_one_segment_gets_is_none_in_the_others() -> None:
    batch = SignalBatch.of([replace(s, v_late_ab=None) for s in three_segments().segments])

    def second_only(s: Signals) -> Correction:
        return Correction(v_late_ab=np.ones_like(s.v_ab)) if len(s.v_dc) == 700 else Correction()

    after = apply_effects(batch, [active(Returning(second_only), size=1.0)]).signals.v_late_ab
    assert after is not None
    np.testing.assert_array_equal(after[batch.slice_of(1)], 1.0)
    assert not after[batch.slice_of(0)].any()
    assert not after[batch.slice_of(2)].any()


def test_what_magnetises_moves_along_in_segments_whose_effect_does_not_tell_it() -> None:
    batch = three_segments()

    def told_in_one(s: Signals) -> Correction:
        if len(s.v_dc) == 700:
            return Correction(i_m_ab=np.zeros_like(s.i_ab))
        return Correction(i_ab=s.i_ab + 0.5)

    after = apply_effects(batch, [active(Returning(told_in_one), size=1.0)]).signals
    for k, there in enumerate(batch.segments):
        now = after.segment(k)
        if k == 1:
            np.testing.assert_array_equal(now.i_ab, there.i_ab)
            np.testing.assert_array_equal(now.i_m_ab, 0.0)
        else:
            np.testing.assert_allclose(now.i_m_ab, there.i_m_ab + 0.5, atol=1e-12)


def test_an_effect_that_changes_nothing_leaves_a_batch_as_it_is() -> None:
    batch = three_segments()
    after = apply_effects(batch, [active(Returning(lambda s: Correction()), size=1.0)])
    assert after.changed == frozenset()
    assert all(getattr(after.signals, name) is getattr(batch, name) for name in ARRAYS)


def test_a_batch_without_the_bridge_has_only_what_sensors_do() -> None:
    batch = three_segments(bridge_on=False)
    requested = active(InOneCall(lambda b: Correction(v_ab=b.v_ab + 1.0)), size=1.0)
    assert apply_effects(batch, [requested]).signals is batch


def _second(wrong: Callable[[Signals], Any]) -> Callable[[Signals], Any]:
    """Wrong in the second of three segments."""
    return lambda s: wrong(s) if len(s.v_dc) == 700 else Correction(i_m_ab=s.i_m_ab)


WRONG = [
    (lambda s: None, "returned NoneType instead of a Correction"),
    (lambda s: Correction(v_ab=s.v_ab[1:]), r"v_ab has shape \(\d+, 2\), not \(\d+, 2\)"),
    (lambda s: Correction(i_ab=s.i_ab[1:]), r"i_ab has shape \(\d+, 2\), not \(\d+, 2\)"),
    (lambda s: Correction(i_ab=cast(Any, "x")), "i_ab has shape None"),
    (lambda s: Correction(v_dc=s.v_ab), r"v_dc has shape \(\d+, 2\), not \(\d+,\)"),
    (lambda s: Correction(theta_rad=np.zeros(len(s.v_dc), dtype=int)), "theta_rad is of type int64"),
    (lambda s: Correction(v_ab=s.v_ab * np.nan), "v_ab is not finite"),
    (lambda s: Correction(v_ab=s.nothing), "AttributeError"),
]


@pytest.mark.parametrize(("wrong", "message"), WRONG)
def test_what_one_segment_of_a_batch_cannot_be_is_refused_by_the_effects_name(
    wrong: Callable[[Any], Any], message: str
) -> None:
    with pytest.raises(PluginError, match=f"^effects: returning: correct: .*{message}") as caught:
        apply_effects(three_segments(), [active(Returning(_second(wrong)), size=1.0)])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("wrong", "message"), WRONG)
def test_what_a_batch_cannot_be_is_refused_by_the_effects_name(wrong: Callable[[Any], Any], message: str) -> None:
    with pytest.raises(PluginError, match=f"^effects: returning: correct(_batch)?: .*{message}"):
        apply_effects(three_segments(), [active(InOneCall(wrong), size=1.0)])


class DoubtingInOneCall(Doubting):
    """Doubts of a whole batch."""

    def random_directions_batch(self, batch: SignalBatch, p: Returning.Parameters) -> Any:
        return self._correct(cast(Any, batch))


def test_what_cannot_be_known_of_each_segment_is_requested_of_all_at_once() -> None:
    batch = three_segments()
    by_segment = Doubting(lambda s: Correction(i_ab=s.i_ab + len(s.v_dc)))
    at_once = DoubtingInOneCall(
        lambda b: [Correction(i_ab=b.i_ab + cast(Any, b).per_sample(np.diff(cast(Any, b).starts))[:, None])]
    )
    (one,) = random_directions_of(active(by_segment, size=1.0), batch)
    (other,) = random_directions_of(active(at_once, size=1.0), batch)
    assert one.changed == other.changed == {"i_ab", "i_m_ab"}
    np.testing.assert_array_equal(one.signals.i_m_ab, other.signals.i_m_ab)


def test_a_segment_with_fewer_doubts_than_others_has_no_more_than_its_own() -> None:
    batch = three_segments()
    doubting = Doubting(lambda s: s)
    two = [Correction(v_ab=batch.v_ab[batch.slice_of(1)] + size) for size in (1.0, 2.0)]
    doubting.random_directions = lambda s, p: two if len(s.v_dc) == 700 else []  # type: ignore[method-assign,assignment]
    found = random_directions_of(active(doubting, size=1.0), batch)
    for size, one in zip((1.0, 2.0), found, strict=True):
        moved = one.signals.v_ab - batch.v_ab
        np.testing.assert_allclose(moved[batch.slice_of(1)], size, atol=1e-9)
        assert not moved[batch.slice_of(0)].any()
        assert not moved[batch.slice_of(2)].any()


@pytest.mark.parametrize(("wrong", "message"), WRONG)
def test_a_doubt_that_a_batch_cannot_have_is_refused_by_the_effects_name(
    wrong: Callable[[Any], Any], message: str
) -> None:
    with pytest.raises(PluginError, match=f"^effects: returning: random_directions: .*{message}"):
        random_directions_of(active(Doubting(_second(wrong)), size=1.0), three_segments())
    whole = DoubtingInOneCall(lambda b: [wrong(b)])
    with pytest.raises(PluginError, match=f"^effects: returning: random_directions(_batch)?: .*{message}"):
        random_directions_of(active(whole, size=1.0), three_segments())


PREPARED = prepared(plan())
SIZES = {
    "current_gain_mismatch": {"gain_a_minus_b": 0.02},
    "current_offset": {"offset_a_a": 0.01, "offset_b_a": -0.02},
    "dead_time": {"voltage_v": 5.0},
    "voltage_bias": {"bias_a_v": 0.1},
    "phase_resistance_imbalance": {"extra_a_ohm": 0.3},
    "rotor_misalignment": {"angle_rad": 0.03},
    "slot_harmonics": {"relative": 0.02},
}
EFFECTS = (
    CurrentGainMismatch(),
    CurrentOffset(),
    DeadTime(),
    VoltageBias(),
    PhaseResistanceImbalance(),
    RotorMisalignment(),
    SlotHarmonics(),
)
ACTIVE = tuple(
    EffectTerm(c, {**c.absent().values, **SIZES[c.name]}, c.amplitudes)
    for c in scaled_library(EFFECTS, PREPARED.manifest)
)
COMPARED = ("i_ab", "v_ab", "theta_rad", "resistance_ohm", "i_m_ab")


def signals() -> SignalBatch:
    """Two segments, end to end."""
    return SignalBatch.of([piece.signals for piece in PREPARED.pieces[-2:]])


@pytest.mark.parametrize("place", range(len(ACTIVE)))
def test_a_change_is_that_of_all_effects_applied_anew(place: int) -> None:
    one = ACTIVE[place]
    name = one.free[0]
    moved = one.moved(name, one.standardised_value(name) + step_of(one, name))
    cascade = Cascade.of(signals(), ACTIVE)
    change, _ = cascade.change_by(moved)
    anew = apply_effects(signals(), [*ACTIVE[:place], moved, *ACTIVE[place + 1 :]]).signals
    for array in COMPARED:
        expected = getattr(anew, array) - getattr(cascade.corrected, array)
        scale = np.abs(getattr(anew, array)).max()
        np.testing.assert_allclose(change.get(array, np.zeros_like(expected)), expected, atol=1e-12 * scale)


@pytest.mark.parametrize("place", range(len(ACTIVE)))
def test_an_effect_that_is_absent_changes_what_it_would_in_its_layer(place: int) -> None:
    others = [*ACTIVE[:place], *ACTIVE[place + 1 :]]
    cascade = Cascade.of(signals(), others)
    change, _ = cascade.change_by(ACTIVE[place])
    # Effects of one layer are applied in the order in which they came to the model: the last is the newest.
    anew = apply_effects(signals(), [*others, ACTIVE[place]]).signals
    for array in COMPARED:
        expected = getattr(anew, array) - getattr(cascade.corrected, array)
        scale = np.abs(getattr(anew, array)).max()
        np.testing.assert_allclose(change.get(array, np.zeros_like(expected)), expected, atol=1e-12 * scale)


def test_a_change_without_an_answer_passes_as_it_is() -> None:
    dead_time = next(a for a in ACTIVE if a.name == "dead_time")
    moved = dead_time.moved("voltage_v", 1.1 * dead_time.standardised_value("voltage_v"))
    cascade = Cascade.of(signals(), ACTIVE)
    whole, responses = cascade.change_by(moved)
    unrequested, silent = cascade.change_by(moved, frozenset())
    assert not silent
    rounding = 1e-12 * np.abs(signals().v_ab).max()
    np.testing.assert_allclose(unrequested["v_ab"], whole["v_ab"], atol=rounding)
    stated = itertools.chain.from_iterable(answer.values() for answer in responses.values())
    assert all(np.abs(x).max() <= rounding for x in stated)


def test_what_effects_answer_is_all_that_passing_unrequested_leaves_out() -> None:
    offset = next(a for a in ACTIVE if a.name == "current_offset")
    moved = offset.moved("offset_a_a", 2.0 * offset.standardised_value("offset_a_a"))
    cascade = Cascade.of(signals(), ACTIVE)
    whole, responses = cascade.change_by(moved)
    unrequested, _ = cascade.change_by(moved, frozenset())
    added = sum(answer.get("v_ab", np.zeros_like(signals().v_ab)) for answer in responses.values())
    assert np.abs(added).max() > 0.0
    left_out = whole["v_ab"] - unrequested.get("v_ab", 0.0)
    np.testing.assert_allclose(left_out, added, atol=1e-12 * np.abs(signals().v_ab).max())


@pytest.mark.parametrize("switched", [0.0, 0.4, 0.96, 0.994, 1.0 - 1e-6, 1.0])
def test_a_secant_is_over_the_step_that_was_taken(switched: float) -> None:
    dead_time = next(a for a in ACTIVE if a.name == "dead_time")
    one = replace(dead_time, values={**dead_time.values, "switched": switched})
    x, step = one.standardised_value("switched"), step_of(one, "switched")
    assert one.moved("switched", x + step).standardised_value("switched") - x == pytest.approx(step, rel=1e-6)
    assert abs(step) >= SECANT_STEP
