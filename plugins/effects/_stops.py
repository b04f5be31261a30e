"""Vector stop operators: elastic up to a limit and then yielding, in any direction.

Source: A. Bergqvist, Physica B 233 (1997), doi:10.1016/S0921-4526(97)00319-0; the yielding: Y.-K. Wen, J. Eng. Mech.
Div. 102 (1976) 249.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array
from plugins.effects._vectors import Starts

YIELD_STEPS = 1024
"""Steps of `yields_of`; linear interpolation is accurate to 3e-6 of the limits for a softness of 0.1 or more."""


@lru_cache(maxsize=32)
def yields_of(softness: float) -> Array:
    """The part of an outward step that a stop yields, tabulated by size / limit in `YIELD_STEPS` steps, plus one.

    Of shape (0,) where it yields only at its limit.
    """
    # A hundredth power is practically a sharp limit.
    full = np.minimum(np.arange(YIELD_STEPS + 2) / YIELD_STEPS, 1.0) if softness > 1e-2 else np.zeros(0)
    return np.asarray(full ** (1.0 / max(softness, 1e-2)))


class Course(NamedTuple):
    """Input of stops by segment: a path to its start, and its values."""

    values: Array
    """Shape (N, 2)."""
    starts: Starts
    """Values `starts[s]` up to `starts[s + 1]` are those of segment s."""
    ways: Array
    """Paths before the segments, oldest first, shape (M, 2)."""
    way_starts: Starts
    """Bounds of the paths; a path may be empty."""


@njit(cache=True, nogil=True)
def stops(course: Course, stiffness: Array, limits: Array, yields: Array, giving: float, off: Array) -> Array:
    """Sum of vector stop operators, segment by segment.

    The state at the start of a path is zero.

    Parameters
    ----------
    off : array, shape (segments, stops, 2)
        State added at the start of a segment's values, in the stops' limits.
    yields : array
        Table of `yields_of`: outwards a stop moves by the part of the elastic step that it does not yield; without a
        table it moves by all of it below its limit.
    giving : float
        Part of the yielding that is independent of the direction.

    Returns
    -------
    array, shape (N, 2)
    """
    out = np.empty_like(course.values)
    held = np.empty((limits.shape[0], 2))
    fillings = stiffness / limits
    soft = yields.size > 0
    for s in range(course.starts.shape[0] - 1):
        held[:] = 0.0
        first, way = course.starts[s], course.way_starts[s]
        before = course.way_starts[s + 1] - way
        old_a, old_b = 0.0, 0.0
        for k in range(before + course.starts[s + 1] - first):
            if k < before:
                new_a, new_b = course.ways[way + k, 0], course.ways[way + k, 1]
            else:
                new_a, new_b = course.values[first + k - before, 0], course.values[first + k - before, 1]
            step_a, step_b = (new_a - old_a, new_b - old_b) if k > 0 else (0.0, 0.0)
            old_a, old_b = new_a, new_b
            length = math.sqrt(step_a * step_a + step_b * step_b) if soft else 0.0
            # A stop depends only on its own last step, so that all are advanced together.
            for m in range(limits.shape[0]):
                a, b, limit = held[m, 0], held[m, 1], limits[m]
                if not soft:
                    held[m, 0], held[m, 1] = _within(a + stiffness[m] * step_a, b + stiffness[m] * step_b, limit)
                    continue
                # A step of the input may exceed the range in which a stop yields.
                parts = 1 + min(int(8.0 * length * fillings[m]), 3)
                share = stiffness[m] / parts
                da, db, far = share * step_a, share * step_b, share * length
                for _ in range(parts):
                    part, along = 0.0, a * da + b * db
                    if along > 0.0 or giving > 0.0:
                        size = max(math.sqrt(a * a + b * b), 1e-12 * limit)
                        outwards = max(along / size, 0.0)
                        # Midpoint rule over the outward step; inlined, as passing arrays costs reference counting.
                        full = min(1.0, abs(size + 0.5 * along / size) / limit) * YIELD_STEPS
                        below = int(full)
                        part = yields[below] + (full - below) * (yields[below + 1] - yields[below])
                        part *= ((1.0 - giving) * outwards + giving * far) / size
                    a, b = _within(a + da - part * a, b + db - part * b, limit)
                held[m, 0], held[m, 1] = a, b
            if k == before:
                _remember(held, off[s], limits)
            if k >= before:
                sum_a, sum_b = 0.0, 0.0
                for m in range(limits.shape[0]):
                    sum_a += held[m, 0]
                    sum_b += held[m, 1]
                out[first + k - before, 0], out[first + k - before, 1] = sum_a, sum_b
    return out


@njit(cache=True, nogil=True)
def _remember(held: Array, off: Array, limits: Array) -> None:
    """Add a state to the stops in place: both (stops, 2), `off` in the stops' limits."""
    for m in range(limits.shape[0]):
        a, b = held[m, 0], held[m, 1]
        # A state that would exceed the limit is added with the opposite sign.
        more_a, more_b = off[m, 0] * limits[m], off[m, 1] * limits[m]
        side = -1.0 if (a + more_a) ** 2 + (b + more_b) ** 2 > limits[m] ** 2 else 1.0
        a, b = a + side * more_a, b + side * more_b
        beyond = max(math.sqrt(a * a + b * b) / limits[m], 1.0)
        held[m, 0], held[m, 1] = a / beyond, b / beyond


@njit(cache=True, nogil=True)
def _within(a: float, b: float, limit: float) -> tuple[float, float]:
    """A vector (a, b), limited in length."""
    square = a * a + b * b
    if square > limit * limit:
        scale = limit / math.sqrt(square)
        a *= scale
        b *= scale
    return a, b
