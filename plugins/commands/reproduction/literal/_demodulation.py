r"""The paper's demodulator as printed, with its misprint corrected, on one capture of injection.

    i_(t) = W int_{t-1/W}^{t} i(s) ds,
    i~(t) =   int_{t-1/W}^{t} [i(s - 1/2W) - i_(s)] F(W s - 1/2) ds  /  int_{t-1/W}^{t} F(W s)^2 ds,

W in Hz and F the zero-mean primitive of the 1-periodic wave f, a triangle for a square (Combes, Malrait, Martin,
Rouchon, "Obtaining the current-flux relations of the saturated PMSM by signal injection", section "Data acquisition
with signal injection"). The paper prints F(W s) and another W before the fraction. But i_ is the mean about s - 1/2W,
so that the bracket is the ripple at that instant, where F has to be taken; half a period later, a square wave's F
changes its sign. i~ is then the factor of F in the current, as the paper's text states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from protocols import Capture, NotMeasuredError, Segment


@dataclass(frozen=True)
class VirtualMeasurement:
    """Mean current and ripple of one capture as signals in time, in a given frame.

    Attributes
    ----------
    time_s : array, shape (n,)
        Time since the start of the capture; the value at t belongs to the instant t - 1/W.
    mean, ripple : array, shape (n, 2)
        i_ and i~ [A].
    swing : array, shape (n, 2)
        The injected vector over W, u~ (cos, sin) / W [Vs]; i~ is the energy's Hessian times this.
    """

    time_s: Array
    mean: Array
    ripple: Array
    swing: Array


def virtual_measurement(segment: Segment, capture: Capture, angle_rad: float) -> VirtualMeasurement:
    """Demodulate a capture by its segment's settings.

    Parameters
    ----------
    segment : Segment
        Segment of stage injection with a square wave.
    capture : Capture
    angle_rad : float
        Angle of the d axis of the result's frame; the injected vector refers to the segment's own angle.

    Raises
    ------
    NotMeasuredError
        Where a period is not an even number of samples, or the capture shorter than three.
    """
    setting = segment.settings
    rate, frequency = capture.sampling_frequency_hz, float(setting["frequency_hz"])
    period = round(rate / frequency)
    if period < 4 or period % 2 or abs(period - rate / frequency) > 1e-9 * period:
        problem = f"{rate / frequency:g} samples a period; the formula as printed needs an even number, four or more"
        raise NotMeasuredError(segment.id, "frequency_hz", problem)
    if len(capture) < 3 * period:
        raise NotMeasuredError(segment.id, "samples", f"{len(capture)} are fewer than three periods of {period}")
    current = to_dq(capture.i_ab, angle_rad)
    row = np.arange(len(capture))
    begun_s = float(setting.get("discard_s", 0.0))
    wave = _triangle(row / period + begun_s * frequency)
    # Row k of each of these is for the instant t = k + period, k + 2 period.
    mean = _window_sums(current, period) / period
    half = period // 2
    ripple = current[half : len(current) - half] - mean
    product = ripple * wave[half : len(current) - half, None]
    power = float(_window_sums(wave[: period + 1, None] ** 2, period)[0, 0])
    middle = row[period : len(current) - period]
    turned = (
        2.0 * np.pi * float(setting["rotation_hz"]) * (middle / rate + begun_s) + segment.rotor_angle_rad - angle_rad
    )
    return VirtualMeasurement(
        time_s=middle / rate,
        mean=mean[half : len(mean) - half],
        ripple=_window_sums(product, period) / power,
        swing=float(setting["amplitude_v"]) / frequency * np.stack([np.cos(turned), np.sin(turned)], axis=1),
    )


def _triangle(phase: Array) -> Array:
    """Zero-mean primitive of the 1-periodic square wave that begins with +1."""
    within = phase % 1.0
    return np.where(within < 0.5, within - 0.25, 0.75 - within)


def _window_sums(x: Array, period: int) -> Array:
    """Integral over the last period by trapezoids, in samples, shape (n - period, k)."""
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0)])
    return np.asarray(total[period:] - total[:-period])


def hessian(measured: Sequence[VirtualMeasurement]) -> Array:
    """H_11, H_12, H_22 of one operating point by least squares, as a matrix, shape (2, 2) [A/Wb].

    From one capture of a rotating vector, or several of fixed vectors.

    Raises
    ------
    NotMeasuredError
        Where all vectors lie along one axis.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for one in measured:
        d, q = one.swing.T
        nil = np.zeros_like(d)
        for columns, ripple in (((d, q, nil), one.ripple[:, 0]), ((nil, d, q), one.ripple[:, 1])):
            rows = np.stack(columns)
            normal += rows @ rows.T
            right += rows @ ripple
    if np.linalg.eigvalsh(normal)[0] < 1e-6 * normal.trace():
        raise NotMeasuredError("injection", "rotation_hz", "all injected vectors lie along one axis")
    h = np.linalg.solve(normal, right)
    return np.array([[h[0], h[1]], [h[1], h[2]]])
