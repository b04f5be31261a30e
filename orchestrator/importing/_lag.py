"""How many samples the voltage acts late, told from an injection; a first guess for the mapping, not an estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._source import Numbers

_EARLIEST, _LATEST = -3, 6
_MOST_SAMPLES = 8_000
_LEAST_EXPLAINED = 0.5


def voltage_lag(i_ab: Numbers, v_ab: Numbers) -> float | None:
    """The n of "v[k] acts from t_k + n Ts" that explains the current best; None where nothing can be told.

    Of a winding of any inductance and resistance, ``i[k+1] - i[k] = g ((1-f) v[k-m] + f v[k-m-1]) - r i[k]``, with
    n = m + f. For each m, g, f and r follow by least squares; the m counts that leaves least and has f in [0, 1].

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
        Currents and voltages of a segment with injection.
    """
    i, v = (_centred(x[:_MOST_SAMPLES]) for x in (i_ab, v_ab))
    inner = slice(_LATEST + 1, i.size + _EARLIEST - 1)
    if inner.stop - inner.start < 100:
        return None
    places = np.arange(inner.start, inner.stop)
    steps = i[places + 1] - i[places]
    power = float(np.vdot(steps, steps).real)
    best, least = None, (1.0 - _LEAST_EXPLAINED) * power
    for late in range(_EARLIEST, _LATEST + 1):
        parts = np.stack([v[places - late], v[places - late - 1], i[places]])
        gram, along = (parts @ parts.conj().T).real, (parts @ steps.conj()).real
        gains = np.linalg.lstsq(gram, along, rcond=1e-12)[0]
        left = power - float(gains @ along)
        if left < least and gains[0] > 0.0 and gains[1] > -0.05 * gains[0]:
            best, least = late + max(float(gains[1]), 0.0) / (float(gains[0]) + max(float(gains[1]), 0.0)), left
    return best


def _centred(x: Numbers) -> NDArray[np.complex128]:
    vectors: NDArray[np.complex128] = x[:, 0] + 1j * x[:, 1]
    vectors -= vectors.mean()
    return vectors
