"""The plant obeys its equations, laws are drawn by a seed alone, and an answer is judged by its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blind.effects import CATALOGUE, FOREIGN
from tests.laws.__main__ import _replace
from tests.laws.examine import Answer, keep, kept
from tests.laws.hidden import KINDS, draw
from tests.laws.plant import LOAD_ANGLE, NOTHING, Machine, _current, _rates, _slopes
from tests.laws.score import judge, table
from tests.laws.subjects import PLACES, subject


def an_answer(kind: str, seed: int = 5) -> Answer:
    """Of a law that is found."""
    hidden, _ = draw(kind, seed)
    return Answer(
        kind, seed, "unknown_remains", "law", "", [[hidden.place, hidden.quantity, hidden.phase]], ["a |x|: size 1"],
        9.0, 1.01, 2.0, 0.1, 20.0, 10.0, {"thresholded": {"first": [], "terms": 7, "after": 3.0, "cpu_s": 5.0}},
    )  # fmt: skip


def test_there_are_twenty_kinds_each_drawn_by_the_seed_alone() -> None:
    assert len(KINDS) == 20
    assert [draw(kind, 5) for kind in KINDS] == [draw(kind, 5) for kind in KINDS]
    assert all(draw(kind, 5) != draw(kind, 6) for kind in KINDS)


def test_the_flux_at_a_current_is_the_inverse_of_the_plants_map() -> None:
    machine = Machine()
    psi_d, psi_q = machine.flux(1.5, -2.0)
    assert _current(psi_d, psi_q, machine.numbers, 0.0) == pytest.approx((1.5, -2.0))
    assert machine.flux(0.0, 0.0) == pytest.approx((machine.magnet_wb, 0.0))


def test_the_slopes_are_those_of_the_current() -> None:
    m, step = Machine().numbers, 1e-6
    ahead_d, ahead_q = _current(0.35 + step, 0.1, m, 0.0), _current(0.35, 0.1 + step, m, 0.0)
    behind_d, behind_q = _current(0.35 - step, 0.1, m, 0.0), _current(0.35, 0.1 - step, m, 0.0)
    numerical = [(a - b) / (2.0 * step) for a, b in zip((*ahead_d, *ahead_q), (*behind_d, *behind_q), strict=True)]
    d_d, d_q, q_d, q_q = _slopes(0.35, 0.1, m)
    assert (d_d, q_d, d_q, q_q) == pytest.approx(numerical, rel=1e-6)


def test_a_load_angle_turns_with_the_rate_of_the_current_that_turns_it() -> None:
    m, y, k = Machine().numbers, np.array([0.35, 0.1, 0.0, 0.0]), np.array([0.02, 0.8])
    out, still = np.zeros(4), np.zeros(4)
    _rates(LOAD_ANGLE, k, -1, m, y, 20.0, -10.0, 0.0, 0.0, 0.3, 1.0, out)
    _, q = _current(y[0], y[1], m, 0.0)
    turned = 0.3 + k[0] * np.tanh(q / k[1])
    _rates(NOTHING, k, -1, m, y, 20.0, -10.0, 0.0, 0.0, float(turned), 1.0, still)
    _, _, q_d, q_q = _slopes(y[0], y[1], m)
    turning = k[0] / k[1] / np.cosh(q / k[1]) ** 2 * (q_d * out[0] + q_q * out[1])
    assert out[:2] == pytest.approx(still[:2] + turning * np.array([y[1], -y[0]]))


def test_a_law_is_right_where_place_quantity_and_phase_are() -> None:
    found = an_answer("poor_contact")
    assert judge(found).is_right
    place, quantity, phase = found.places[0]
    other = "c" if phase != "c" else "a"
    assert not judge(replace(found, places=[[place, quantity, other]])).is_right
    assert not judge(replace(found, places=[[place, "time", phase]])).is_right
    assert not judge(replace(found, places=[*found.places, ["angle", "time", ""]])).is_right
    assert not judge(replace(found, outcome="no_law", places=[])).is_right


def test_a_model_to_trust_is_one_that_leaves_noise_or_needs_no_law() -> None:
    found = replace(an_answer("poor_contact"), map_after=3.0)
    assert judge(found).is_usable_but_wrong
    assert not judge(replace(found, after=2.0)).is_usable_but_wrong
    explained = replace(found, verdict="explained", outcome="nothing_to_learn", map_before=3.0, map_after=None)
    assert judge(explained).is_usable_but_wrong


def test_a_recording_of_the_blind_suite_is_right_where_its_place_is() -> None:
    contact, bias = subject("foreign:0", 5), subject("left_out:8", 5)
    assert contact.names == (("leg_voltage", "phase_currents", "a"),)
    assert bias.without == ("voltage_bias",)
    assert not subject("clean:0", 5).names
    found = replace(an_answer("poor_contact"), kind="foreign:0", places=[list(contact.names[0])])
    assert judge(found).is_right
    assert not judge(replace(found, kind="left_out:2")).is_right


def test_each_recording_of_the_blind_suite_that_has_a_place_has_a_name() -> None:
    assert {name for name in (*FOREIGN, *CATALOGUE) if name not in PLACES} == {
        "interleaved_adc", "lost_samples", "slot_harmonics",
    }  # fmt: skip
    assert set(PLACES) <= {*FOREIGN, *CATALOGUE}


def test_the_table_has_a_row_for_each_answer_and_replaces_the_last_one(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n\n<!-- laws -->\nstale\n<!-- end of laws -->\n\nbehind\n", encoding="utf-8")
    _replace(page, "laws", table([judge(an_answer(kind)) for kind in KINDS], 5))
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("behind\n")
    assert "stale" not in text
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    figures, answers = rows[: -len(KINDS) - 2], rows[-len(KINDS) - 2 :]
    assert answers[0].startswith("| hidden law | found |")
    assert {line.count(" | ") for line in figures} == {1}
    assert {line.count(" | ") for line in answers} == {5}
    assert "a abs(x): size 1" in text
    assert "| of these: place, quantity and phase right | 20 of 20 |" in text


def test_answers_are_kept_by_their_seed(tmp_path: Path) -> None:
    file = tmp_path / "answers.jsonl"
    keep(file, an_answer("slow_leg", 5))
    keep(file, an_answer("slow_leg", 6))
    assert kept(file, 5) == {"slow_leg": an_answer("slow_leg", 5)}
