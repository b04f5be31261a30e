"""Effect checks: evaluation on a batch of segments gives the same result as on each segment alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from protocols import Correction, Effect, EffectParameters, SignalBatch, Signals, hook_of

ROUNDING_RATIO = 1e-9
"""Difference by rounding, over an array's largest value."""
SEGMENT_BOUNDS = (0.0, 0.1, 0.15, 0.6, 1.0)
"""Where the kit's signals are cut into segments."""


class EffectBatchChecks(ABC):
    """Checks of `correct_batch` and `random_directions_batch`; an effect without them passes."""

    @abstractmethod
    def make_effect(self) -> Effect: ...

    @abstractmethod
    def signals(self) -> Signals: ...

    def test_a_batch_is_corrected_as_its_segments_alone(self) -> None:
        effect = self.make_effect()
        correct_batch = hook_of(effect, "correct_batch")
        if correct_batch is None:
            return
        batch = SignalBatch.of(_segments(self.signals()))
        for parameters in _settings(effect):
            alone = [effect.correct(signals, parameters) for signals in batch.segments]
            _compare("correct_batch", batch, correct_batch(batch, parameters), alone)

    def test_random_directions_of_a_batch_are_those_of_its_segments(self) -> None:
        effect = self.make_effect()
        of_segment, of_batch = hook_of(effect, "random_directions"), hook_of(effect, "random_directions_batch")
        if of_segment is None or of_batch is None:
            assert of_batch is None, "it has random_directions_batch, and lacks random_directions for a single segment"
            return
        batch = SignalBatch.of(_segments(self.signals()))
        for parameters in _settings(effect):
            alone = [of_segment(signals, parameters) for signals in batch.segments]
            directions = of_batch(batch, parameters)
            assert {len(directions)} == set(map(len, alone)), "random_directions_batch returns another number"
            for m, direction in enumerate(directions):
                _compare(f"random_directions_batch, number {m}", batch, direction, [one[m] for one in alone])

    def test_a_batch_is_not_modified(self) -> None:
        effect = self.make_effect()
        batch = SignalBatch.of(_segments(self.signals()))
        arrays = {name: array for name, array in vars(batch).items() if isinstance(array, np.ndarray)}
        before = {name: array.tobytes() for name, array in arrays.items()}
        for array in arrays.values():
            array.flags.writeable = False
        hooks = (hook_of(effect, "correct_batch"), hook_of(effect, "random_directions_batch"))
        for hook in (hook for hook in hooks if hook is not None):
            for parameters in _settings(effect):
                hook(batch, parameters)
        changed = [name for name, array in arrays.items() if array.tobytes() != before[name]]
        assert not changed, f"modified in place: {changed}"


def _settings(effect: Effect) -> tuple[EffectParameters, EffectParameters]:
    """All typical; and each parameter some way from there to its upper bound, so that refinements take part."""
    declared = effect.Parameters.declared()
    typical = {p.name: p.typical for p in declared}
    moved = {p.name: p.typical + min(0.3 * p.prior_width, 0.5 * (p.high - p.typical)) for p in declared}
    return effect.Parameters(**typical), effect.Parameters(**moved)


def _segments(signals: Signals) -> list[Signals]:
    """Pieces of some signals, which differ in all that segments of a recording may differ in."""
    n = len(signals.v_dc)
    ends = [round(part * n) for part in SEGMENT_BOUNDS]
    pieces = []
    for k, (first, end) in enumerate(pairwise(ends)):
        update: dict[str, Any] = {
            "start_s": signals.start_s + first / signals.sampling_frequency_hz,
            "sampling_frequency_hz": signals.sampling_frequency_hz * (1.0, 2.0, 1.0, 1.0)[k],
            "pwm_frequency_hz": signals.pwm_frequency_hz * (1.0, 2.0, 2.0, 1.0)[k],
            "turned_rad": signals.turned_rad * (1.0, 0.0, 0.5, 1.0)[k],
        }
        for name in (field.name for field in fields(signals)):
            array = getattr(signals, name)
            if isinstance(array, np.ndarray) and len(array) == n and name != "came_from_ab":
                update[name] = array[first:end]
        if k == 3:
            update |= {"came_from_ab": None, "losses": None, "v_late_ab": None}
        pieces.append(replace(signals, **update))
    # Backwards, so that none goes on where the one beside it ends.
    return pieces[::-1]


def _compare(call: str, batch: SignalBatch, result: object, alone: Sequence[Correction]) -> None:
    """Complains where a correction of a batch is not that of each segment alone."""
    assert isinstance(result, Correction), f"{call} returned {type(result).__name__} instead of a Correction"
    for name in sorted(set(result.arrays).union(*(one.arrays for one in alone))):
        there = getattr(batch, name)
        whole = np.asarray(result.arrays.get(name, there))
        tail = () if name in ("v_dc", "theta_rad", "resistance_ohm") else (2,)
        shape = (batch.samples, *tail)
        assert np.shape(whole) == shape, f"{call}: {name} has shape {np.shape(whole)} instead of {shape}"
        assert whole.dtype.kind == "f", f"{call}: {name} is of type {whole.dtype}"
        for k, one in enumerate(alone):
            part = batch.slice_of(k)
            expected = one.arrays.get(name, np.zeros((1, *tail)) if there is None else there[part])
            off = float(np.abs(whole[part] - expected).max())
            assert off <= ROUNDING_RATIO * float(np.abs(expected).max()), (
                f"{call}: {name} of segment {k} of {len(alone)} differs by {off:.2g} from what the segment alone "
                "becomes: does it look beyond a segment's ends, or take one's sampling or PWM frequency for all?"
            )
