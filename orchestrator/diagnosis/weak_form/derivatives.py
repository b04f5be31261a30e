"""Matrix B of the weak form: its derivatives by the co-energy's coefficients.

Within a cell of the map each spline is a polynomial, so that sums of grad B(i) over samples follow from moments, the
sums of t_d^m t_q^n with m and n up to five: exact, and far cheaper than the splines at each sample. Beyond the map the
gradient continues linearly; beyond a corner the product of tangents has a bilinear term that the map itself has not.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.types import Array


@njit(cache=True, nogil=True)
def sum_basis(
    i_dq: Array,
    delta: Array,
    step: float,
    test_functions: int,
    bins: NDArray[np.int64],
    n_bins: int,
    numbers: Array,
    counts: NDArray[np.int64],
    pieces: Array,
    kinked: Array,
    overlap: float = 0.08,
) -> Array:
    """Weighted sums of -(psi_{k+1} - psi_k) per coefficient, shape (test_functions, n_bins, 2, coefficients).

    Parameters
    ----------
    i_dq : array, shape (n, 2)
        Magnetising current in the true rotor frame [A].
    delta : array, shape (n,) or (0,)
        True minus believed angle, by which the flux is rotated into the believed frame [rad]; empty: zero.
    step, bins
        As in `Windows`.
    numbers, counts, pieces, kinked
        `EvenSpline.layout` of the map, `tensor_spline.CARDINAL`, and `EvenSpline.kinked`.
    overlap : float
        Distance in cells for which a polynomial is used beyond its cell; the gradient's error is its fourth power. Not
        across a kink, where it would be its square.
    """
    n = i_dq.shape[0]
    nq = _functions_along_q(counts, kinked)
    # Without a kink no position is beyond it.
    middle = counts[1] // 2 if kinked.shape[0] else -(10**9)
    out = np.zeros((test_functions, n_bins, 2, (counts[0] + 5) * nq))
    where = np.zeros((n_bins, 2), dtype=np.int64)
    # Moments of the powers; where the angle varies, times its cosine and times its sine.
    turns = delta.shape[0] > 0
    moments = np.zeros((n_bins, 2, 2, 6, 6))
    pending = np.zeros(n_bins, dtype=np.bool_)
    cos_now, sin_now, cos_after, sin_after = 1.0, 0.0, 1.0, 0.0
    now = np.empty((2, 6))
    after = np.empty((2, 6))
    last_bin = -1
    interval = math.floor(0.5 / step)
    for k in range(n - 1):
        place = (k + 0.5) / step
        functions_before = math.floor(place)
        if functions_before != interval:
            for b in range(n_bins):
                if pending[b]:
                    _accumulate(
                        out, interval, b, test_functions, where[b], moments[b], turns, numbers, counts, pieces, kinked
                    )
                    pending[b] = False
            interval = functions_before
        b = bins[k]
        u0 = (i_dq[k, 0] - numbers[0]) / numbers[1]
        v0 = (i_dq[k, 1] - numbers[2]) / numbers[3]
        u1 = (i_dq[k + 1, 0] - numbers[0]) / numbers[1]
        v1 = (i_dq[k + 1, 1] - numbers[2]) / numbers[3]
        fresh = not pending[b]
        inside = _within(u0, u1, where[b, 0], counts[0], overlap, -1)
        inside = inside and _within(v0, v1, where[b, 1], counts[1], overlap, middle)
        w1 = place - functions_before
        w0 = 1.0 - w1
        if turns:
            cos_now, sin_now = math.cos(delta[k]), math.sin(delta[k])
            cos_after, sin_after = math.cos(delta[k + 1]), math.sin(delta[k + 1])
        # Across a kink each end has its own polynomial: the start's is added first, alone.
        crosses = (v0 < middle) != (v1 < middle)
        if pending[b] and (crosses or not inside):
            _accumulate(out, interval, b, test_functions, where[b], moments[b], turns, numbers, counts, pieces, kinked)
            fresh = True
        if crosses:
            _powers_in_cell(u0, v0, where[b], counts, now)
            _add_powers(moments[b], now, -w0, -w1, cos_now, sin_now, turns)
            _accumulate(out, interval, b, test_functions, where[b], moments[b], turns, numbers, counts, pieces, kinked)
            _powers_in_cell(u1, v1, where[b], counts, after)
            _add_powers(moments[b], after, w0, w1, cos_after, sin_after, turns)
            pending[b], last_bin = True, b
            now, after = after, now
            continue
        if fresh:
            where[b, 0] = min(max(math.floor(0.5 * (u0 + u1)), 0), counts[0] - 1)
            where[b, 1] = min(max(math.floor(0.5 * (v0 + v1)), 0), counts[1] - 1)
            pending[b] = True
        # In the same cell, the powers at the end of the last interval are those at the start of this one.
        if fresh or b != last_bin:
            _powers(u0, where[b, 0], counts[0], now[0])
            _powers(v0, where[b, 1], counts[1], now[1])
        _powers(u1, where[b, 0], counts[0], after[0])
        _powers(v1, where[b, 1], counts[1], after[1])
        last_bin = b
        for m in range(6):
            for j in range(6):
                x, y = now[0, m] * now[1, j], after[0, m] * after[1, j]
                z = cos_after * y - cos_now * x
                moments[b, 0, 0, m, j] += w0 * z
                moments[b, 1, 0, m, j] += w1 * z
                if turns:
                    z = sin_after * y - sin_now * x
                    moments[b, 0, 1, m, j] += w0 * z
                    moments[b, 1, 1, m, j] += w1 * z
        now, after = after, now
    for b in range(n_bins):
        if pending[b]:
            _accumulate(out, interval, b, test_functions, where[b], moments[b], turns, numbers, counts, pieces, kinked)
    return out


@njit(cache=True, nogil=True, inline="always")
def _functions_along_q(counts: NDArray[np.int64], kinked: Array) -> int:
    """Even functions of the second variable, that with the kink included."""
    return int((counts.shape[0] - 2 + 1) // 2 + (1 if kinked.shape[0] > 0 else 0))


@njit(cache=True, nogil=True, inline="always")
def _within(x0: float, x1: float, cell: int, cells: int, overlap: float, kink: int) -> bool:
    """Whether an interval's ends lie in a cell, or near it where no kink lies between."""
    low = 0.0 if cell == kink else (-overlap if cell > 0 else -1e9)
    high = 1.0 if cell == kink - 1 else (1.0 + overlap if cell < cells - 1 else 1e9)
    return low <= x0 - cell <= high and low <= x1 - cell <= high


