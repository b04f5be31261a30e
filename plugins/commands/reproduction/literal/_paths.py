"""Flux along the paper's current paths by its sums, outwards from zero flux at zero current.

    psi(k) - psi(k_0) = sum of L(i(z)) di(z),  z = k_0 + 1 .. k,     di(z) = i(z) - i(z - 1)

(Combes, Malrait, Martin, Rouchon, section "Experimental results" of the proposed method). The paper does not state how
other paths start; here they start at their crossing with the path along the other axis through zero current.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis import FluxPath
from orchestrator.numerics.types import Array

AXES = ("d", "q", "dq")


class Rule(Enum):
    """Quadrature rule of an integral over samples."""

    RECTANGLE = "rectangles"
    """The paper's rule: the inductance at the end of each step."""
    TRAPEZOID = "trapezoids"


@dataclass(frozen=True)
class Line:
    """One path of current set-points.

    Attributes
    ----------
    points : array of int
        Indices of its points, in order.
    axis : {"d", "q", "dq"}
        Axis along which the current changes.
    held_a : float
        Current on the other axis; 0 on the diagonal.
    """

    points: NDArray[np.intp]
    axis: str
    held_a: float

    @property
    def swept(self) -> Array:
        """Direction of the sweep, shape (2,)."""
        return np.array({"d": (1.0, 0.0), "q": (0.0, 1.0), "dq": (np.sqrt(0.5), np.sqrt(0.5))}[self.axis])


def lines_of(targets: Array) -> list[Line]:
    """Paths among the set-points, shape (n, 2): runs of equal steps."""
    step = np.diff(targets, axis=0)
    # Targets along the diagonal are rounded decimals.
    same = np.abs(np.diff(step, axis=0)).max(axis=1) <= 1e-3 * np.abs(step[1:]).max(axis=1)
    ends = [0, *(np.flatnonzero(~same) + 1).tolist(), len(step)]
    lines = []
    for first, last in pairwise(ends):
        if last - first > 1 and np.abs(step[first]).max() > 0.0:
            moves = np.abs(step[first]) > 0.5 * np.abs(step[first]).max()
            axis = "dq" if moves.all() else "dq"[int(moves[1])]
            held = 0.0 if axis == "dq" else float(targets[first, int(not moves[1])])
            lines.append(Line(np.arange(first, last + 1), axis, held))
    return lines


def summed(lines: Sequence[Line], current: Array, matrix: Array, rule: Rule) -> list[FluxPath]:
    """Flux along each path.

    Parameters
    ----------
    lines : sequence of Line
        Lines; one that neither passes through zero current nor crosses such a line is left out.
    current : array, shape (n, 2)
        Measured current [A].
    matrix : array, shape (n, 2, 2)
        Inductances at these currents [H].
    rule : Rule
    """
    through_zero: dict[str, FluxPath] = {}
    out = []
    for line in sorted(lines, key=lambda one: abs(one.held_a)):
        i, inductance = current[line.points], matrix[line.points]
        start = int(np.argmin(np.abs(i @ line.swept)))
        base = _base(line, through_zero)
        if base is None:
            continue
        from_i, from_psi = base
        rise = inductance[start] @ (i[start] - from_i)
        path = FluxPath(i, from_psi + rise + _outwards(i, inductance, start, rule), np.zeros(2))
        if line.held_a == 0.0:
            through_zero[line.axis] = path
        out.append(path)
    return out


def _base(line: Line, through_zero: dict[str, FluxPath]) -> tuple[Array, Array] | None:
    """Current and flux at a path's start."""
    if line.held_a == 0.0:
        return np.zeros(2), np.zeros(2)
    other = through_zero.get("q" if line.axis == "d" else "d")
    if other is None:
        return None
    nearest = int(np.argmin(np.abs(other.current @ line.swept[::-1] - line.held_a)))
    return other.current[nearest], other.psi[nearest]


def _outwards(current: Array, matrix: Array, start: int, rule: Rule) -> Array:
    """Sums from `start` to both ends, shape (n, 2) [Wb]."""
    psi = np.zeros_like(current)
    for ahead in (range(start + 1, len(current)), range(start - 1, -1, -1)):
        before = start
        for k in ahead:
            inductance = matrix[k] if rule is Rule.RECTANGLE else 0.5 * (matrix[k] + matrix[before])
            psi[k] = psi[before] + inductance @ (current[k] - current[before])
            before = k
    return psi


def parity_percent(lines: Sequence[Line], current: Array, entries: Array) -> Array:
    """Largest departure of matrix entries 11, 22 from even and of 12 from odd in i_q, shape (3,) [percent].

    Relative to the mean of the diagonal. A path is compared with its mirror image at equal currents along it.

    Parameters
    ----------
    lines : sequence of Line
    current : array, shape (n, 2)
    entries : array, shape (n, 2, 2)
    """
    columns = np.stack([entries[:, 0, 0], entries[:, 1, 1], entries[:, 0, 1]], axis=1)
    sign = np.array([1.0, 1.0, -1.0])
    departures = []
    for line in lines:
        held_a = -line.held_a if line.axis == "d" else line.held_a  # of the line with i_q reversed
        mirror = [one for one in lines if one.axis == line.axis and abs(one.held_a - held_a) < 1e-9]
        if line.axis == "dq" or not mirror:
            continue
        along, other = (current[one.points] @ one.swept for one in (line, mirror[0]))
        order = np.argsort(other)
        at = along if line.axis == "d" else -along
        inside = (at >= other.min()) & (at <= other.max())
        image = np.stack([np.interp(at, other[order], c[order]) for c in columns[mirror[0].points].T], axis=1)
        departures.append(0.5 * (columns[line.points] - sign * image)[inside])
    every = np.abs(np.concatenate(departures)).max(axis=0)
    return np.asarray(100.0 * every / np.abs(columns[:, :2]).mean())
