"""Ripple demodulated on the drive: definition and computation of its rows, and reconstruction of waveforms.

Over the samples of `periods` injection periods, least squares of

    i = mean + ripple g(phase) + curvature (g(phase)^2 - s)        v - base = v f(phase)

on each axis of the believed dq frame, the curvature being optional. f is the unit
wave of the injection (peak 1, a period starts at phase 0); g, the unit ripple, is its integral over the
period with zero mean and peak 1, at the phase of the voltage that acts: delayed by voltage_delay_samples;
s is the mean of g^2 over a period. With the drive's sampling f_s, frequency f and discarded samples k_0,
phase(k) = (k_0 + k) f / f_s in periods.

The curvature stems from saturation within the ripple: with i(psi) and psi = psi_0 + a g,
i = i(psi_0) + i' a g + i'' a^2 g^2 / 2 + ...
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
_PHASE_TOLERANCE = 1e-9
"""Distance in periods below a corner within which a phase counts as the corner."""
_MIN_CURVATURE = 0.01
"""Smallest mean square of g^2 orthogonal to 1 and g for a curvature; with few samples a period it is unobservable."""


def unit_wave(phase: Real, waveform: Waveform) -> NDArray[np.float64]:
    """f at a phase: +1 in the first half of a period and -1 in the second, or a sine."""
    if waveform == "sine":
        return np.asarray(np.sin(2.0 * math.pi * phase), dtype=np.float64)
    return np.where(_fraction(phase) < 0.5 - _PHASE_TOLERANCE, 1.0, -1.0)


def unit_ripple(phase: Real, waveform: Waveform) -> NDArray[np.float64]:
    """g at a phase: a triangle with -1 at phase 0 and +1 at 1/2, or minus the cosine."""
    if waveform == "sine":
        return np.asarray(-np.cos(2.0 * math.pi * phase), dtype=np.float64)
    return np.asarray(1.0 - 4.0 * np.abs(_fraction(phase) - 0.5), dtype=np.float64)


def mean_square(waveform: Waveform) -> float:
    """s: the mean of g^2 over a period."""
    return 0.5 if waveform == "sine" else 1.0 / 3.0


def _fraction(phase: Real) -> NDArray[np.float64]:
    return np.asarray(np.maximum(phase - np.floor(phase + _PHASE_TOLERANCE), 0.0), dtype=np.float64)


@dataclass(frozen=True)
class RippleGrid:
    """Assignment of a capture's samples to ripple rows, and the content of a row."""

    sampling_frequency_hz: float
    frequency_hz: float
    waveform: Waveform
    periods: int
    """Injection periods in a row."""
    discarded: int = 0
    """Samples of injection before sample 0 of the capture."""
    delay_samples: float = 0.0
    is_curved: bool = False
    """Whether rows have a curvature."""

    @property
    def columns(self) -> int:
        """Number of values in a row."""
        return 8 if self.is_curved else 6

    @property
    def row_bytes(self) -> int:
        return 2 * self.columns

    def phase(self, samples: Real, delay: float = 0.0) -> NDArray[np.float64]:
        """Phase of the injection at sample numbers, in periods."""
        return np.asarray((self.discarded + samples - delay) * self.frequency_hz / self.sampling_frequency_hz)

    def rows(self, samples: int) -> int:
        """Whole rows in a number of samples; the remainder is not demodulated."""
        return math.floor(samples * self.frequency_hz / self.sampling_frequency_hz / self.periods + _PHASE_TOLERANCE)

    def starts(self, rows: int) -> NDArray[np.int64]:
        """First sample of each row, and the end of the last; shape (rows + 1,)."""
        edges = np.arange(rows + 1) * (self.periods * self.sampling_frequency_hz / self.frequency_hz)
        first = np.ceil(edges - _PHASE_TOLERANCE * self.sampling_frequency_hz / self.frequency_hz)
        return np.asarray(first, dtype=np.int64)


