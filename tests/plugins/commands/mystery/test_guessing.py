"""Guesses: what counts as right, and that a verdict reveals no more than the guess."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.registry.plugins import PluginKind, installed
from plugins.commands.mystery import Guess, judge, read_guess
from plugins.commands.mystery._guessing import MAX_GUESSES
from protocols import InputError

KNOWN = {info.name for info in installed(PluginKind.EFFECTS)}
HIDDEN = {
    "dead_time": {"voltage_v": 2.0, "threshold_a": 0.1},
    "current_offset": {"offset_a_a": 0.01, "offset_b_a": -0.03},
}


def test_names_and_sizes_are_read() -> None:
    assert read_guess(" dead_time, hysteresis=0.03 ") == (Guess(name="dead_time"), Guess(name="hysteresis", size=0.03))
    assert read_guess("dead time=0.8") == (Guess(name="dead_time", size=0.8),)
    assert read_guess("voltage bias=385 mV, winding_heating=0.3%") == (
        Guess(name="voltage_bias", size=0.385),
        Guess(name="winding_heating", size=0.003),
    )
    assert read_guess("nothing") == ()


@pytest.mark.parametrize(
    ("words", "size"),
    [
        ("bus_sag=0.001 % per W", 1e-5),
        ("winding_heating=0.264 % per W", 0.00264),
        ("winding_heating=250·10⁻⁹ per W", 250e-9),
        ("slot_harmonics=−2.5·10⁻³", -0.0025),
        ("phase_resistance_imbalance=−3.07 mΩ", -0.00307),
    ],
)
def test_sizes_are_read_as_a_diagnosis_prints_them(words: str, size: float) -> None:
    (guess,) = read_guess(words)
    assert guess.size == pytest.approx(size)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("dead_tim", "did you mean dead_time"),
        ("dead_time=1.35us", "not a size; expected its voltage in V, for example dead_time="),
        ("voltage_bias=x", "not a size; expected the larger one of bias a and bias b in V, for example voltage_bias="),
        ("dead_time,dead_time", "twice"),
        (",", "nothing"),
    ],
)
def test_a_guess_that_cannot_be_read_is_reported_in_one_line(words: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_guess(words)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=40))
def test_no_words_are_read_as_a_name_that_there_is_not(words: str) -> None:
    guesses: tuple[Guess, ...] = ()
    with suppress(InputError):
        guesses = read_guess(words)
    assert {guess.name for guess in guesses} <= KNOWN


def test_a_complete_guess_is_complete() -> None:
    verdict = judge(read_guess("current_offset,dead_time"), HIDDEN)
    assert verdict.complete
    assert verdict.sizes == ()


def test_a_wrong_name_is_wrong_and_what_is_missing_is_counted_not_named() -> None:
    verdict = judge(read_guess("dead_time,hysteresis"), HIDDEN)
    assert (verdict.right, verdict.wrong, verdict.still_hidden) == (("dead_time",), ("hysteresis",), 1)
    assert not verdict.complete
    assert "current_offset" not in verdict.model_dump_json()


def test_nothing_is_right_where_nothing_is_hidden() -> None:
    assert judge((), {}).complete
    assert not judge((), HIDDEN).complete


def test_a_size_is_judged_by_the_first_parameter_or_by_the_larger_phase() -> None:
    verdict = judge(read_guess("dead_time=1,current_offset=-0.03"), HIDDEN)
    assert [(size.parameter, size.ratio) for size in verdict.sizes] == [("voltage_v", 0.5), ("offset_b_a", 1.0)]


@pytest.mark.parametrize(
    ("guess", "grade"),
    [
        ("dead_time=2.1", "close"),
        ("dead_time=1.2", "too_small"),
        ("dead_time=2.9", "too_large"),
        ("dead_time=0.9", "less_than_half"),
        ("dead_time=40", "more_than_double"),
        ("dead_time=-2", "wrong_sign"),
    ],
)
def test_the_grade_of_a_size_does_not_tell_the_true_one(guess: str, grade: str) -> None:
    verdict = judge(read_guess(guess), HIDDEN)
    assert verdict.sizes[0].grade == grade
    assert "ratio" not in verdict.model_dump_json()
    assert "ratio" not in repr(verdict)


def test_what_fits_as_well_in_a_hidden_effects_place_counts_as_right() -> None:
    def is_drop(guessed: str, hidden: str) -> bool:
        return (guessed, hidden) == ("device_drop", "dead_time")

    verdict = judge(read_guess("device_drop,current_offset"), HIDDEN, None, is_drop)
    assert (verdict.right, verdict.as_good, verdict.wrong) == (("current_offset",), ("device_drop",), ())
    assert verdict.complete
    # Beside the hidden one itself it is one too many.
    assert judge(read_guess("device_drop,dead_time"), HIDDEN, None, is_drop).wrong == ("device_drop",)


def test_nothing_stands_alone() -> None:
    with pytest.raises(InputError, match="cannot be combined"):
        read_guess("nothing,skin_effect")


def test_an_angle_that_the_run_caused_is_neither_one_of_the_hidden_nor_missing() -> None:
    brought = {"rotor_misalignment": {"angle_rad": 0.02}}
    named = judge(read_guess("dead_time,current_offset,rotor_misalignment=0.03"), HIDDEN, brought)
    assert named.complete
    assert (named.right, named.caused) == (("dead_time", "current_offset"), ("rotor_misalignment",))
    assert named.sizes[-1].ratio == pytest.approx(1.5)
    assert judge(read_guess("dead_time,current_offset"), HIDDEN, brought).complete
    assert judge(read_guess("rotor_misalignment"), HIDDEN).wrong == ("rotor_misalignment",)


def test_what_the_recording_does_not_show_is_not_missing() -> None:
    guess = read_guess("dead_time")
    verdict = judge(guess, HIDDEN, shows=lambda name: name != "current_offset")
    assert verdict.complete
    assert (verdict.still_hidden, verdict.too_small) == (0, 1)


def test_a_list_of_the_library_is_no_guess() -> None:
    with pytest.raises(InputError, match="so many names are no guess: at most 3 effects are hidden"):
        read_guess(",".join(sorted(KNOWN)))
    assert len(read_guess(",".join(sorted(KNOWN)[:MAX_GUESSES]))) == MAX_GUESSES


def test_a_misalignment_is_judged_by_the_angle_that_came_of_it() -> None:
    hidden = {"rotor_misalignment": {"angle_rad": 0.05}}
    verdict = judge(read_guess("rotor_misalignment=0.06"), hidden, {"rotor_misalignment": {"angle_rad": 0.06}})
    assert verdict.sizes[0].ratio == pytest.approx(1.0)


def test_what_an_earlier_guess_had_right_is_not_missing_and_an_equal_names_no_hidden_one() -> None:
    def is_drop(guessed: str, hidden: str) -> bool:
        return (guessed, hidden) == ("device_drop", "dead_time")

    first = judge(read_guess("device_drop"), HIDDEN, None, is_drop)
    assert (first.still_hidden, first.covered) == (1, {"dead_time": "device_drop"})
    assert "dead_time" not in first.model_dump_json()
    assert "dead_time" not in repr(first)
    then = judge(read_guess("current_offset"), HIDDEN, None, is_drop, before=first.covered)
    assert then.complete
    assert then.before == ("device_drop",)
    assert not judge(read_guess("nothing"), HIDDEN, before=first.covered).complete
