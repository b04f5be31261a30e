"""Hysteresis as a vector Preisach model: relays along several directions, each set with its own memory of extremes.

Along each direction e_k a Preisach operator P of x = psi . e_k lags behind its anhysteretic curve A, and the iron holds

    i_h = w sum_k e_k (A(x_k) - P(x_k)),

which takes the work of every closed loop, since P runs counter-clockwise. P goes by its Everett function E, the
integral of the relays' density over the triangle between two extremes. The density is the Preisach-Neel product of a
distribution of coercivities and one of interaction fields; it makes minor loops that no sum of stops has.
Sources: I. D. Mayergoyz, IEEE Trans. Magn. 22 (1986) 603, doi:10.1109/TMAG.1986.1064347; I. D. Mayergoyz, G. Friedman,
J. Appl. Phys. 61 (1987) 4022, doi:10.1063/1.338570.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tests.blind.foreign.iron import Array

DIRECTIONS = 5
DEPTH = 48
"""Extremes that are remembered; beyond them the smallest loop is forgotten."""
NODES = 401
COSINES = np.cos(np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
SINES = np.sin(np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
(NOW, VALUE, WAY, COUNT, FIRST) = (0, 1, 2, 3, 4)
"""A direction's memory: x, P there, the way it goes, the number of extremes; then pairs of extremes and P there."""
ROW = FIRST + 2 * (DEPTH + 2)


def everett(coercivity: float, spread: float, interaction: float) -> Array:
    """E(a, b) of a Preisach-Neel density on a grid of a and b over [-1, 1], shape (`NODES`, `NODES`).

    Parameters
    ----------
    coercivity, spread : float
        Median half width of the relays, in units of the largest flux, and standard deviation of its logarithm.
    interaction : float
        Standard deviation of the relays' centres.
    """
    edge = np.linspace(-1.0, 1.0, NODES)
    middle = 0.5 * (edge[1:] + edge[:-1])
    up, down = np.meshgrid(middle, middle, indexing="ij")
    half = np.maximum(0.5 * (up - down), 1e-9)
    density = np.exp(-0.5 * (np.log(half / coercivity) / spread) ** 2) / half
    density *= np.exp(-0.5 * (0.5 * (up + down) / interaction) ** 2) * (up > down)
    density += 0.5 * np.diag(np.diag(density))
    # Summed over up below a and down above b.
    whole = np.zeros((NODES, NODES))
    whole[1:, :-1] = np.cumsum(np.cumsum(density, axis=0)[:, ::-1], axis=1)[:, ::-1]
    return np.ascontiguousarray((whole + np.triu(whole.T, 1)) * (edge[1] - edge[0]) ** 2)


@njit(cache=True, nogil=True)
def _triangle(table: Array, a: float, b: float) -> float:
    """E(a, b) between the grid's points."""
    top = table.shape[0] - 1
    u = min(max(0.5 * (a + 1.0) * top, 0.0), top - 1e-9)
    v = min(max(0.5 * (b + 1.0) * top, 0.0), top - 1e-9)
    j, k = int(u), int(v)
    s, t = u - j, v - k
    low = (1.0 - t) * table[j, k] + t * table[j, k + 1]
    high = (1.0 - t) * table[j + 1, k] + t * table[j + 1, k + 1]
    return float((1.0 - s) * low + s * high)


@njit(cache=True, nogil=True)
def _relays(table: Array, row: Array, x: float) -> tuple[float, int]:
    """P at x after what a direction remembers, and how many of its extremes are left."""
    count = int(row[COUNT])
    if (x - row[NOW]) * row[WAY] < 0.0:
        row[FIRST + 2 * count], row[FIRST + 2 * count + 1] = row[NOW], row[VALUE]
        count += 1
    while count > 0:
        last = row[FIRST + 2 * count - 2]
        before = row[FIRST + 2 * count - 4] if count > 1 else -last
        if (x - last) * (last - before) > 0.0:
            count -= 1
        elif (x - before) * (last - before) < 0.0:
            count = max(0, count - 2)
        else:
            start = row[FIRST + 2 * count - 1]
            if x < last:
                return start - 2.0 * _triangle(table, last, x), count
            return start + 2.0 * _triangle(table, x, last), count
    return (_triangle(table, x, -x) if x >= 0.0 else -_triangle(table, -x, x)), 0


@njit(cache=True, nogil=True)
def held_current(
    table: Array, memory: Array, per_wb: float, amps: float, psi_d: float, psi_q: float
) -> tuple[float, float]:
    """i_h [A] at a flux that is tried: what is remembered stays."""
    d = q = 0.0
    for k in range(DIRECTIONS):
        x = per_wb * (COSINES[k] * psi_d + SINES[k] * psi_q)
        value, _ = _relays(table, memory[k], x)
        held = amps * (_triangle(table, x, -1.0) - _triangle(table, 1.0, x) - value)
        d += COSINES[k] * held
        q += SINES[k] * held
    return d, q


@njit(cache=True, nogil=True)
def remember(table: Array, memory: Array, per_wb: float, psi_d: float, psi_q: float) -> None:
    """Let the flux be reached."""
    for k in range(DIRECTIONS):
        row = memory[k]
        x = per_wb * (COSINES[k] * psi_d + SINES[k] * psi_q)
        if x == row[NOW]:
            continue
        row[VALUE], count = _relays(table, row, x)
        if count > DEPTH:
            count -= 2
        row[WAY] = 1.0 if x > row[NOW] else -1.0
        row[NOW], row[COUNT] = x, count


def half_width(table: Array, top: float) -> float:
    """Half the width at zero of the loop between -top and top along d [units of `amps`]; `top` in units of the grid."""
    memory = np.zeros((DIRECTIONS, ROW))
    for x in np.concatenate([np.linspace(0, top, 200), np.linspace(top, -top, 400), np.linspace(-top, 0, 200)]):
        remember(table, memory, 1.0, float(x), 0.0)
    return abs(held_current(table, memory, 1.0, 1.0, 0.0, 0.0)[0])
