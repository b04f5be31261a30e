"""Waveforms, thinned out for a screen: of every stretch of 20 ms the least and the greatest; believed dq frame.

The averages that a plot would make of long recordings hide the ripple and the peaks; these pairs keep them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from orchestrator.numerics.frames import to_dq
from plugins.streams.rerun._detail import DETAIL
from plugins.streams.rerun._tape import Entry, scalars
from protocols import Capture, RealArray


def envelope(rows: RealArray, width: int) -> RealArray:
    """Least and greatest in turn of each `width` samples of the rows (m, n): shape (m, 2 ceil(n / width))."""
    starts = np.arange(0, rows.shape[1], width)
    out = np.empty((rows.shape[0], 2 * len(starts)))
    out[:, 0::2] = np.minimum.reduceat(rows, starts, axis=1)
    out[:, 1::2] = np.maximum.reduceat(rows, starts, axis=1)
    return out


class Thinner:
    """Collects thinned waveforms until they are worth a block."""

    def __init__(self, wall_s: Callable[[], float] = time.monotonic) -> None:
        self._wall = wall_s
        self._times: list[RealArray] = []
        self._current: list[RealArray] = []
        self._voltage: list[RealArray] = []
        self._limits_at = -math.inf
        self.rows = 0

    def take(self, capture: Capture, angle_rad: float) -> None:
        """Add a block of waveforms; of a rotor that turns the rows say the angle."""
        n = len(capture)
        if n == 0:
            return
        angle = angle_rad if capture.theta_rad is None else capture.theta_rad
        width = max(1, round(DETAIL.bin_s * capture.sampling_frequency_hz))
        current = envelope(to_dq(capture.i_ab, angle).T, width)
        # The greatest is drawn half a stretch after the least.
        half = 0.5 * min(width, n) / capture.sampling_frequency_hz
        self._times.append(capture.start_s + half * np.arange(current.shape[1]))
        self._current.append(current)
        self._voltage.append(envelope(to_dq(capture.v_ab, angle).T, width))
        self.rows += current.shape[1]

    def give(self, limits: tuple[float, float] | None) -> list[Entry]:
        """All that was collected as blocks, the limits (A, V) beside them now and then, and begin anew."""
        if not self.rows:
            return []
        times = np.concatenate(self._times)
        out = [
            scalars("drive/current", times, np.concatenate(self._current, axis=1).T),
            scalars("drive/voltage", times, np.concatenate(self._voltage, axis=1).T),
        ]
        if limits is not None and self._wall() - self._limits_at >= DETAIL.limits_every_s:
            self._limits_at = self._wall()
            ends = times[[0, -1]]
            for name, limit in zip(("current", "voltage"), limits, strict=True):
                out.append(scalars(f"drive/limit/{name}", ends, np.array([[limit, -limit]] * 2)))
        self._times, self._current, self._voltage, self.rows = [], [], [], 0
        return out
