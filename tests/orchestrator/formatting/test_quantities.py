"""Printed numbers mean what they were: their digits, prefixes and intervals, and nothing is printed as an exponent."""

from __future__ import annotations

import re

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from orchestrator.formatting.quantities import (
    Scale,
    axes_percent,
    duration,
    fixed,
    measured,
    number,
    percent,
    plural,
    probability,
    quantity,
    significant_decimals,
    unit_words,
    value_and_interval,
    vector,
    with_error,
)
from protocols import AxisPercent

PREFIXES = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}
UNITS = ("V", "A", "ohm", "H", "Wb", "s", "J", "rad")
SIZES = st.floats(1e-11, 9e5) | st.floats(-9e5, -1e-11)
DOWN = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")


def read(text: str) -> float:
    """A printed number as a reader takes it."""
    mantissa, _, power = text.replace("−", "-").partition("·10")
    return float(f"{mantissa}e{power.translate(DOWN) or 0}")


def split(text: str, unit: str) -> tuple[str, float]:
    """Number and factor of a printed quantity."""
    printed = unit_words(unit)
    match = re.fullmatch(rf"(\S+) ([{''.join(PREFIXES)}]?){printed}", text)
    assert match is not None, text
    return match[1], PREFIXES[match[2]]


@given(SIZES, st.sampled_from(UNITS), st.integers(2, 5))
def test_a_quantity_reads_back_to_half_its_last_digit(value: float, unit: str, digits: int) -> None:
    text, factor = split(quantity(value, unit, digits), unit)
    assert read(text) * factor == pytest.approx(value, rel=0.5001 * 10.0 ** (1 - digits))
    assert "e" not in text


@given(st.floats(1e-11, 9e5), st.sampled_from(("V", "A", "J")))
def test_a_prefix_leaves_one_to_three_digits_before_the_point(value: float, unit: str) -> None:
    text, factor = split(quantity(value, unit), unit)
    assert read(text) >= 1.0
    assert read(text) < 1000.0 or factor == 1e3


@given(SIZES, SIZES)
def test_larger_numbers_are_never_printed_as_smaller_ones(one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert read(number(low)) <= read(number(high))
    (a, factor_a), (b, factor_b) = (split(quantity(x, "V"), "V") for x in (low, high))
    assert read(a) * factor_a <= read(b) * factor_b * (1.0 + 1e-12 * (1 if high > 0 else -1))


@given(SIZES, st.floats(1e-5, 3.0), st.floats(1e-5, 3.0), st.sampled_from((*UNITS, "1/W", "1", "Hz")))
def test_the_ends_of_an_interval_differ_in_print_and_hold_their_value(
    value: float, below: float, above: float, unit: str
) -> None:
    low, high = value - below * abs(value), value + above * abs(value)
    scale = Scale.of(value, low, high, unit)
    printed = [read(scale.number(x)) for x in (low, value, high)]
    assert printed[0] < printed[1] < printed[2]
    half = 0.5001 * 10.0**-scale.decimals
    assert [x / 10.0**scale.power for x in (low, value, high)] == [pytest.approx(x, abs=half) for x in printed]
    least = min(below, above) * abs(value) / 10.0**scale.power
    assert scale.decimals == 0 or 10.0**-scale.decimals > 0.05 * least  # and no digit more than the interval bears


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "> 99.9 %"), (0.9991, "> 99.9 %"), (0.994, "99.4 %"), (0.5, "50.0 %"), (0.0, "< 0.1 %"), (None, "–")],
)
def test_no_probability_is_certain(value: float | None, text: str) -> None:
    assert probability(value) == text


@given(SIZES | st.just(0.0), SIZES, SIZES)
def test_any_interval_is_printed_without_an_exponent(value: float, one: float, other: float) -> None:
    low, high = sorted((one, other))
    assume(low != high)
    text = measured(value, low, high, "V")
    assert "e" not in text
    assert re.fullmatch(r"−?[\d.]+ [pnµmk]?V \(95 %: −?[\d.]+ to −?[\d.]+\)", text)


