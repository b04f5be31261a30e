"""A change carried inwards is what applying all effects anew gives; only effects that answer have to be requested."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.cascade import SECANT_STEP, Cascade, step_of
from orchestrator.diagnosis.fitting.corrections import apply_effects
from plugins.effects.frame import RotorMisalignment
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import SlotHarmonics
from plugins.effects.resistance import PhaseResistanceImbalance
from plugins.effects.sensors import CurrentGainMismatch, CurrentOffset
from protocols import SignalBatch
from tests.orchestrator.diagnosis.pieces import plan, prepared

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
ARRAYS = ("i_ab", "v_ab", "theta_rad", "resistance_ohm", "i_m_ab")


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
    for array in ARRAYS:
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
    for array in ARRAYS:
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
