"""Where in the current plane the stages measure: paths, grids and steps, as plain points; no motor is known here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from protocols import Point

MOST_POINTS = 100_000
"""More than anybody measures; a slip of the decimal point gives millions."""

_D_FRACTIONS = (1 / 30, 1 / 12, 1 / 6, 1 / 3, 2 / 3, 1.0)
_Q_FRACTIONS = (1 / 12, 1 / 3, 1.0)


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


def resistance_steps(amplitude: float) -> list[Point]:
    """Direct currents on both axes, denser near zero, where the inverter's own voltages show."""
    on_d = [(_clean(sign * f * amplitude), 0.0) for sign in (1, -1) for f in _D_FRACTIONS]
    on_q = [(0.0, _clean(sign * f * amplitude)) for sign in (1, -1) for f in _Q_FRACTIONS]
    return on_d + on_q


def within(points: Sequence[Point], radius: float) -> list[Point]:
    """The points whose vector is no longer than `radius`."""
    return [point for point in points if math.hypot(*point) <= radius]


def _back_and_forth(lines: Sequence[Sequence[Point]]) -> list[Point]:
    return [point for k, line in enumerate(lines) for point in (line if k % 2 == 0 else reversed(line))]


def _clean(value: float) -> float:
    # Rounded to a nano-ampere, and no negative zero: these numbers are read by people.
    return round(value, 9) + 0.0