@pytest.mark.parametrize(
    ("value", "low", "high", "unit", "text"),
    [
        (0.0200, 0.01998, 0.02002, "ohm", "20.00 mΩ (95 %: 19.98 to 20.02)"),
        (4.312345, 4.305, 4.32, "ohm", "4.312 Ω (95 %: 4.305 to 4.320)"),
        (25.2e-6, 24.7e-6, 25.7e-6, "s", "25.2 µs (95 %: 24.7 to 25.7)"),
        (0.5, 0.1, 8.0, "V", "500 mV (95 %: 100 to 8000)"),
        (0.00298, 0.00289, 0.00307, "1/W", "0.298 % per W (95 %: 0.289 to 0.307)"),
        (2.5e-7, 2.4e-7, 2.6e-7, "1/W", "250·10⁻⁹ per W (95 %: (240 to 260)·10⁻⁹)"),
        (1.04, 1.03, 1.06, "1", "1.040 (95 %: 1.030 to 1.060)"),
        (0.0, -1e-3, 1e-3, "A", "0.0 mA (95 %: −1.0 to 1.0)"),
        (0.4, None, None, "V", "400 mV"),
        (0.0, 0.0, 0.0, "V", "0 V (95 %: 0 to 0)"),
        (None, None, None, "V", "–"),
    ],
)
def test_a_value_stands_beside_its_interval(
    value: float | None, low: float | None, high: float | None, unit: str, text: str
) -> None:
    assert measured(value, low, high, unit) == text


def test_a_power_of_ten_stands_beside_the_interval_too() -> None:
    assert value_and_interval(-13e-6, -24e-6, -2e-6, "V/A^3") == ("−13·10⁻⁶ V/A³", "(−24 to −2)·10⁻⁶")


def test_value_and_interval_are_one_scale_in_two_cells() -> None:
    assert value_and_interval(-0.03, -0.0302, -0.0299, "rad") == ("−30.00 mrad", "−30.20 to −29.90")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.48, "V", "1.48 V"),
        (0.9996, "V", "1 V"),
        (999.6, "V", "1 kV"),
        (-2.2e-6, "V", "−2.2 µV"),
        (0.0, "V", "0 V"),
        (-0.0, "A", "0 A"),
        (12000.0, "s", "12000 s"),
        (0.0432, "H", "43.2 mH"),
        (0.02, "1/A^2", "2 % per A²"),
        (2e-5, "rad/Nm", "20·10⁻⁶ rad/Nm"),
        (-1.5e7, "1", "−15·10⁶"),
        (None, "V", "–"),
    ],
)
def test_a_quantity_has_the_prefix_that_fits(value: float | None, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


@given(st.floats(-1e12, 1e12, allow_nan=False))
def test_a_number_has_a_true_minus_and_no_exponent_letter(value: float) -> None:
    text = number(value)
    assert "-" not in text
    assert "e" not in text
    assert text.startswith("−") == (value < 0.0)
    assert read(text) == pytest.approx(value, rel=0.5001e-3)


def test_large_numbers_keep_all_digits_before_the_point() -> None:
    assert [number(x, 3) for x in (54894.0, 999.6, 1e-9, 5.489e9)] == ["54894", "1000", "1·10⁻⁹", "5.49·10⁹"]


def test_an_uncertainty_bears_one_digit_and_two_after_a_one() -> None:
    assert [significant_decimals(error) for error in (0.015, 0.02, 0.9, 0.99, 1.2, 3.0, 250.0)] == [3, 2, 1, 1, 1, 0, 0]
    assert with_error(0.3, 7.8e-4, -3) == "300.0 ± 0.8"
    assert with_error(0.3, float("nan"), -3) == "300"
    assert with_error(-3.5e-16, 3e-19, -3) == "0.000"  # rounding, where a map is odd by construction


def test_a_zero_has_no_minus() -> None:
    assert fixed(-0.0001, 2) == "0.00"
    assert percent(-1e-9) == "0 %"
    assert vector(-0.0001, -0.5) == "(+0.000, −0.500) A"


@given(st.floats(0.0, 1e6))
def test_a_duration_reads_back(seconds: float) -> None:
    text = duration(seconds)
    units = {"h": 3600.0, "min": 60.0, "s": 1.0}
    back = sum(read(n) * units[unit] for n, unit in re.findall(r"([\d.·⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+) (h|min|s)", text))
    assert back == pytest.approx(seconds, rel=0.051, abs=1e-300 if "h" not in text else 60.0)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.25, "0.25 s"), (7.43, "7.4 s"), (94.2, "94 s"), (187.0, "3 min 07 s"), (3729.0, "1 h 02 min")],
)
def test_durations_read_like_speech(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_checks_name_the_axes_that_they_were_made_on() -> None:
    assert axes_percent(AxisPercent(d_percent=0.414, q_percent=None)) == "d 0.41 %"
    assert axes_percent(AxisPercent(d_percent=1.3, q_percent=350.0)) == "d 1.3 %, q 350 %"
    assert axes_percent(AxisPercent(d_percent=None, q_percent=None)) == axes_percent(None) == "–"


def test_a_point_is_no_points() -> None:
    assert [plural(n, "point") for n in (0, 1, 2)] == ["0 points", "1 point", "2 points"]


def test_what_is_next_to_nothing_beside_its_interval_is_printed_on_the_intervals_scale() -> None:
    assert value_and_interval(9.9e-11, 0.0, 0.868, "1") == ("0.0", "0.0 to 0.9")
