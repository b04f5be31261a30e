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
        When, since the start of the experiment; for how long.
    i_ab, v_ab : array, shape (2,)
        Mean current [A] and commanded voltage [V].
    v_covariance : array, shape (2, 2)
        Of the mean voltage, from the scatter of eight parts.
    """

    start_s: float
    seconds: float
    i_ab: Array
    v_ab: Array
    v_covariance: Array


def dwell(capture: Capture, first: int = 0, last: int | None = None, delay: float = 0.0) -> Dwell:
    """Means over rows `first` to `last`."""
    last = len(capture) if last is None else last
    # The mean voltage of a steady stretch does not depend on a delay, but for what was commanded before it.
    first = min(first + int(np.ceil(delay)), last - 1)
    i, v = capture.i_ab[first:last], capture.v_ab[first:last]
    parts = np.array([_mean(part) for part in np.array_split(v, min(8, len(v)))])
    off = parts - parts.mean(axis=0)
    rate = capture.sampling_frequency_hz
    return Dwell(
        start_s=capture.start_s + first / rate,
        seconds=len(v) / rate,
        i_ab=_mean(i),
        v_ab=parts.mean(axis=0),
        v_covariance=off.T @ off / max(len(parts) - 1, 1) / len(parts),
    )


def _mean(x: NDArray[np.floating[Any]]) -> Array:
    """Mean vector; as complex numbers, whose sum numpy takes many times faster than that of short rows."""
    kind = (np.float32, np.complex64) if x.dtype == np.float32 else (np.float64, np.complex128)
    vectors = np.ascontiguousarray(x, dtype=kind[0]).view(kind[1])
    mean: Array = (vectors.sum(axis=0, dtype=np.complex128) / len(x)).view(np.float64)
    return mean


def rests(travel: Array, period: float) -> Iterator[tuple[int, int]]:
    """Ranges [first, last) over which a travelled coordinate stands still, in a motion of the given period.

    Still is where, over a twenty-fifth of a period, it moves by less than a twentieth of what it moves at its fastest.
    """
    reach = max(1, round(period / 50))
    if len(travel) <= 4 * reach:
        return
    rate = np.abs(travel[2 * reach :] - travel[: -2 * reach])
    still = np.zeros(len(travel) + 2, dtype=bool)
    still[1 + reach : 1 + len(travel) - reach] = rate < 0.05 * np.quantile(rate, 0.95)
    turns = np.flatnonzero(np.diff(still.astype(np.int8)))
    for first, last in turns.reshape(-1, 2):
        if last - first >= period / 20:
            yield int(first), int(last)
