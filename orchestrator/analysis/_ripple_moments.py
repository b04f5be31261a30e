"""One pass over the waveforms for demodulation: moments of ripple features, window by window.

P and Q are the integrals over time of the voltage's and the current's ripple. `_ripple_regression` fits the derivatives
of the energy to the moments.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from orchestrator.analysis._phase_loss import NO_LOSS, PhaseLoss
from orchestrator.analysis._phase_loss_kernels import take_out
from orchestrator.numerics.kernels import Samples, dq_of, for_kernels
from orchestrator.numerics.types import Array

_NONE = np.zeros((2, 2))


@dataclass(frozen=True)
class Moments:
    """Sums over all windows of one capture.

    Attributes
    ----------
    normal : array, shape (13, 13)
        Products of the eleven features and the two currents, each without its mean and ramp in a window.
    mean_squares : array, shape (3,)
        Means of x_d^2, x_d x_q, x_q^2 of the flux x = P - R Q from the centre.
    mean_i, mean_v2 : array of shape (2,), float
        Mean current; mean square of the voltage's ripple.
    mean_i_rms : array, shape (2,)
        rms of the windows' mean currents about the mean of all.
    samples, windows : int
    """

    normal: Array
    mean_squares: Array
    mean_i: Array
    mean_v2: float
    mean_i_rms: Array
    samples: int
    windows: int


def pooled(captures: Sequence[Moments]) -> Moments:
    """The moments of several captures of one operating point as of one."""
    samples, windows = sum(m.samples for m in captures), sum(m.windows for m in captures)

    def mean(values: Sequence[Array]) -> Array:
        return np.asarray(sum(m.windows / windows * x for m, x in zip(captures, values, strict=True)))

    mean_i = mean([m.mean_i for m in captures])
    return Moments(
        normal=np.sum([m.normal for m in captures], axis=0),
        mean_squares=mean([m.mean_squares for m in captures]),
        mean_i=mean_i,
        mean_v2=float(mean([np.array(m.mean_v2) for m in captures])),
        mean_i_rms=np.sqrt(mean([m.mean_i_rms**2 + (m.mean_i - mean_i) ** 2 for m in captures])),
        samples=samples,
        windows=windows,
    )


def ripple_moments(
    i_ab: Samples,
    v_ab: Samples,
    *,
    sampling_s: float,
    angle_rad: float,
    delay: float,
    first: int,
    width: int,
    drop_ohm: Array = _NONE,
    centre_i: Array = _NONE[0],
    inductance_h: Array = _NONE,
    loss: PhaseLoss = NO_LOSS,
    decaying_i_ab: Samples | None = None,
) -> Moments:
    """Accumulate the moments in the frame at `angle_rad`, from row `first` on, in windows of `width` samples.

    v[k] acts from t_k + delay Ts on; `first` must not be less than `delay`. `drop_ohm`, shape (2, 2), is R of the
    flux ripple whose products are taken. These are of the flux from its value at the current `centre_i`, which in a
    window is the ripple plus `inductance_h`, shape (2, 2), times the deviation of the window's mean current. `loss` is
    subtracted from the voltage first. Q is the primitive of `decaying_i_ab`, by default of the current as measured.
    """
    whole = math.floor(delay)
    windows = (len(i_ab) - first) // width
    i, v = for_kernels(i_ab, v_ab)
    decaying = i if decaying_i_ab is None else for_kernels(decaying_i_ab)[0]
    frame = (math.cos(angle_rad), math.sin(angle_rad))
    lag = (whole, float(delay - whole))
    inverter = (loss.knots_a, loss.error_v, loss.areas)
    around = (drop_ohm, centre_i, inductance_h)
    normal, squares, mean_i, square_i, v2 = _accumulate(
        i, decaying, v, sampling_s, frame, lag, around, inverter, first, width, windows
    )
    samples = windows * width
    mean_i /= windows
    moved = np.sqrt(np.maximum(square_i / windows - mean_i**2, 0.0))
    return Moments(normal, squares / samples, mean_i, v2 / samples, moved, samples, windows)


@njit(cache=True, nogil=True, fastmath=True)
def _accumulate(
    i_ab: Samples,
    decaying_i_ab: Samples,
    v_ab: Samples,
    sampling_s: float,
    frame: tuple[float, float],
    delay: tuple[int, float],
    around: tuple[Array, Array, Array],
    loss: tuple[Array, Array, Array],
    first: int,
    width: int,
    windows: int,
) -> tuple[Array, Array, Array, Array, float]:
    normal = np.zeros((13, 13))
    squares, mean_i, square_i, v2 = np.zeros(3), np.zeros(2), np.zeros(2), 0.0
    drop_ohm, centre, inductance = around
    off, place = np.zeros(2), np.zeros(2)
    # One row per feature: P (2), Q (2), products of second (3) and third order (4) of the flux ripple P - R Q; then the
    # two currents, and a ramp. So the loops below run along the samples.
    z = np.empty((14, width))
    ramp = 13
    for k in range(width):
        z[ramp, k] = k - 0.5 * (width - 1)
    tt = width * (width * width - 1) / 12.0
    v, decaying = np.empty((2, width)), np.empty((2, width))
    product, level = np.empty((14, 14)), np.zeros(13)
    for window in range(windows):
        _rotate_window(i_ab, v_ab, frame, delay, first + window * width, z[11:13], v)
        for k in range(width):
            row = first + window * width + k
            alpha, beta = np.float64(decaying_i_ab[row, 0]), np.float64(decaying_i_ab[row, 1])
            decaying[0, k], decaying[1, k] = dq_of(alpha, beta, frame[0], frame[1])
        if len(loss[0]):
            take_out(i_ab, first + window * width, frame, loss[0], loss[1], loss[2], v)
        for axis in range(2):
            i_mean = _take_out_mean(z, 11 + axis)
            mean_i[axis] += i_mean
            square_i[axis] += i_mean * i_mean
            off[axis] = i_mean - centre[axis]
            _take_out_mean(v, axis)
            _take_out_mean(decaying, axis)
            v2 += _times(v, axis, v, axis, z, axis)
        for axis in range(2):
            place[axis] = inductance[axis, 0] * off[0] + inductance[axis, 1] * off[1]
        _fill_features(z, v, decaying, drop_ohm, place, sampling_s, level)
        _multiply(z, product)
        for a in range(13):
            along, up = level[a] / width, product[ramp, a] / tt
            for b in range(a + 1):
                normal[a, b] += product[a, b] - along * level[b] - up * product[ramp, b]
        for a in range(3):
            squares[a] += level[4 + a]
    for a in range(13):
        for b in range(a):
            normal[b, a] = normal[a, b]
    return normal, squares, mean_i, square_i, v2


@njit(cache=True, nogil=True, fastmath=True)
def _rotate_window(
    i_ab: Samples, v_ab: Samples, frame: tuple[float, float], delay: tuple[int, float], start: int, i: Array, v: Array
) -> None:
    """Current, and the voltage that acts, of one window in the dq frame: rows d, q."""
    cos, sin = frame
    whole, part = delay
    for k in range(v.shape[1]):
        row = start + k
        a, b = np.float64(i_ab[row, 0]), np.float64(i_ab[row, 1])
        i[0, k], i[1, k] = dq_of(a, b, cos, sin)
        a, b = np.float64(v_ab[row - whole, 0]), np.float64(v_ab[row - whole, 1])
        if part > 0.0:
            a += part * (v_ab[row - whole - 1, 0] - a)
            b += part * (v_ab[row - whole - 1, 1] - b)
        v[0, k], v[1, k] = dq_of(a, b, cos, sin)


@njit(cache=True, nogil=True, fastmath=True)
def _fill_features(
    z: Array, v: Array, decaying: Array, drop_ohm: Array, place: Array, sampling_s: float, level: Array
) -> None:
    """Rows 0 to 10 of z from zero-mean voltage v and current `decaying`; `level` gets the sums of rows with a mean."""
    p_d, p_q, q_d, q_q = 0.0, 0.0, 0.0, 0.0
    for k in range(v.shape[1]):
        z[0, k], z[1, k] = p_d, p_q
        p_d += sampling_s * v[0, k]
        p_q += sampling_s * v[1, k]
        z[2, k] = q_d + 0.5 * sampling_s * decaying[0, k]
        z[3, k] = q_q + 0.5 * sampling_s * decaying[1, k]
        q_d += sampling_s * decaying[0, k]
        q_q += sampling_s * decaying[1, k]
    for row in range(4):
        _take_out_mean(z, row)
    # From here on the rows of v hold the flux from the centre.
    for k in range(v.shape[1]):
        v[0, k] = place[0] + z[0, k] - drop_ohm[0, 0] * z[2, k] - drop_ohm[0, 1] * z[3, k]
        v[1, k] = place[1] + z[1, k] - drop_ohm[1, 0] * z[2, k] - drop_ohm[1, 1] * z[3, k]
    for row, a, b in ((4, 0, 0), (5, 0, 1), (6, 1, 1)):
        level[row] = _times(v, a, v, b, z, row)
    for row, a, b in ((7, 4, 0), (8, 4, 1), (9, 6, 0), (10, 6, 1)):
        level[row] = _times(z, a, v, b, z, row)


@njit(cache=True, nogil=True, fastmath=True)
def _take_out_mean(x: Array, row: int) -> float:
    """Subtract a row's mean, which is returned; a loop, since numba takes seconds to compile the numpy call."""
    total = 0.0
    for k in range(x.shape[1]):
        total += x[row, k]
    mean: float = total / x.shape[1]
    for k in range(x.shape[1]):
        x[row, k] -= mean
    return mean


@njit(cache=True, nogil=True, fastmath=True)
def _times(x: Array, a: int, y: Array, b: int, z: Array, out: int) -> float:
    """Row `out` of z becomes the product of two others, whose sum is returned; the plain loop is vectorised."""
    total = 0.0
    for k in range(x.shape[1]):
        product = x[a, k] * y[b, k]
        z[out, k] = product
        total += product
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _multiply(z: Array, product: Array) -> None:
    """Lower triangle of z z^T, two rows by two at a time, so that each load is used twice."""
    for a in range(0, z.shape[0], 2):
        for b in range(0, a + 1, 2):
            s00, s01, s10, s11 = 0.0, 0.0, 0.0, 0.0
            for k in range(z.shape[1]):
                s00 += z[a, k] * z[b, k]
                s01 += z[a, k] * z[b + 1, k]
                s10 += z[a + 1, k] * z[b, k]
                s11 += z[a + 1, k] * z[b + 1, k]
            product[a, b], product[a, b + 1], product[a + 1, b], product[a + 1, b + 1] = s00, s01, s10, s11
