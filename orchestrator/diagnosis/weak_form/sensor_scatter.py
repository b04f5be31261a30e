"""What one segment's raw readings say of the current noise: differences that cancel the current itself. No model."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from orchestrator.diagnosis.nuisances.spectral_lines import spectrum_of
from orchestrator.numerics.types import Array

BLOCK_READINGS = 50
"""Readings, of which some are usual and some are not."""
MAX_POWER_RATIO = 2.0
"""Times the usual power of differences, from which on a block has a current that moves: five sigma of white noise."""
MAX_PERIOD_MISMATCH = 0.05
"""Power of a voltage's differences over one period, as a part of its own, below which it repeats: an injected direction
that turns once in a hundred periods leaves 0.004, and what is drawn at random leaves 2."""
LOCAL_BLOCK_READINGS = 100
"""Differences in a block, over which the inductance hardly changes."""
ARX_LAGS = (1, 2, 3, 4, 5, 7, 10, 16)
"""Samples back at which stretches of voltage end that a difference answers to as one: the last ones each by itself,
earlier ones, to which eddy currents alone still answer, together."""
MAX_CORRELATION_DISAGREEMENT = 0.3
"""By which differences may find readings more alike than differences of these, which see it less well."""


@dataclass(frozen=True)
class Scatter:
    """Second moments of differences of the readings.

    Attributes
    ----------
    covariance : array, shape (2, 2)
        Of the noise of (i_alpha, i_beta) if each reading's were independent [A^2].
    correlation : float
        From each reading to the next, as of a first-order process; NaN where the current's own ripple forbids to look.
    spectrum : array
        `spectrum_of` the readings; empty where something is injected.
    readings : int
        From which the correlation is estimated.
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
        Samples in a period of injected ripple; its repetitions are compared where it is a whole number.
    steady : bool
        The current does not move: then how alike successive readings are shows in their differences, which see a
        correlation four times as well as differences of these do.
    """
    if period is None:
        # Coefficients (1, -2, 1) cancel what is linear in time, and multiply the variance of white noise by six.
        d = i_ab[2:] - 2.0 * i_ab[1:-1] + i_ab[:-2]
        usual = _usual(d)
        alike = _of_second_differences(_lag(d, usual))
        if steady:
            # A hold may begin before its current has settled, or not settle at all: only what both see is noise.
            at_rest = 1.0 + 2.0 * _lag(np.diff(i_ab[len(i_ab) // 4 :], axis=0))
            alike = at_rest if at_rest - alike < MAX_CORRELATION_DISAGREEMENT else alike
        return Scatter(_moments(d, usual, 6.0), alike, spectrum_of(i_ab), len(i_ab))
    p = round(period)
    settled = i_ab[len(i_ab) // 4 :]
    if abs(p - period) > 1e-6 or len(settled) < 6 * p:
        return Scatter(np.full((2, 2), np.nan), float("nan"), np.zeros(0))
    # (1, -3, 3, -1) over periods: the ripple's slow turning cancels too.
    d = settled[3 * p :] - 3.0 * settled[2 * p : -p] + 3.0 * settled[p : -2 * p] - settled[: -3 * p]
    return Scatter(_moments(d, _usual(d), 20.0), float("nan"), np.zeros(0))


def scatter_between(i_ab: Array, v_ab: Array, answered: int = 4) -> Scatter:
    """Scatter of readings under voltage steps, by fourth differences where nothing has turned for some samples.

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
    answered : int
        Samples within which a turn has acted, whatever the delay.
    """
    jumps = np.linalg.norm(np.diff(v_ab, axis=0), axis=1)
    turned = np.flatnonzero(jumps > 0.1 * jumps.max(initial=1e-300))
    quiet = np.ones(len(i_ab) - 4, dtype=np.bool_)
    for k in range(-3, answered + 1):
        near = turned + k
        quiet[near[(near >= 0) & (near < len(quiet))]] = False
    d = np.diff(i_ab, n=4, axis=0)
    if np.count_nonzero(quiet) < 8:
        # A voltage that moves all the time has no edges either.
        return Scatter(_moments(d, _usual(d), 70.0), float("nan"), np.zeros(0))
    d = d[quiet]
    return Scatter(d.T @ d / (70.0 * len(d)), float("nan"), np.zeros(0))


def repeats(v_ab: Array, period: float) -> bool:
    """Whether a voltage repeats itself after a whole number of samples: only then does the current without noise.

    Parameters
    ----------
    v_ab : array, shape (n, 2)
    period : float
        In samples.
    """
    p = round(period)
    if p < 1 or len(v_ab) < 2 * p:
        return False
    moves = v_ab - v_ab.mean(axis=0)
    return float(np.square(moves[p:] - moves[:-p]).mean()) < MAX_PERIOD_MISMATCH * float(np.square(moves).mean())


def scatter_beside_answer(i_ab: Array, v_ab: Array) -> Scatter:
    """Scatter of readings under a voltage that never repeats: what a short local model leaves of their differences.

    In each block the difference from one reading to the next is linear in the last voltages and the current, as an
    inductance, a resistance and eddy currents make it: an ARX model by least squares (L. Ljung, System Identification,
    2nd ed., section 4.2). The voltage must not answer to the readings, or it would explain their noise.

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
    """
    first = ARX_LAGS[-1]
    d = np.diff(i_ab, axis=0)[first:]
    impulse = np.concatenate([np.zeros((1, 2)), np.cumsum(v_ab, axis=0)])
    ends = [np.arange(first, first + len(d)) + 1 - lag for lag in (0, *ARX_LAGS)]
    inputs = [impulse[new] - impulse[old] for new, old in pairwise(ends)]
    x = np.column_stack([*inputs, i_ab[first:-1], np.ones(len(d))])
    blocks = len(d) // LOCAL_BLOCK_READINGS
    if blocks == 0:
        return Scatter(np.full((2, 2), np.nan), float("nan"), np.zeros(0))
    left = np.zeros((2, 2))
    for block in range(blocks):
        rows = slice(block * LOCAL_BLOCK_READINGS, (block + 1) * LOCAL_BLOCK_READINGS)
        q = np.linalg.qr(x[rows])[0]
        rest = d[rows] - q @ (q.T @ d[rows])
        left += rest.T @ rest / (LOCAL_BLOCK_READINGS - q.shape[1])
    # A difference has the noise of two readings.
    return Scatter(left / (2.0 * blocks), float("nan"), np.zeros(0))


def _usual(d: Array) -> npt.NDArray[np.bool_]:
    """Which differences (n, 2) are of blocks with the usual power: where a current steps on, they are not of noise.

    Nor are a block's beside such a one, which a step ends in. All, where that leaves none.
    """
    starts = np.arange(0, len(d), BLOCK_READINGS)
    powers = np.add.reduceat(np.square(d).sum(axis=1), starts) / np.diff(np.append(starts, len(d)))
    moves = np.pad(powers > MAX_POWER_RATIO * np.median(powers), 1)
    usual = np.repeat(~(moves[:-2] | moves[1:-1] | moves[2:]), BLOCK_READINGS)[: len(d)]
    return usual if usual.any() else np.ones(len(d), dtype=np.bool_)


def _moments(d: Array, usual: npt.NDArray[np.bool_], times: float) -> Array:
    """Second moments of the readings' noise, shape (2, 2), by some differences that have it so many times."""
    some = d if usual.all() else d[usual]
    return np.asarray(some.T @ some / (times * len(some)))


def _lag(d: Array, usual: npt.NDArray[np.bool_] | None = None) -> float:
    """First autocorrelation of (some) differences (n, 2); NaN where there are none but zeros."""
    if usual is not None and not usual.all():
        pairs = usual[1:] & usual[:-1]
        power = float(np.square(d[usual]).sum()) * pairs.sum() / usual.sum()
        return float(np.einsum("ij,ij->", d[1:][pairs], d[:-1][pairs])) / power if power > 0.0 else float("nan")
    power = float(np.einsum("ij,ij->", d, d))
    return float(np.einsum("ij,ij->", d[1:], d[:-1])) / power if power > 0.0 else float("nan")


def _of_second_differences(lag: float) -> float:
    """rho of a first-order process whose second differences have this first autocorrelation.

    That is -2/3 where readings are independent, nearer to -1/2 where they are alike.
    """
    if np.isnan(lag):
        return lag
    low, high = -0.98, 0.98
    for _ in range(40):
        middle = 0.5 * (low + high)
        wanted = (-4.0 + 7.0 * middle - 4.0 * middle**2 + middle**3) / (6.0 - 8.0 * middle + 2.0 * middle**2)
        low, high = (middle, high) if wanted < lag else (low, middle)
    return 0.5 * (low + high)
