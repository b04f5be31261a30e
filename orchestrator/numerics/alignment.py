"""Delay from the rows of a voltage to their action on the current, from the equation of a winding.

With voltage edges no motor parameter is needed: for any inductance and resistance, the voltage of one or two rows
causes the current's step from one row to the next. For a sine the resistance has to be known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Alignment:
    """Delay from a row's voltage to its action, in rows."""

    lag_rows: float
    """n rows: v[k] acts from t_k + n Ts."""
    explained: float
    """Share of the current's steps that the voltage at this lag explains."""
    by_edges: bool = True
    """False: from the phase of a sine, which iron loss shifts too."""


def alignment_of(
    i_ab: Numbers,
    v_ab: Numbers,
    *,
    earliest: int = -3,
    latest: int = 6,
    max_samples: int = 8_000,
    min_explained: float = 0.5,
    ohm: float | None = None,
) -> Alignment | None:
    """The lag at which the voltage explains the current best; None where it is not identifiable.

    A resistance acts like a lag on a sine, so that it has to be given for a voltage without edges.

    ``i[k+1] - i[k] = g ((1-f) v[k-m] + f v[k-m-1]) - r i[k]``, with n = m + f. For each m, g, f and r follow by least
    squares, and the best m with f > -0.05 is taken; a slightly negative f, due to noise, counts as 0.

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
        Currents and voltages of a segment with injection.
    earliest, latest : int
        Range of m.
    max_samples : int
        Maximum number of samples: about a hundred injection periods.
    min_explained : float
        Minimum share of the current's steps that the voltage has to explain.
    ohm : float, optional
        Resistance of the winding, for a sine: r is then g R_s.
    """
    i, v = (_centred(x[:max_samples]) for x in (i_ab, v_ab))
    inner = slice(latest + 1, i.size + earliest - 1)
    if inner.stop - inner.start < 100:
        return None
    sine = _is_smooth(v)
    if sine and ohm is None:
        return None
    places = np.arange(inner.start, inner.stop)
    steps = i[places + 1] - i[places]
    power = float(np.vdot(steps, steps).real)
    best, best_share = None, min_explained
    for late in range(earliest, latest + 1):
        parts = np.stack([v[places - late], v[places - late - 1], i[places]])
        if sine:
            parts = parts[:2] - (ohm or 0.0) * parts[2]
        gram, along = (parts @ parts.conj().T).real, (parts @ steps.conj()).real
        gains = np.linalg.lstsq(gram, along, rcond=1e-12)[0]
        share = float(gains @ along) / power if power > 0.0 else 0.0
        if share > best_share and gains[0] > 0.0 and gains[1] > -0.05 * gains[0]:
            second, best_share = max(float(gains[1]), 0.0), share
            best = Alignment(late + second / (float(gains[0]) + second), share, not sine)
    return best


def _is_smooth(v: NDArray[np.complex128], pure: float = 0.3, even: float = 0.3) -> bool:
    """Whether the voltage is a sine without edges, apart from what a current controller adds."""
    # A sine satisfies v[k+1] + v[k-1] = 2 cos(w) v[k]. So does a square wave of many rows, nearly; but most of its
    # steps are far smaller than the largest, unlike those of a sine.
    ahead, sides = v[1:-1], v[2:] + v[:-2]
    power = float(np.vdot(ahead, ahead).real)
    if power == 0.0:
        return False
    residual = sides - float(np.vdot(ahead, sides).real) / power * ahead
    steps = np.abs(np.diff(v))
    is_even = float(np.median(steps)) > even * float(np.quantile(steps, 0.99))
    return is_even and float(np.vdot(residual, residual).real) < pure * power


def _centred(x: Numbers) -> NDArray[np.complex128]:
    vectors: NDArray[np.complex128] = x[:, 0] + 1j * x[:, 1]
    vectors -= vectors.mean()
    return vectors
