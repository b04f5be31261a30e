"""Current noise of one segment from its raw readings, by differences that cancel the current itself."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from orchestrator.diagnosis.nuisances.spectral_lines import spectrum_of
from orchestrator.numerics.types import Array

BLOCK_READINGS = 50
"""Readings in a block of which the power of differences is compared with the usual one."""
MAX_POWER_RATIO = 2.0
"""Ratio to the usual power of differences from which a block has a moving current: five sigma of white noise."""
MAX_RESPONSE_SAMPLES = 4
"""Samples after a voltage step within which its response may begin, for any delay."""
MAX_PERIOD_MISMATCH = 0.05
"""Power of a voltage's differences over one period, relative to its own, below which it is periodic: an injected
direction that turns once in a hundred periods has 0.004, a random voltage 2."""
LOCAL_BLOCK_READINGS = 100
"""Differences in a block over which the inductance is nearly constant."""
ARX_LAGS = (1, 2, 3, 4, 5, 7, 10, 16)
"""Lags [samples] at which the regressors of the local model end: single recent voltages, then sums of earlier ones,
to which only eddy currents still respond."""
MAX_CORRELATION_DISAGREEMENT = 0.3
"""Excess of the correlation by first differences over that by second differences up to which it is trusted."""


@dataclass(frozen=True)
class Scatter:
    """Second moments of differences of the readings.

    Attributes
    ----------
    covariance : array, shape (2, 2)
        Covariance of the noise of (i_alpha, i_beta), assuming independent readings [A^2].
    correlation : float
        Correlation of successive readings as a first-order process; NaN where ripple prevents an estimate.
    spectrum : array
        `spectrum_of` the readings; empty under injection.
    readings : int
        Number of readings behind the correlation.
    """

    covariance: Array
    correlation: float
    spectrum: Array
    readings: int = 0


def scatter_of(i_ab: Array, period: float | None, *, steady: bool = False) -> Scatter:
    """Scatter of a segment's readings.

    Parameters
    ----------
    i_ab : array, shape (n, 2)
    period : float, optional
        Samples in a period of injected ripple; periods are compared where it is a whole number.
    steady : bool
        Whether the current is constant: the correlation is then estimated from first differences, which are four times
        as sensitive to it as second differences.
    """
    if period is None:
        # Coefficients (1, -2, 1) cancel a linear trend and multiply the variance of white noise by six.
        d = i_ab[2:] - 2.0 * i_ab[1:-1] + i_ab[:-2]
        usual = _usual(d)
        correlation = _of_second_differences(_lag(d, usual))
        if steady:
            # A hold's current may still settle, which first differences take for correlation.
            at_rest = 1.0 + 2.0 * _lag(np.diff(i_ab[len(i_ab) // 4 :], axis=0))
            correlation = at_rest if at_rest - correlation < MAX_CORRELATION_DISAGREEMENT else correlation
        return Scatter(_moments(d, usual, 6.0), correlation, spectrum_of(i_ab), len(i_ab))
    p = round(period)
    settled = i_ab[len(i_ab) // 4 :]
    if abs(p - period) > 1e-6 or len(settled) < 6 * p:
        return Scatter(np.full((2, 2), np.nan), float("nan"), np.zeros(0))
    # Coefficients (1, -3, 3, -1) over periods also cancel the ripple's slow rotation.
    d = settled[3 * p :] - 3.0 * settled[2 * p : -p] + 3.0 * settled[p : -2 * p] - settled[: -3 * p]
    return Scatter(_moments(d, _usual(d), 20.0), float("nan"), np.zeros(0))


def scatter_between(i_ab: Array, v_ab: Array) -> Scatter:
    """Scatter of readings (n, 2) under voltage steps (n, 2), from fourth differences well after each step."""
    jumps = np.linalg.norm(np.diff(v_ab, axis=0), axis=1)
    turned = np.flatnonzero(jumps > 0.1 * jumps.max(initial=1e-300))
    quiet = np.ones(len(i_ab) - 4, dtype=np.bool_)
    for k in range(-3, MAX_RESPONSE_SAMPLES + 1):
        near = turned + k
        quiet[near[(near >= 0) & (near < len(quiet))]] = False
    d = np.diff(i_ab, n=4, axis=0)
    if np.count_nonzero(quiet) < 8:
        # A continuously varying voltage leaves no quiet samples.
        return Scatter(_moments(d, _usual(d), 70.0), float("nan"), np.zeros(0))
    d = d[quiet]
    return Scatter(d.T @ d / (70.0 * len(d)), float("nan"), np.zeros(0))


def repeats(v_ab: Array, period: float) -> bool:
    """Whether a voltage is periodic with a whole number of samples, as then the noise-free current is.

    Parameters
    ----------
    v_ab : array, shape (n, 2)
    period : float
        Period in samples.
    """
    p = round(period)
    if p < 1 or len(v_ab) < 2 * p:
        return False
    moves = v_ab - v_ab.mean(axis=0)
    return float(np.square(moves[p:] - moves[:-p]).mean()) < MAX_PERIOD_MISMATCH * float(np.square(moves).mean())


def scatter_beside_answer(i_ab: Array, v_ab: Array) -> Scatter:
    """Scatter of readings under an aperiodic voltage: the residual of a local ARX model of their differences.

    In each block the difference of successive readings is linear in recent voltages and an earlier current, by
    inductance, resistance and eddy currents (least squares; L. Ljung, System Identification, 2nd ed., section 4.2).
    Neither may share the difference's noise, or they would explain it: the current is the mean of earlier readings, and
    the voltage must not be controlled by the readings.

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
    """
    first = ARX_LAGS[-1]
    d = np.diff(i_ab, axis=0)[first:]
    impulse = np.concatenate([np.zeros((1, 2)), np.cumsum(v_ab, axis=0)])
    ends = [np.arange(first, first + len(d)) + 1 - lag for lag in (0, *ARX_LAGS)]
    inputs = [impulse[new] - impulse[old] for new, old in pairwise(ends)]
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(i_ab, axis=0)])
    earlier = (total[first : first + len(d)] - total[: len(d)]) / first
    x = np.column_stack([*inputs, earlier, np.ones(len(d))])
    blocks = len(d) // LOCAL_BLOCK_READINGS
    if blocks == 0:
        return Scatter(np.full((2, 2), np.nan), float("nan"), np.zeros(0))
    covariance = np.zeros((2, 2))
    for block in range(blocks):
        rows = slice(block * LOCAL_BLOCK_READINGS, (block + 1) * LOCAL_BLOCK_READINGS)
        q = np.linalg.qr(x[rows])[0]
        rest = d[rows] - q @ (q.T @ d[rows])
        covariance += rest.T @ rest / (LOCAL_BLOCK_READINGS - q.shape[1])
    # A difference has the noise of two readings.
    return Scatter(covariance / (2.0 * blocks), float("nan"), np.zeros(0))


def _usual(d: Array) -> npt.NDArray[np.bool_]:
    """Mask of the differences (n, 2) in blocks without a moving current, by their power and their neighbours'."""
    # A step may extend into neighbouring blocks. All are used where none would remain.
    starts = np.arange(0, len(d), BLOCK_READINGS)
    powers = np.add.reduceat(np.square(d).sum(axis=1), starts) / np.diff(np.append(starts, len(d)))
    moves = np.pad(powers > MAX_POWER_RATIO * np.median(powers), 1)
    usual = np.repeat(~(moves[:-2] | moves[1:-1] | moves[2:]), BLOCK_READINGS)[: len(d)]
    return usual if usual.any() else np.ones(len(d), dtype=np.bool_)


