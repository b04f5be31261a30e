"""Ripple demodulated on the drive: what its rows mean, how they are made, how waveforms come back.

Over the samples of `periods` injection periods, least squares of ``i = mean + ripple g(phase)`` and
``v - base = v f(phase)`` on each axis of the believed dq frame. f is the unit wave of the injection
(peak 1, a period starts at phase 0); g, the unit ripple, is its integral over the period with zero
mean and peak 1, at the phase of the voltage that acts: delayed by voltage_delay_samples. With the
drive's sampling f_s, frequency f and discarded samples k_0, phase(k) = (k_0 + k) f / f_s in periods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from plugins.wire._rows import Scales

Real = NDArray[np.floating[Any]]
Waveform = Literal["square", "sine"]
_ROUNDING = 1e-9
"""A phase this close below a corner counts as the corner."""
RIPPLE_ROW_BYTES = 12


def unit_wave(phase: Real, waveform: Waveform) -> NDArray[np.float64]:
    """f: +1 in the first half of a period and -1 in the second, or a sine."""
    if waveform == "sine":
        return np.asarray(np.sin(2.0 * math.pi * phase), dtype=np.float64)
    return np.where(_fraction(phase) < 0.5 - _ROUNDING, 1.0, -1.0)


def unit_ripple(phase: Real, waveform: Waveform) -> NDArray[np.float64]:
    """g: a triangle from -1 at phase 0 over +1 at 1/2, or minus the cosine."""
    if waveform == "sine":
        return np.asarray(-np.cos(2.0 * math.pi * phase), dtype=np.float64)
    return np.asarray(1.0 - 4.0 * np.abs(_fraction(phase) - 0.5), dtype=np.float64)


def _fraction(phase: Real) -> NDArray[np.float64]:
    return np.asarray(np.maximum(phase - np.floor(phase + _ROUNDING), 0.0), dtype=np.float64)


@dataclass(frozen=True)
class RippleGrid:
    """Which samples of a capture belong to which ripple row."""

    sampling_frequency_hz: float
    frequency_hz: float
    waveform: Waveform
    periods: int
    """Injection periods in a row."""
    discarded: int = 0
    """Samples of injection before sample 0 of the capture."""
    delay_samples: float = 0.0

    def phase(self, samples: Real, delay: float = 0.0) -> NDArray[np.float64]:
        """Phase of the injection at sample numbers, in periods."""
        return np.asarray((self.discarded + samples - delay) * self.frequency_hz / self.sampling_frequency_hz)

    def rows(self, samples: int) -> int:
        """Whole rows in so many samples; the rest is not demodulated."""
        return math.floor(samples * self.frequency_hz / self.sampling_frequency_hz / self.periods + _ROUNDING)

    def starts(self, rows: int) -> NDArray[np.int64]:
        """First sample of each row, and of the one after the last; shape (rows + 1,)."""
        edges = np.arange(rows + 1) * (self.periods * self.sampling_frequency_hz / self.frequency_hz)
        first = np.ceil(edges - _ROUNDING * self.sampling_frequency_hz / self.frequency_hz)
        return np.asarray(first, dtype=np.int64)


@dataclass(frozen=True)
class RippleRows:
    """Demodulated rows in SI units; each (n, 2): row first, then axis (d, q)."""

    mean: NDArray[np.float64]
    ripple: NDArray[np.float64]
    v: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.mean)

    def counts(self, scales: Scales) -> NDArray[np.int16]:
        """Shape (n, 6): mean, ripple and v of d, then of q, as the wire carries them."""
        table = np.stack([self.mean / scales.current_a, self.ripple / scales.ripple_a, self.v / scales.voltage_v], -1)
        return np.clip(np.rint(table), -32768, 32767).astype("<i2").reshape(-1, 6)

    @classmethod
    def of_counts(cls, counts: NDArray[np.int16], scales: Scales) -> RippleRows:
        """Back from `counts`."""
        table = counts.reshape(-1, 2, 3).astype(np.float64)
        return cls(
            table[:, :, 0] * scales.current_a, table[:, :, 1] * scales.ripple_a, table[:, :, 2] * scales.voltage_v
        )

    @classmethod
    def of_bytes(cls, data: bytes | memoryview, scales: Scales) -> RippleRows:
        """From the table of rows as it is read from the drive (12 bytes a row)."""
        return cls.of_counts(np.frombuffer(data, dtype="<i2"), scales)


def demodulate(i_dq: Real, v_dq: Real, base_v_dq: tuple[float, float], grid: RippleGrid) -> RippleRows:
    """Rows from samples of a capture, shape (n, 2) each, from its sample 0 on."""
    rows = grid.rows(len(i_dq))
    starts = grid.starts(rows)
    sizes = np.diff(starts)[:, None]
    if rows == 0:
        empty = np.zeros((0, 2))
        return RippleRows(empty, empty, empty)
    samples = np.arange(float(starts[-1]))
    g = unit_ripple(grid.phase(samples, grid.delay_samples), grid.waveform)[:, None]
    f = unit_wave(grid.phase(samples), grid.waveform)[:, None]

    def total(values: Real) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(values, starts[:-1], axis=0), dtype=np.float64)

    i, v = i_dq[: len(samples)], v_dq[: len(samples)] - np.asarray(base_v_dq)
    sum_g, sum_gg, sum_i, sum_gi = total(g), total(g * g), total(i), total(g * i)
    ripple = (sizes * sum_gi - sum_g * sum_i) / np.maximum(sizes * sum_gg - sum_g * sum_g, 1e-12)
    return RippleRows((sum_i - ripple * sum_g) / sizes, ripple, total(f * v) / np.maximum(total(f * f), 1e-12))


def reconstruct(
    rows: RippleRows, base_v_dq: tuple[float, float], grid: RippleGrid, count: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Waveforms i_dq and v_dq, shape (n, 2), at the drive's sampling: the rows' values, linear between their centres.

    A model of the samples, not the samples: noise finer than a row is gone. `count` samples, where a
    capture ends with part of a row (the last row's values are held); by default those of whole rows.
    """
    starts = grid.starts(len(rows))
    samples = np.arange(float(starts[-1] if count is None else count))
    centres = 0.5 * (starts[:-1] + starts[1:] - 1)
    g = unit_ripple(grid.phase(samples, grid.delay_samples), grid.waveform)
    f = unit_wave(grid.phase(samples), grid.waveform)

    def between(values: Real, axis: int) -> NDArray[np.float64]:
        return np.asarray(np.interp(samples, centres, values[:, axis]), dtype=np.float64)

    i = [between(rows.mean, axis) + between(rows.ripple, axis) * g for axis in (0, 1)]
    v = [base_v_dq[axis] + between(rows.v, axis) * f for axis in (0, 1)]
    return np.column_stack(i), np.column_stack(v)
