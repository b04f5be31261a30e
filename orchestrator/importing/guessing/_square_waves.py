"""Find square waves of a voltage command that are slower than the windows of the classification.

A half-wave is a stretch of constant voltage between two edges. Three periods or more of half-waves of one length, whose
levels alternate, are a square wave; a sweep's voltage moves between its edges, and a hold's lengths differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]

_EDGE_SHARE = 0.03
"""Change of the voltage within one sample, as a share of the largest, that is an edge."""
_LEVEL_SHARE = 0.2
"""Deviation from a level, as a share of the step between two levels, that is no constant voltage any more."""
_MIN_HALF_WAVES = 6
_LENGTH_TOLERANCE = 0.05
"""Relative difference of successive half-waves' lengths; two rows always count as equal."""


@dataclass(frozen=True)
class SquareWave:
    """Rows of a square wave about one mean, from `start` to before `end`."""

    start: int
    end: int
    half_period: int
    """In rows."""
    step_v: float
    """Between the two levels [V]."""


def square_waves(v: Complex, largest_v: float, min_half_period: int) -> Iterator[SquareWave]:
    """The square waves in an uninterrupted voltage whose half-waves have so many rows or more, in order of time."""
    moves = np.abs(np.diff(v)) > _EDGE_SHARE * largest_v
    # An edge that takes two rows counts once.
    edges = np.flatnonzero(moves & ~np.concatenate([[False], moves[:-1]])) + 1
    bounds = np.concatenate([[0], edges, [v.size]])
    lengths = np.diff(bounds)
    if lengths.size < _MIN_HALF_WAVES:
        return
    levels = np.add.reduceat(v, bounds[:-1]) / lengths
    is_equal = np.abs(np.diff(lengths)) <= np.maximum(2.0, _LENGTH_TOLERANCE * lengths[:-1])
    is_equal &= np.minimum(lengths[:-1], lengths[1:]) >= min_half_period
    steps = np.abs(np.diff(levels))
    # Half-wave k + 2 continues the wave of k and k + 1.
    continues = is_equal[:-1] & is_equal[1:] & (np.abs(levels[2:] - levels[:-2]) < _LEVEL_SHARE * steps[1:])
    changes = np.flatnonzero(np.diff(np.concatenate([[False], continues, [False]])))
    for first, last in changes.reshape(-1, 2).tolist():  # half-waves first to last + 1 are of one wave
        count = last + 2 - first
        start, end = int(bounds[first]), int(bounds[last + 2])
        deviation = np.abs(v[start:end] - np.repeat(levels[first : last + 2], lengths[first : last + 2]))
        if count >= _MIN_HALF_WAVES and np.quantile(deviation, 0.9) < _LEVEL_SHARE * steps[first]:
            yield SquareWave(start, end, int(np.median(lengths[first : last + 2])), float(steps[first]))
