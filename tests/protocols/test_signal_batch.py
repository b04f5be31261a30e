"""Segments laid end to end come back as they were, and what changes of a batch is what changes of each."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from protocols import Correction, SignalBatch, Signals

RATES_HZ = (10_000.0, 8_000.0, 10_000.0)
LENGTHS = (5, 9, 4)
ALWAYS = ("i_ab", "v_ab", "v_dc", "theta_rad", "resistance_ohm", "i_m_ab", "heat_j")
OF_MODEL = ("psi_ab", "psi_smooth_ab", "i_smooth_ab")


def signals(n: int, rate_hz: float = 10_000.0, seed: int = 1, **more: Any) -> Signals:
    rng = np.random.default_rng(seed)
    vectors: dict[str, Any] = {name: rng.normal(size=(n, 2)) for name in ("i_ab", "v_ab", "i_m_ab")}
    scalars: dict[str, Any] = {name: rng.normal(size=n) for name in ("v_dc", "theta_rad", "resistance_ohm", "heat_j")}
    return Signals(
        start_s=100.0 * seed,
        sampling_frequency_hz=rate_hz,
        pwm_frequency_hz=2.0 * rate_hz,
        turned_rad=0.1 * seed,
        **vectors,
        **scalars,
        **more,
    )


SEGMENTS = [signals(n, rate, k) for k, (n, rate) in enumerate(zip(LENGTHS, RATES_HZ, strict=True))]


def test_segments_are_laid_end_to_end() -> None:
    batch = SignalBatch.of(SEGMENTS)
    assert batch.samples == sum(LENGTHS)
    np.testing.assert_array_equal(batch.starts, [0, 5, 14, 18])
    for name in ALWAYS:
        array = getattr(batch, name)
        np.testing.assert_array_equal(array, np.concatenate([getattr(s, name) for s in SEGMENTS]))
        assert array.flags.c_contiguous
    np.testing.assert_array_equal(batch.sampling_frequency_hz, RATES_HZ)
    np.testing.assert_array_equal(batch.pwm_frequency_hz, [2.0 * rate for rate in RATES_HZ])
    np.testing.assert_array_equal(batch.start_s, [0.0, 100.0, 200.0])
    np.testing.assert_array_equal(batch.turned_rad, [s.turned_rad for s in SEGMENTS])


def test_each_segment_comes_back_as_it_was_laid() -> None:
    batch = SignalBatch.of(SEGMENTS)
    for k, one in enumerate(SEGMENTS):
        back = batch.segment(k)
        for name in (field.name for field in fields(one)):
            np.testing.assert_array_equal(getattr(back, name), getattr(one, name), err_msg=name)


def test_the_arrays_of_a_single_segment_are_its_own() -> None:
    one = SEGMENTS[1]
    batch = SignalBatch.of([one])
    for name in ALWAYS:
        assert np.shares_memory(getattr(batch, name), getattr(one, name))


def test_a_segment_of_a_changed_batch_has_what_changed() -> None:
    batch = SignalBatch.of(SEGMENTS)
    theta = np.arange(float(batch.samples))
    changed = batch.replaced({"theta_rad": theta})
    np.testing.assert_array_equal(changed.segment(1).theta_rad, theta[5:14])
    np.testing.assert_array_equal(changed.segment(1).v_ab, SEGMENTS[1].v_ab)
    np.testing.assert_array_equal(batch.segment(1).theta_rad, SEGMENTS[1].theta_rad)


def test_every_sample_has_the_time_that_it_has_in_its_segment() -> None:
    expected = np.concatenate([s.time_s for s in SEGMENTS])
    np.testing.assert_allclose(SignalBatch.of(SEGMENTS).time_s, expected, rtol=1e-15)
    np.testing.assert_allclose(SignalBatch.of(SEGMENTS[1:2]).time_s, SEGMENTS[1].time_s, rtol=1e-15)


def test_a_value_of_each_segment_is_one_of_each_sample() -> None:
    batch = SignalBatch.of(SEGMENTS)
    np.testing.assert_array_equal(batch.per_sample(np.array([1.0, 2.0, 3.0])), [1.0] * 5 + [2.0] * 9 + [3.0] * 4)
    # One number is enough where it is the same throughout.
    np.testing.assert_array_equal(batch.per_sample(np.array([7.0, 7.0, 7.0])), [7.0])
    np.testing.assert_array_equal(SignalBatch.of(SEGMENTS[:1]).per_sample(np.array([3])), [3.0])


@pytest.mark.parametrize("name", ["v_late_ab", "i_quiet_ab", *OF_MODEL, "inductance_ab"])
def test_what_no_segment_has_the_batch_has_not(name: str) -> None:
    batch = SignalBatch.of(SEGMENTS)
    assert getattr(batch, name) is None
    assert getattr(batch.segment(0), name) is None


@pytest.mark.parametrize("name", ["v_late_ab", "i_quiet_ab"])
def test_what_only_some_segments_have_changes_nothing_in_the_others(name: str) -> None:
    own = np.full((LENGTHS[1], 2), 0.5)
    some = [SEGMENTS[0], SEGMENTS[1].replaced({name: own}), SEGMENTS[2]]
    batch = SignalBatch.of(some)
    np.testing.assert_array_equal(getattr(batch.segment(1), name), own)
    for k in (0, 2):
        nothing = some[k].i_ab if name == "i_quiet_ab" else np.zeros((LENGTHS[k], 2))
        np.testing.assert_array_equal(getattr(batch.segment(k), name), nothing)


@pytest.mark.parametrize(("name", "width"), [*((name, 2) for name in OF_MODEL), ("inductance_ab", 3)])
def test_what_the_model_makes_of_every_segment_is_laid_end_to_end(name: str, width: int) -> None:
    parts = [np.random.default_rng(k).normal(size=(n, width)) for k, n in enumerate(LENGTHS)]
    batch = SignalBatch.of([s.replaced({name: part}) for s, part in zip(SEGMENTS, parts, strict=True)])
    np.testing.assert_array_equal(getattr(batch, name), np.concatenate(parts))
    np.testing.assert_array_equal(getattr(batch.segment(2), name), parts[2])


def test_what_magnetises_moves_along_with_the_current() -> None:
    quiet = [replace(s, i_quiet_ab=s.i_ab + 1.0) for s in SEGMENTS]
    batch = SignalBatch.of(quiet)
    moved = np.random.default_rng(9).normal(size=batch.i_ab.shape)
    along = batch.changed_along({"i_ab": batch.i_ab + moved})
    assert set(along) == {"i_ab", "i_m_ab", "i_quiet_ab"}
    np.testing.assert_allclose(along["i_m_ab"] - batch.i_m_ab, moved, atol=1e-15)
    np.testing.assert_allclose(along["i_quiet_ab"] - (batch.i_ab + 1.0), moved, atol=1e-14)


def test_what_magnetises_is_what_an_effect_says_where_it_says_so() -> None:
    batch = SignalBatch.of(SEGMENTS)
    own = np.zeros_like(batch.i_ab)
    assert batch.changed_along({"i_ab": batch.i_ab + 1.0, "i_m_ab": own})["i_m_ab"] is own
    assert set(batch.changed_along({"v_ab": own})) == {"v_ab"}
    assert "i_quiet_ab" not in batch.changed_along({"i_ab": own})


def test_a_batch_is_corrected_as_each_of_its_segments_is() -> None:
    batch = SignalBatch.of(SEGMENTS)
    correction = Correction(i_ab=2.0 * batch.i_ab, theta_rad=batch.theta_rad + 0.1)
    together = batch.corrected(correction)
    for k, one in enumerate(SEGMENTS):
        alone = one.corrected(Correction(i_ab=2.0 * one.i_ab, theta_rad=one.theta_rad + 0.1))
        for name in ALWAYS:
            np.testing.assert_array_equal(getattr(together.segment(k), name), getattr(alone, name), err_msg=name)
    assert batch.corrected(Correction()) is batch


def test_other_facts_of_its_segments_leave_the_arrays_alone() -> None:
    batch = SignalBatch.of(SEGMENTS)
    came = np.array([[0.1, 0.2]])
    other = batch.with_segments([replace(s, came_from_ab=came) for s in SEGMENTS])
    assert other.v_ab is batch.v_ab
    assert other.segment(1).came_from_ab is came
    assert batch.segment(1).came_from_ab is None
