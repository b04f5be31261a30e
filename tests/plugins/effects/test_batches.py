"""A batch of segments is corrected as each of its segments is alone, whatever they differ in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from orchestrator.registry.plugins import PluginKind, installed, load_plugin
from plugins.effects._batches import BatchEffect, RandomBatchEffect, by_value, per_segment
from protocols import Correction, EffectParameters, SignalBatch, Signals
from tests.plugins.effects.segments import (
    segments_alone,
    segments_with_a_model,
    segments_with_a_nameplate,
    settings,
)

BUILT_IN = [info.name for info in installed(PluginKind.EFFECTS) if info.module.startswith("plugins.")]
RECORDINGS = (segments_with_a_model, segments_with_a_nameplate, segments_alone)
ROUNDING = 1e-13
"""Of an array's size. Compilers may sum in another order where segments follow one another."""


def effect(name: str) -> BatchEffect:
    made = load_plugin(PluginKind.EFFECTS, name)()
    assert isinstance(made, BatchEffect)
    return made


def parameters_of(one: BatchEffect) -> type[EffectParameters]:
    found: type[EffectParameters] = one.Parameters  # type: ignore[attr-defined]  # each effect has its own
    return found


@pytest.mark.parametrize("recording", RECORDINGS)
@pytest.mark.parametrize("name", BUILT_IN)
def test_a_batch_is_corrected_as_its_segments_alone(name: str, recording: Callable[[], list[Signals]]) -> None:
    one, segments = effect(name), recording()
    batch = SignalBatch.of(segments)
    for label, p in settings(parameters_of(one)):
        alone = [one.correct(signals, p) for signals in segments]
        _same(batch, one.correct_batch(batch, p), alone, f"{name}, {label}")
        if isinstance(one, RandomBatchEffect):
            directions = [one.random_directions(signals, p) for signals in segments]
            for m, direction in enumerate(one.random_directions_batch(batch, p)):
                _same(batch, direction, [each[m] for each in directions], f"{name}, {label}, direction {m}")


def _same(batch: SignalBatch, correction: Correction, alone: list[Correction], label: str) -> None:
    after = batch.corrected(correction)
    for k, one in enumerate(alone):
        before = batch.segment(k)
        expected = before.corrected(one)
        for name in correction.arrays:
            want, have = getattr(expected, name), getattr(after, name)[batch.slice_of(k)]
            atol = ROUNDING * float(np.abs(want).max())
            np.testing.assert_allclose(have, want, rtol=0.0, atol=atol, err_msg=f"{label}: {name} of segment {k}")
        assert set(one.arrays) <= set(correction.arrays), f"{label}: segment {k} changes what the batch does not"


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_segment_does_not_feel_its_neighbours(name: str) -> None:
    """Nor the order: backwards, each one is what it was."""
    one, segments = effect(name), segments_with_a_model()
    p = dict(settings(parameters_of(one)))["refined"]
    there, back = (SignalBatch.of(order) for order in (segments, segments[::-1]))
    forth, reverse = one.correct_batch(there, p).arrays, one.correct_batch(back, p).arrays
    assert set(forth) == set(reverse)
    for k in range(len(segments)):
        for array in forth:
            ours, theirs = forth[array][there.slice_of(k)], reverse[array][back.slice_of(len(segments) - 1 - k)]
            np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_batch_is_not_written_to(name: str) -> None:
    one, batch = effect(name), SignalBatch.of(segments_with_a_model())
    arrays = {key: array for key, array in vars(batch).items() if isinstance(array, np.ndarray)}
    before = {key: array.tobytes() for key, array in arrays.items()}
    for _, p in settings(parameters_of(one)):
        one.correct_batch(batch, p)
        if isinstance(one, RandomBatchEffect):
            one.random_directions_batch(batch, p)
    assert [key for key, array in arrays.items() if array.tobytes() != before[key]] == []


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_segment_is_not_written_to(name: str) -> None:
    one, segments = effect(name), segments_with_a_model()
    written = []
    for signals in segments:
        named = {field.name: getattr(signals, field.name) for field in fields(signals)}
        arrays = {key: array for key, array in named.items() if isinstance(array, np.ndarray)}
        before = {key: array.tobytes() for key, array in arrays.items()}
        for _, p in settings(parameters_of(one)):
            one.correct(signals, p)
            if isinstance(one, RandomBatchEffect):
                one.random_directions(signals, p)
        written += [key for key, array in arrays.items() if array.tobytes() != before[key]]
    assert written == []


def test_what_depends_on_a_value_alone_is_worked_out_once_for_each() -> None:
    evaluated: list[float] = []

    def of(value: float) -> np.ndarray:
        evaluated.append(value)
        return np.array([value, 2.0 * value])

    values = np.array([3.0, 1.0, 3.0])
    np.testing.assert_array_equal(per_segment(values, of), np.stack([values, 2.0 * values], axis=1))
    assert sorted(evaluated) == [1.0, 3.0]
    assert [(value, which.tolist()) for value, which in by_value(np.full(2, 5.0))] == [(5.0, [0, 1])]
