"""Segments that inject along one axis only, brought together by the point that they share: first d, then q."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.numerics.types import Array
from protocols import Segment

SAME_FREQUENCY = 0.03
"""Relative difference within which two injected frequencies are one: what a drive's clock changes."""
SAME_CURRENT = 0.03
"""Of the largest current, within which two points are one."""


@dataclass(frozen=True)
class OneWay:
    """A segment whose voltage ripples along one axis.

    Attributes
    ----------
    segment : Segment
    frequency_hz : float
    current : array, shape (2,)
        Mean current in the stator's frame [A].
    axis_rad : float
        Along which it ripples there.
    """

    segment: Segment
    frequency_hz: float
    current: Array
    axis_rad: float


def by_point(some: Sequence[OneWay]) -> list[list[OneWay]]:
    """Those of one point, frequency and rotor angle together, in order of time; alone where there is no other."""
    reach = max((math.hypot(*one.current) for one in some), default=0.0)
    points: list[list[OneWay]] = []
    for one in some:
        point = next((p for p in points if _is_of(p[0], one, SAME_CURRENT * reach)), None)
        if point is None:
            points.append(point := [])
        point.append(one)
    return points


def _is_of(first: OneWay, other: OneWay, apart_a: float) -> bool:
    return (
        math.isclose(first.frequency_hz, other.frequency_hz, rel_tol=SAME_FREQUENCY)
        and math.hypot(*(first.current - other.current)) <= apart_a
        and math.isclose(first.segment.rotor_angle_rad, other.segment.rotor_angle_rad, abs_tol=1e-6)
    )


def shows_both_axes(point: Sequence[OneWay], apart_rad: float = 0.3) -> bool:
    """Whether the waves at a point go along axes that are apart."""
    turned = [abs((one.axis_rad - point[0].axis_rad + 0.5 * math.pi) % math.pi - 0.5 * math.pi) for one in point]
    return max(turned) > apart_rad
