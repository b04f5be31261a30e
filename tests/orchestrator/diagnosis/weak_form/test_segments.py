"""A recording as the diagnosis works on it: what is averaged, held out, thinned and cut."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from orchestrator.diagnosis.criteria import Criteria, WeakFormCriteria
from orchestrator.diagnosis.weak_form import preparation, segments
from orchestrator.diagnosis.weak_form.preparation import coarse, prepare
from orchestrator.diagnosis.weak_form.segments import (
    block_means,
    clarke_of_three,
    injection_period,
    largest_command,
    logged_fields,
    mean_between,
    since_the_start,
    swept_axis,
    unread_axis,
)
from orchestrator.recording import Recording
from protocols import Capture, Segment, SegmentStage
from tests.orchestrator.diagnosis.pieces import FS, Array, Plan, hold, piece, plan, prepared, ripple, sweep
from tests.support.close import assert_close


def test_flux_changes_between_means_by_what_the_averaged_voltage_does() -> None:
    rng = np.random.default_rng(1)
    v = rng.normal(size=(1000, 2))
    psi = np.concatenate([np.zeros((1, 2)), np.cumsum(v, axis=0)])[:-1]
    means, voltage = block_means(psi, 10), mean_between(v, 10, 0.0)
    np.testing.assert_allclose(np.diff(means, axis=0), 10.0 * voltage[:-1], atol=1e-9)


def test_a_late_voltage_is_a_part_of_each_of_two_commands() -> None:
    v = np.random.default_rng(2).normal(size=(50, 2))
    assert mean_between(v, 1, 0.0) is v
    np.testing.assert_array_equal(mean_between(v, 1, 1.0)[1:], v[:-1])
    np.testing.assert_allclose(mean_between(v, 1, 1.25)[2:], 0.75 * v[1:-1] + 0.25 * v[:-2])


@pytest.mark.parametrize(("axis", "number"), [("d", 0), ("q", 1)])
def test_a_sweep_says_which_axis_it_moves(axis: str, number: int) -> None:
    one = piece(Plan(SegmentStage.CLASSICAL, sweep(number, 2.0, 1.0)), angle=0.4)
    assert swept_axis(one.segment, one.signals.i_ab) == axis
    both = piece(Plan(SegmentStage.CLASSICAL, sweep(0, 1.5, 0.0) + sweep(1, 1.5, 0.0)))
    assert swept_axis(both.segment, both.signals.i_ab) == "dq"
    stated = both.segment.model_copy(update={"settings": {"swept_axis": axis}})
    assert swept_axis(stated, both.signals.i_ab) == axis


def test_an_injection_that_does_not_say_its_frequency_is_requested_it() -> None:
    silent = piece(Plan(SegmentStage.INJECTION, ripple(0.0, 0.0, 40.0)))
    assert injection_period(silent.segment, FS, silent.signals.v_ab) == pytest.approx(20.0, rel=0.01)


def test_some_injection_points_and_diagonal_sweeps_are_held_out_where_others_surround_them(clean: Recording) -> None:
    made = prepare(clean, Criteria())
    held = [p for p in made.pieces if p.held_out]
    injections = [p for p in made.pieces if p.stage is SegmentStage.INJECTION]
    assert 0 < sum(p in held for p in injections) <= len(injections) / 5 + 1
    sweeps = [p for p in made.pieces if p.stage is SegmentStage.CLASSICAL]
    assert [p in held for p in sweeps] == [p.segment.settings["swept_axis"] == "dq" for p in sweeps]
    few = Criteria(weak_form=WeakFormCriteria(held_out_from=len(injections) + 1))
    assert not any(p.held_out for p in prepare(clean, few).pieces if p.stage is SegmentStage.INJECTION)


def test_what_is_too_short_is_stated_once_a_stage(clean: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    holds = clean.segments(SegmentStage.RESISTANCE)
    longest = max(segment.samples for segment in holds)
    monkeypatch.setattr(segments, "MIN_SEGMENT_SAMPLES", longest + 1)
    made = prepare(clean, Criteria())
    stated = [remark.text for remark in made.remarks if remark.code == "too_short"]
    assert f"{holds[0].id} to {holds[-1].id} ({len(holds)}): too short to be used" in stated
    assert not any(holds[1].id in text for text in stated)
    assert len(stated) < 4


def test_a_part_to_search_in_keeps_points_evenly_spread_and_their_beginnings(monkeypatch: pytest.MonkeyPatch) -> None:
    made = prepared(plan())
    monkeypatch.setattr(preparation, "COARSE_POINTS", 2)
    monkeypatch.setattr(preparation, "COARSE_TURNS", 0.5)
    part = coarse(made)
    injections = [p.segment.id for p in made.pieces if p.stage is SegmentStage.INJECTION]
    kept = [p for p in part.pieces if p.stage is SegmentStage.INJECTION]
    assert [p.segment.id for p in kept] == [injections[0], injections[-1]]
    whole = made.pieces[-1].signals
    assert len(kept[-1].signals.v_dc) == len(whole.v_dc) // 2 + 1
    np.testing.assert_array_equal(kept[-1].signals.i_ab, whole.i_ab[: len(whole.v_dc) // 2 + 1])
    assert kept[-1].signals.i_m_ab is kept[-1].signals.i_ab


def test_range_of_currents_is_the_believed_frames_with_gates_off_aside() -> None:
    low, high, q = prepared(plan(), noise_a=0.0, angle=0.8).current_range
    assert low == pytest.approx(-2.5, rel=0.05)
    assert high == pytest.approx(2.5, rel=0.1)
    assert q == pytest.approx(2.5, rel=0.1)


def test_each_segment_knows_where_the_current_was_before(clean: Recording) -> None:
    pieces = prepare(clean, Criteria()).pieces
    assert pieces[0].signals.came_from_ab is None
    for before, after in pairwise(pieces):
        came_from = after.signals.came_from_ab
        assert came_from is not None
        if before.stage is SegmentStage.GATES_OFF:
            assert not came_from[-1].any()
        elif before.stage is SegmentStage.RESISTANCE:
            assert np.abs(came_from[-1] - before.signals.i_ab.mean(axis=0)).max() < 0.05


def test_a_way_turns_where_the_sweep_before_turned(clean: Recording) -> None:
    pieces = prepare(clean, Criteria()).pieces
    before, after = next(pair for pair in pairwise(pieces) if pair[0].stage is SegmentStage.CLASSICAL)
    way = after.signals.came_from_ab
    assert way is not None
    assert 10 < len(way) <= 24
    for end in (np.min, np.max):
        assert_close(end(way, axis=0), end(before.signals.i_ab, axis=0), 0.1, of=before.signals.i_ab)
    assert_close(way[-1], before.signals.i_ab[-1], 0.05, of=before.signals.i_ab)


def test_a_turned_rotor_was_left_without_current(clean: Recording) -> None:
    holds = [s for s in clean.segments() if s.stage is SegmentStage.RESISTANCE]
    turned = [s.model_copy(update={"rotor_angle_rad": s.rotor_angle_rad + 1.0}) if s is holds[-1] else s for s in holds]

    class Turned(Recording):
        def segments(self, *_: SegmentStage) -> list[Segment]:
            return turned

    made = prepare(Turned(clean.path, clean.manifest), Criteria())
    last = made.pieces[-1].signals.came_from_ab
    assert last is not None
    assert not last.any()
    assert made.pieces[-2].signals.came_from_ab is not None
    assert [piece.signals.turned_rad for piece in made.pieces[-2:]] == [0.0, 1.0]


@pytest.mark.parametrize("unread", [0, 1])
@pytest.mark.parametrize("angle", [0.0, 2.0])
def test_what_is_a_rounded_zero_throughout_was_not_read(unread: int, angle: float) -> None:
    one = piece(Plan(SegmentStage.CLASSICAL, sweep(1 - unread, 2.0, 0.0)), angle=angle)
    rounded = [np.asarray(x, dtype=np.float32) for x in (one.signals.i_ab, one.signals.v_ab)]
    assert unread_axis(one.segment, *rounded) == unread
    noisy = rounded[0] + np.random.default_rng(4).normal(0.0, 1e-4, rounded[0].shape)
    assert unread_axis(one.segment, noisy, rounded[1]) is None
    assert unread_axis(one.segment, 0.0 * rounded[0], 0.0 * rounded[1]) is None


def test_the_largest_command_is_counted_before_each_reading_of_a_mean() -> None:
    a, b, c = [1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9]
    parts = largest_command(np.array([a, a, b, c, c, a, b]), 3)
    # Before the readings: a (none is known), a, a; b, c, c; the last block is incomplete.
    np.testing.assert_allclose(parts, [[1.0, 0.0, 0.0], [0.0, 1 / 3, 2 / 3]])


def _phases(*, gain_c: float = 1.0, noise_a: float = 0.004) -> Array:
    rng = np.random.default_rng(5)
    angle = np.linspace(0.0, 6.0, 900)
    true = np.stack([np.cos(angle - k * 2.0 * np.pi / 3.0) for k in range(3)], axis=1)
    return np.asarray(true * np.array([1.0, 1.0, gain_c]) + rng.normal(0.0, noise_a, true.shape))


def _three(i_abc: Array) -> Array:
    a, b, c = i_abc.T
    return np.stack([(2.0 * a - b - c) / 3.0, (b - c) / np.sqrt(3.0)], axis=1)


def _two(i_abc: Array) -> Array:
    a, b, _ = i_abc.T
    return np.stack([a, (a + 2.0 * b) / np.sqrt(3.0)], axis=1)


def test_a_vector_of_three_readings_is_reported_from_one_of_two() -> None:
    for phases in (_phases(), _phases(gain_c=1.01, noise_a=0.0)):
        assert clarke_of_three(_three(phases).astype(np.float32), phases.astype(np.float32)) is True
        assert clarke_of_three(_two(phases).astype(np.float32), phases.astype(np.float32)) is False


@pytest.mark.parametrize("computed", [0, 1, 2])
def test_a_third_current_that_was_computed_is_no_third_sensor(computed: int) -> None:
    phases = _phases()
    phases[:, computed] = -np.delete(phases, computed, axis=1).sum(axis=1)
    assert clarke_of_three(_three(phases).astype(np.float32), phases.astype(np.float32)) is False
    exact = phases.astype(np.float32).astype(np.float64)
    assert clarke_of_three(_three(exact), exact) is False


def test_a_vector_of_something_else_says_nothing_of_the_sensors() -> None:
    assert clarke_of_three(1.2 * _three(_phases()), _phases()) is None


def test_means_are_taken_of_what_is_logged_as_of_the_vectors() -> None:
    phases, warmth, n = _phases(), np.linspace(20.0, 21.0, 900), 900
    capture = Capture(
        start_s=0.0,
        sampling_frequency_hz=1e4,
        i_ab=_three(phases),
        v_ab=np.zeros((n, 2)),
        v_dc=np.full(n, 540.0),
        i_abc=phases,
        temperature_c=warmth,
    )
    found = logged_fields(capture, 90, 10)
    assert found["i_abc"] == pytest.approx(phases.reshape(90, 10, 3).mean(axis=1))
    assert found["temperature_c"] == pytest.approx(warmth.reshape(90, 10).mean(axis=1))
    assert found["clarke_of_three"] is True
    assert logged_fields(capture, n, 1)["i_abc"].base is phases


def test_temperatures_count_from_the_first_that_was_logged() -> None:
    bare = piece(Plan(SegmentStage.RESISTANCE, hold(1.0, 0.0))).signals
    logged = [replace(bare, temperature_c=np.full(600, t)) for t in (31.0, 40.0)]
    assert [s.start_temperature_c for s in since_the_start([bare, *logged])] == [31.0, 31.0, 31.0]
    assert since_the_start([bare]) == [bare]