@njit(cache=True, nogil=True, inline="always")
def _powers(u: float, cell: int, cells: int, out: Array) -> None:
    """1, t, ... t^5 of a position within a cell; beyond the map, their tangents at its edge."""
    t = min(max(u, 0.0), float(cells)) - cell
    beyond = u - cell - t
    power = 1.0
    out[0] = 1.0
    for p in range(1, 6):
        out[p] = power * (t + p * beyond)
        power *= t


@njit(cache=True, nogil=True)
def _powers_in_cell(u: float, v: float, cell: NDArray[np.int64], counts: NDArray[np.int64], out: Array) -> None:
    """Write the cell of a position, and the powers of the place in it."""
    cell[0] = min(max(math.floor(u), 0), counts[0] - 1)
    cell[1] = min(max(math.floor(v), 0), counts[1] - 1)
    _powers(u, cell[0], counts[0], out[0])
    _powers(v, cell[1], counts[1], out[1])


@njit(cache=True, nogil=True)
def _add_powers(moments: Array, powers: Array, w0: float, w1: float, cos: float, sin: float, turns: bool) -> None:
    """Add the powers of one end of an interval to the moments of both test functions."""
    for m in range(6):
        for j in range(6):
            x = powers[0, m] * powers[1, j]
            moments[0, 0, m, j] += w0 * cos * x
            moments[1, 0, m, j] += w1 * cos * x
            if turns:
                moments[0, 1, m, j] += w0 * sin * x
                moments[1, 1, m, j] += w1 * sin * x


@njit(cache=True, nogil=True)
def _accumulate(
    out: Array,
    interval: int,
    slot: int,
    test_functions: int,
    cell: NDArray[np.int64],
    moments: Array,
    turns: bool,
    numbers: Array,
    counts: NDArray[np.int64],
    pieces: Array,
    kinked: Array,
) -> None:
    """Add the moments of one bin to the test functions on both sides of an interval between peaks, and clear them."""
    nq = _functions_along_q(counts, kinked)
    with_kink = 0
    if kinked.shape[0] > 0:
        for p in range(6):
            if kinked[cell[1], p] != 0.0:
                with_kink = 1
    plain = np.empty(6)
    slope = np.empty(6)
    for side in range(2):
        function = interval - 1 + side
        # The cosine part of the flux stays on its axis, the sine part goes to the other.
        for part in range(2 if turns else 1):
            m = moments[side, part]
            for r in range(6 if 0 <= function < test_functions else 0):
                # Sums over the powers of t_d first, of the splines and of their derivatives.
                for j in range(6):
                    plain[j] = 0.0
                    slope[j] = 0.0
                    for a in range(6):
                        plain[j] += pieces[r, a] * m[a, j]
                    for a in range(1, 6):
                        slope[j] += pieces[r, a] * a * m[a - 1, j]
                for s in range(6 + with_kink):
                    along_q = pieces[s] if s < 6 else kinked[cell[1]]
                    d = 0.0
                    q = 0.0
                    for j in range(6):
                        d += along_q[j] * slope[j]
                    for j in range(1, 6):
                        q += along_q[j] * j * plain[j - 1]
                    d /= numbers[1]
                    q /= numbers[3]
                    col = (cell[0] + r) * nq + (counts[2 + cell[1] + s] if s < 6 else nq - 1)
                    out[function, slot, part, col] -= d
                    out[function, slot, 1 - part, col] -= q if part == 0 else -q
            for a in range(6):
                for j in range(6):
                    m[a, j] = 0.0
