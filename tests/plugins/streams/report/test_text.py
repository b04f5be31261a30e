"""Numbers and borrowed sentences get the characters of a printed page, and nothing else of them changes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.streams.report._text import borne, fixed, number, percent, scaled, typographic


@pytest.mark.parametrize(
    ("plain", "printed"),
    [
        ("moved -0.21 +- 0.05 deg", "moved −0.21 ± 0.05 deg"),
        ("error 350 -> 4.2 mV", "error 350 → 4.2 mV"),
        ("R_s 4.31 ohm, 95 % 4.30..4.32", "R_s 4.31 Ω, 95 % 4.30 to 4.32"),
        ("95 % -0.4..-0.2", "95 % −0.4 to −0.2"),
        ("(relative_change 1.04 1)", "(relative_change 1.04)"),
        ("1.48e+03 mV", "1480 mV"),
        ("2.5e-07 1/W", "2.5·10⁻⁷ 1/W"),
        ("5.489e+04", "54890"),
        ("3e+09", "3·10⁹"),
        ("worst in injection-031", "worst in injection-031"),
        ("2026-11-21", "2026-11-21"),
        ("gates-off, see map-2.nc", "gates-off, see map-2.nc"),
        ("0x1e5 and abc1e5", "0x1e5 and abc1e5"),
    ],
)
def test_sentences_get_print_characters(plain: str, printed: str) -> None:
    assert typographic(plain) == printed


@given(st.text(alphabet=st.characters(categories=["L", "Zs"])))
def test_words_stay_as_they_are(text: str) -> None:
    assert typographic(text) == text


@given(st.floats(-1e12, 1e12, allow_nan=False))
def test_a_number_has_a_true_minus_and_no_exponent_letter(value: float) -> None:
    text = number(value)
    assert "-" not in text
    assert "e" not in text
    assert text.startswith("−") == (value < 0.0)


def test_small_quantities_get_a_prefix() -> None:
    assert [scaled(x, "V") for x in (1.48, 0.00307, 2.2e-6, 0.0, None)] == [
        "1.48 V",
        "3.07 mV",
        "2.2 µV",
        "0 V",
        "not measured",
    ]


def test_an_uncertainty_bears_two_digits() -> None:
    assert [borne(error) for error in (0.015, 0.9, 3.0, 250.0, 0.0)] == [3, 2, 1, 0, 4]


def test_a_zero_has_no_minus() -> None:
    assert fixed(-0.0001, 2) == "0.00"
    assert percent(-1e-9) == "0 %"
