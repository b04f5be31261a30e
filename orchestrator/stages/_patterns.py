"""Points of the stages in the current plane: paths, grids and steps, independent of the motor."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

from protocols import Excitation, Point, Spin, Stage, Trapezoid, VoltageSteps

MAX_POINTS = 100_000
"""Largest number of points; a misplaced decimal point gives millions."""


def steps(half_range: float, step: float) -> list[float]:
    """From -half_range to +half_range through zero, in equal steps of about `step`."""
    count = max(1, round(half_range / step))
    return [_clean(half_range * k / count) for k in range(-count, count + 1)]


def five_values(half_range: float) -> tuple[float, ...]:
    """The default held currents."""
    return tuple(steps(half_range, half_range / 2))


def paths(axes: Iterable[str], held: Sequence[float], along: Sequence[float]) -> list[Point]:
    """The classical trajectories' paths, point by point, every second one backwards.

    Parameters
    ----------
    axes : iterable of {"q", "d", "dq"}
        Families, in order: q swept at held i_d, d swept at held i_q, both together.
    held : sequence of float
        Held currents [A].
    along : sequence of float
        Currents along a path [A]; along the diagonal, the length of the vector.
    """
    lines: list[list[Point]] = []
    for axis in axes:
        if axis == "q":
            lines += [[(h, a) for a in along] for h in held]
        elif axis == "d":
            lines += [[(a, h) for a in along] for h in held]
        else:
            lines.append([(_clean(a / math.sqrt(2)), _clean(a / math.sqrt(2))) for a in along])
    return _back_and_forth(lines)


def grid(d_values: Sequence[float], q_values: Sequence[float]) -> list[Point]:
    """All combinations, row by row of constant i_d in alternating direction."""
    return _back_and_forth([[(d, q) for q in q_values] for d in d_values])


def on_axis(axis: Literal["d", "q"], currents: Iterable[float]) -> list[Point]:
    """Currents along one axis, each with its negative: all positive ones first."""
    both = [sign * current for sign in (1, -1) for current in currents]
    return [(_clean(value), 0.0) if axis == "d" else (0.0, _clean(value)) for value in both]


def within(points: Sequence[Point], radius: float) -> list[Point]:
    """The points whose vector is no longer than `radius`."""
    return [point for point in points if math.hypot(*point) <= radius]


def largest_q_a(stages: Iterable[Stage]) -> float:
    """Largest q-axis current of stages with all settings [A]; 0 without one."""
    return max((_on_q(point.excitation) for stage in stages for point in stage.points()), default=0.0)


def _on_q(excitation: Excitation) -> float:
    if isinstance(excitation, VoltageSteps):
        return excitation.turn_q_a
    if isinstance(excitation, Spin):
        return 0.0  # no current holds the rotor then
    if not isinstance(excitation, Trapezoid):
        return abs(excitation.start_dq_a[1])
    along = excitation.amplitude_a
    return {"q": along, "d": abs(excitation.held_a), "dq": along / math.sqrt(2)}[excitation.swept_axis]


def _back_and_forth(lines: Sequence[Sequence[Point]]) -> list[Point]:
    return [point for k, line in enumerate(lines) for point in (line if k % 2 == 0 else reversed(line))]


def _clean(value: float) -> float:
    # Rounding to a nano-ampere and removing negative zero keeps the numbers readable.
    return round(value, 9) + 0.0
