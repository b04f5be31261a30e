"""Stretches of constant current in a capture, such as holds for the resistance and dwells of a sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from protocols import Capture


@dataclass(frozen=True)
class Dwell:
    """Means over a stretch of constant current, stator frame.

    Attributes
    ----------
    start_s, seconds : float
        Start since the start of the experiment; duration.
    i_ab, v_ab : array, shape (2,)
        Mean current [A] and commanded voltage [V].
    v_covariance : array, shape (2, 2)
        Covariance of the mean voltage, from the scatter of eight sections.
    """

    start_s: float
    seconds: float
    i_ab: Array
    v_ab: Array
    v_covariance: Array


def mean_over_dwell(capture: Capture, first: int = 0, last: int | None = None, delay: float = 0.0) -> Dwell:
    """Means over rows `first` to `last`."""
    last = len(capture) if last is None else last
    # Of a steady stretch the delay only affects the first samples, whose voltage was commanded before.
    first = min(first + int(np.ceil(delay)), last - 1)
    i, v = capture.i_ab[first:last], capture.v_ab[first:last]
    sections = np.array([_mean(section) for section in np.array_split(v, min(8, len(v)))])
    off = sections - sections.mean(axis=0)
    rate = capture.sampling_frequency_hz
    return Dwell(
        start_s=capture.start_s + first / rate,
        seconds=len(v) / rate,
        i_ab=_mean(i),
        v_ab=sections.mean(axis=0),
        v_covariance=off.T @ off / max(len(sections) - 1, 1) / len(sections),
    )


def _mean(x: NDArray[np.floating[Any]]) -> Array:
    """Mean vector, shape (2,); summed as complex numbers, many times faster than short rows."""
    kind = (np.float32, np.complex64) if x.dtype == np.float32 else (np.float64, np.complex128)
    vectors = np.ascontiguousarray(x, dtype=kind[0]).view(kind[1])
    mean: Array = (vectors.sum(axis=0, dtype=np.complex128) / len(x)).view(np.float64)
    return mean


def rests(travel: Array, period: float) -> Iterator[tuple[int, int]]:
    """Ranges [first, last) over which a coordinate stands still, in a motion of the given period (samples).

    It stands still where its rate over a twenty-fifth of a period is below a twentieth of the 95 % quantile.
    """
    reach = max(1, round(period / 50))
    if len(travel) <= 4 * reach:
        return
    rate = np.abs(travel[2 * reach :] - travel[: -2 * reach])
    still = np.zeros(len(travel) + 2, dtype=bool)
    still[1 + reach : 1 + len(travel) - reach] = rate < 0.05 * np.quantile(rate, 0.95)
    limits = np.flatnonzero(np.diff(still.astype(np.int8)))
    for first, last in limits.reshape(-1, 2):
        if last - first >= period / 20:
            yield int(first), int(last)