def _moments(d: Array, usual: npt.NDArray[np.bool_], times: float) -> Array:
    """Second moments of the readings' noise, shape (2, 2), from differences with `times` the variance."""
    some = d if usual.all() else d[usual]
    return np.asarray(some.T @ some / (times * len(some)))


def _lag(d: Array, usual: npt.NDArray[np.bool_] | None = None) -> float:
    """First autocorrelation of (selected) differences (n, 2); NaN where all are zero."""
    if usual is not None and not usual.all():
        pairs = usual[1:] & usual[:-1]
        power = float(np.square(d[usual]).sum()) * pairs.sum() / usual.sum()
        return float(np.einsum("ij,ij->", d[1:][pairs], d[:-1][pairs])) / power if power > 0.0 else float("nan")
    power = float(np.einsum("ij,ij->", d, d))
    return float(np.einsum("ij,ij->", d[1:], d[:-1])) / power if power > 0.0 else float("nan")


def _of_second_differences(lag: float) -> float:
    """rho of a first-order process whose second differences have this first autocorrelation."""
    # It is -2/3 for independent readings, and approaches -1/2 for correlated ones.
    if np.isnan(lag):
        return lag
    low, high = -0.98, 0.98
    for _ in range(40):
        middle = 0.5 * (low + high)
        wanted = (-4.0 + 7.0 * middle - 4.0 * middle**2 + middle**3) / (6.0 - 8.0 * middle + 2.0 * middle**2)
        low, high = (middle, high) if wanted < lag else (low, middle)
    return 0.5 * (low + high)
