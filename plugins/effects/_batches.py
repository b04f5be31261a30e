"""Base classes of the built-in effects, which are evaluated for batches, and common quantities of a batch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

import protocols
from orchestrator.numerics.types import Array, Indices
from protocols import (
    Correction,
    RandomDirectionsBatchEffect,
    RandomDirectionsEffect,
    RealArray,
    SignalBatch,
    Signals,
)


class BatchEffect(protocols.BatchEffect, ABC):
    """Base of an effect that is evaluated on many segments in one call."""

    @abstractmethod
    def correct_batch(self, batch: SignalBatch, p: Any) -> Correction:
        """The signals corrected for this effect, each segment independently."""

    def correct(self, signals: Signals, p: Any) -> Correction:
        """`correct_batch` of one segment."""
        return self.correct_batch(SignalBatch.of([signals]), p)


class RandomBatchEffect(BatchEffect, RandomDirectionsEffect, RandomDirectionsBatchEffect):
    """Base of an effect with random directions."""

    @abstractmethod
    def random_directions_batch(self, batch: SignalBatch, p: Any) -> Sequence[Correction]:
        """Change of each segment by one standard deviation of each of its unknown quantities."""

    def random_directions(self, signals: Signals, p: Any) -> Sequence[Correction]:
        """`random_directions_batch` of one segment."""
        return self.random_directions_batch(SignalBatch.of([signals]), p)


def by_value(values: RealArray) -> Iterator[tuple[float, Indices]]:
    """Each distinct value of an array (segments,), with the indices of its segments."""
    if (values == values[0]).all():
        yield float(values[0]), np.arange(len(values))
        return
    for value in np.unique(values):
        yield float(value), np.flatnonzero(values == value)


def per_segment(values: RealArray, of: Callable[[float], RealArray]) -> Array:
    """A function's arrays for each segment, shape (segments, ...), evaluated once per distinct value (segments,)."""
    groups = [(np.asarray(of(value)), which) for value, which in by_value(values)]
    out = np.empty((len(values), *groups[0][0].shape))
    for array, which in groups:
        out[which] = array
    return out


def pwm_share(batch: SignalBatch) -> Array:
    """Each segment's PWM frequency over the drive's nominal one, (segments,); 1 where that is unknown."""
    nominal_hz = batch.drive.pwm_frequency_hz if batch.drive is not None else None
    return np.asarray(batch.pwm_frequency_hz / (nominal_hz or batch.pwm_frequency_hz))


def rated_current_a(batch: SignalBatch) -> float:
    """The motor's rated current [A]; 0 if unknown."""
    return (batch.motor.rated_current_a if batch.motor is not None else None) or 0.0


def of_three_readings(batch: SignalBatch) -> Indices:
    """1 where the vector was computed from three readings, else 0; shape (segments,)."""
    return np.array([s.clarke_of_three is True for s in batch.segments], dtype=np.intp)
