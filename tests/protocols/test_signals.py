"""Signals hold arrays by reference, refuse others than they declare, and say what a correction changes."""

from __future__ import annotations

import copy
import timeit
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest

from orchestrator.testing._signals import exciting_signals
from protocols import Correction, InputError, LossHistory, RealArray, Signals

OPTIONAL = (
    *("v_late_ab", "psi_ab", "inductance_ab", "psi_smooth_ab", "i_smooth_ab", "i_quiet_ab", "i_abc"),
    "temperature_c",
)


def required(n: int = 4, dtype: Any = np.float64) -> dict[str, Any]:
    vectors = {name: np.zeros((n, 2), dtype) for name in ("i_ab", "v_ab", "i_m_ab")}
    samples = {name: np.zeros(n, dtype) for name in ("v_dc", "theta_rad", "resistance_ohm", "heat_j")}
    return {"start_s": 0.0, "sampling_frequency_hz": 1e4, "pwm_frequency_hz": 1e4, **vectors, **samples}


def problem_of(**changed: Any) -> str:
    with pytest.raises(InputError) as caught:
        Signals(**required() | changed)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_array_is_held_by_reference(dtype: Any) -> None:
    given = required(dtype=dtype)
    signals = Signals(**given)
    assert all(getattr(signals, name) is value for name, value in given.items())
    assert replace(signals, start_s=1.0).v_ab is given["v_ab"]


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"v_ab": np.zeros((4, 3))}, "Signals: v_ab: expected shape (n, 2), got (4, 3)"),
        ({"v_dc": np.zeros((4, 1))}, "Signals: v_dc: expected shape (n,), got (4, 1)"),
        ({"i_abc": np.zeros((4, 2))}, "Signals: i_abc: expected shape (n, 3), got (4, 2)"),
        ({"i_ab": np.zeros((4, 2), np.int64)}, "Signals: i_ab: expected float32 or float64, got int64"),
        ({"heat_j": [0.0] * 4}, "Signals: heat_j: expected a numpy array, got list"),
        ({"theta_rad": None}, "Signals: theta_rad: expected a numpy array, got NoneType"),
        ({"theta_rad": np.zeros(5)}, "Signals: theta_rad: has length 5, but i_ab has 4"),
        ({"came_from_ab": np.zeros(2)}, "Signals: came_from_ab: expected shape (points, 2), got (2,)"),
    ],
)
def test_an_array_that_is_not_what_its_field_declares_is_refused_by_name(changed: dict[str, Any], problem: str) -> None:
    assert problem_of(**changed) == problem


@pytest.mark.parametrize("name", OPTIONAL)
def test_an_optional_array_has_as_many_samples_as_the_others(name: str) -> None:
    width = {"inductance_ab": (3,), "i_abc": (3,), "temperature_c": ()}.get(name, (2,))
    array = np.zeros((4, *width))
    assert getattr(Signals(**required() | {name: array}), name) is array
    assert problem_of(**{name: np.zeros((5, *width))}) == f"Signals: {name}: has length 5, but i_ab has 4"


def test_the_way_before_a_segment_has_a_length_of_its_own() -> None:
    way = np.zeros((7, 2))
    assert Signals(**required(), came_from_ab=way).came_from_ab is way


def test_a_history_s_arrays_agree_in_length() -> None:
    time_s = np.array([0.0, 1.0, 2.0])
    assert LossHistory(time_s=time_s, power_w=time_s, captured=time_s).time_s is time_s
    with pytest.raises(InputError, match="LossHistory: power_w: has length 2, but time_s has 3"):
        LossHistory(time_s=time_s, power_w=time_s[:2])
    with pytest.raises(InputError, match="LossHistory: captured: has length 2, but time_s has 3"):
        LossHistory(time_s=time_s, power_w=time_s, captured=time_s[:2])


def test_another_fact_is_checked_like_the_first() -> None:
    signals = exciting_signals()
    assert replace(signals, bridge_on=False).bridge_on is False
    with pytest.raises(InputError, match="Signals: v_ab: has length 3"):
        replace(signals, v_ab=signals.v_ab[:3])


def test_signals_cannot_be_changed_and_have_no_other_fields() -> None:
    signals = exciting_signals()
    with pytest.raises(FrozenInstanceError):
        signals.v_ab = signals.i_ab  # type: ignore[misc]
    with pytest.raises(TypeError, match="v_abc"):
        Signals(**required() | {"v_abc": np.zeros((4, 3))})
    assert not hasattr(signals, "__dict__")


def test_replaced_changes_the_arrays_that_are_given_and_no_other_field() -> None:
    signals, v_ab = exciting_signals(), np.zeros((3, 2))
    other = signals.replaced({"v_ab": v_ab})
    assert other.v_ab is v_ab  # of another length: nothing is checked
    names = {field.name for field in fields(Signals)} - {"v_ab"}
    assert all(getattr(other, name) is getattr(signals, name) for name in names)
    assert signals.v_ab is not v_ab


def test_replaced_is_several_times_as_fast_as_a_copy_that_is_checked() -> None:
    signals, v_ab = exciting_signals(), exciting_signals().v_ab
    unchecked = min(timeit.repeat(lambda: signals.replaced({"v_ab": v_ab}), number=300, repeat=7))
    checked = min(timeit.repeat(lambda: replace(signals, v_ab=v_ab), number=300, repeat=7))
    assert unchecked < 0.5 * checked


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy])
def test_signals_can_be_copied(again: Any) -> None:
    signals = exciting_signals()
    back = again(signals)
    for name in (field.name for field in fields(Signals)):
        before: RealArray | object = getattr(signals, name)
        if isinstance(before, np.ndarray):
            np.testing.assert_array_equal(getattr(back, name), before)
    assert (back.motor, back.drive, back.start_s) == (signals.motor, signals.drive, signals.start_s)
    np.testing.assert_array_equal(back.losses.power_w, signals.losses.power_w)  # type: ignore[union-attr]


def test_what_a_correction_leaves_out_stays_as_it_is() -> None:
    signals = exciting_signals()
    assert signals.corrected(Correction()) is signals
    after = signals.corrected(Correction(v_ab=signals.v_ab + 1.0))
    np.testing.assert_array_equal(after.v_ab, signals.v_ab + 1.0)
    assert after.i_ab is signals.i_ab


def test_what_magnetises_moves_along_with_the_current_unless_it_is_given_too() -> None:
    signals = exciting_signals()
    iron = replace(signals, i_m_ab=signals.i_ab - 0.1)
    np.testing.assert_allclose(iron.corrected(Correction(i_ab=iron.i_ab + 1.0)).i_m_ab, iron.i_m_ab + 1.0)
    both = iron.corrected(Correction(i_ab=iron.i_ab + 1.0, i_m_ab=iron.i_ab))
    np.testing.assert_array_equal(both.i_m_ab, iron.i_ab)