@dataclass(frozen=True)
class RippleRows:
    """Demodulated rows in SI units; each (n, 2): row first, then axis (d, q)."""

    mean: NDArray[np.float64]
    ripple: NDArray[np.float64]
    v: NDArray[np.float64]
    curvature: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.mean)

    def counts(self, scales: Scales) -> NDArray[np.int16]:
        """Shape (n, 6 or 8): mean, ripple, v (and curvature) of d, then of q, in the protocol's counts."""
        each = [self.mean / scales.current_a, self.ripple / scales.ripple_a, self.v / scales.voltage_v]
        if self.curvature is not None:
            each.append(self.curvature / scales.ripple_a)
        table = np.stack(each, -1)
        return np.clip(np.rint(table), -32768, 32767).astype("<i2").reshape(-1, 2 * len(each))

    @classmethod
    def of_counts(cls, counts: NDArray[np.int16], scales: Scales) -> RippleRows:
        """Rows from `counts`."""
        table = counts.reshape(len(counts), 2, counts.shape[1] // 2).astype(np.float64)
        units = (scales.current_a, scales.ripple_a, scales.voltage_v, scales.ripple_a)
        return cls(*(table[:, :, k] * units[k] for k in range(table.shape[2])))


def demodulate(i_dq: Real, v_dq: Real, base_v_dq: tuple[float, float], grid: RippleGrid) -> RippleRows:
    """Rows from samples of a capture, shape (n, 2) each, from its sample 0 on."""
    rows = grid.rows(len(i_dq))
    starts = grid.starts(rows)
    sizes = np.diff(starts)[:, None]
    if rows == 0:
        empty = np.zeros((0, 2))
        return RippleRows(empty, empty, empty, empty if grid.is_curved else None)
    samples = np.arange(float(starts[-1]))
    g = unit_ripple(grid.phase(samples, grid.delay_samples), grid.waveform)[:, None]
    f = unit_wave(grid.phase(samples), grid.waveform)[:, None]

    def total(values: Real) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(values, starts[:-1], axis=0), dtype=np.float64)

    i, v = i_dq[: len(samples)], v_dq[: len(samples)] - np.asarray(base_v_dq)
    sum_g, sum_gg, sum_i, sum_gi = total(g), total(g * g), total(i), total(g * i)
    # Gram-Schmidt on 1, g, g^2.
    norm_g = np.maximum(sum_gg - sum_g * sum_g / sizes, 1e-12)
    ripple = (sum_gi - sum_g * sum_i / sizes) / norm_g
    amplitude_v = total(f * v) / np.maximum(total(f * f), 1e-12)
    if not grid.is_curved:
        return RippleRows((sum_i - ripple * sum_g) / sizes, ripple, amplitude_v)
    mean_gg, projection = sum_gg / sizes, (total(g**3) - sum_gg * sum_g / sizes) / norm_g
    norm_gg = total(g**4) - mean_gg * sum_gg - projection * projection * norm_g
    residual = total(g * g * i) - mean_gg * sum_i - projection * (sum_gi - sum_g * sum_i / sizes)
    curvature = np.where(norm_gg >= _MIN_CURVATURE * sizes, residual / np.maximum(norm_gg, 1e-12), 0.0)
    ripple -= projection * curvature
    mean = (sum_i - ripple * sum_g) / sizes + (mean_square(grid.waveform) - mean_gg) * curvature
    return RippleRows(mean, ripple, amplitude_v, curvature)


def reconstruct(
    rows: RippleRows, base_v_dq: tuple[float, float], grid: RippleGrid, count: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Waveforms i_dq and v_dq, shape (n, 2), at the drive's sampling: the rows' values, linear between centres.

    The result is a model without the noise within a row. `count` samples are returned where a
    capture ends with part of a row (with the last row's values); by default those of whole rows.
    """
    starts = grid.starts(len(rows))
    samples = np.arange(float(starts[-1] if count is None else count))
    centres = 0.5 * (starts[:-1] + starts[1:] - 1)
    g = unit_ripple(grid.phase(samples, grid.delay_samples), grid.waveform)
    f = unit_wave(grid.phase(samples), grid.waveform)

    def interpolate(values: Real, axis: int) -> NDArray[np.float64]:
        return np.asarray(np.interp(samples, centres, values[:, axis]), dtype=np.float64)

    i = [interpolate(rows.mean, axis) + interpolate(rows.ripple, axis) * g for axis in (0, 1)]
    if rows.curvature is not None:
        curvature = g * g - mean_square(grid.waveform)
        i = [i[axis] + interpolate(rows.curvature, axis) * curvature for axis in (0, 1)]
    v = [base_v_dq[axis] + interpolate(rows.v, axis) * f for axis in (0, 1)]
    return np.column_stack(i), np.column_stack(v)
