"""A function of two variables as a tensor product of quintic B-splines, even in the second.

Knots are uniform, so that all splines are shifts of the cardinal spline (C. de Boor, "A Practical Guide to Splines",
Springer 1978, chapter IX), and the function is a polynomial in each cell. Beyond its rectangle the polynomial of the
cell at the edge continues. Its roughness is the integral of the squared fifth derivatives, which are still functions.

An even function may have a kink at y = 0, a jump of its third derivative: the energy of iron that saturates from zero
flux on, as ribs do. The splines, which are smooth there, are then joined by one function along y,

    k(u) = ((2 - |u|)_+^5 - 16 (1 - |u|)_+^5) / 120 = 2/15 - 2/3 u^2 + |u|^3 - ...,    u in cells from y = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.types import Array, Indices

DEGREE = 5
_SUPPORT = DEGREE + 1
_KINK_REACH = 2
"""Cells on either side of y = 0 where the function with the kink is not zero."""


def _cardinal() -> Array:
    pieces = np.zeros((_SUPPORT, _SUPPORT))
    for r in range(_SUPPORT):
        # Spline r of a cell is N(t + DEGREE - r), N the cardinal spline on [0, DEGREE + 1].
        shift = DEGREE - r
        for j in range(shift + 1):
            factor = (-1) ** j * math.comb(_SUPPORT, j) / math.factorial(DEGREE)
            for p in range(_SUPPORT):
                pieces[r, p] += factor * math.comb(DEGREE, p) * float(shift - j) ** (DEGREE - p)
    return pieces


CARDINAL = _cardinal()
"""Coefficients [r, p] of t^p in the six splines r that are nonzero in a cell, t from 0 to 1 within it."""


@dataclass(frozen=True)
class EvenSpline:
    """Basis on a rectangle [low, high] x [-reach, reach], linear in `size` coefficients.

    Attributes
    ----------
    low, high, reach : float
    cells : (int, int)
        Intervals along the first variable, and over the whole of the second.
    kink : bool
        Whether a function may have a kink at y = 0; the second number of cells is even then, and four or more.
    """

    low: float
    high: float
    reach: float
    cells: tuple[int, int]
    kink: bool = False

    def __post_init__(self) -> None:
        if self.kink and (self.cells[1] % 2 or self.cells[1] < 2 * _KINK_REACH):
            raise ValueError(f"expected an even number of {2 * _KINK_REACH} or more intervals, not {self.cells[1]}")

    @property
    def steps(self) -> tuple[float, float]:
        """Sides of a cell."""
        return (self.high - self.low) / self.cells[0], 2.0 * self.reach / self.cells[1]

    @property
    def functions(self) -> tuple[int, int]:
        """Splines along the first variable, and even functions of the second, that with the kink last."""
        return self.cells[0] + DEGREE, (self.cells[1] + DEGREE + 1) // 2 + self.kink

    @property
    def size(self) -> int:
        """Number of coefficients; the index along the second variable runs fastest."""
        return self.functions[0] * self.functions[1]

    @property
    def fold(self) -> NDArray[np.int64]:
        """Index of the even function of the second variable that each spline along it belongs to."""
        full = np.arange(self.cells[1] + DEGREE)
        return np.minimum(full, full[::-1])

    @property
    def layout(self) -> tuple[Array, NDArray[np.int64]]:
        """Arguments of kernels: [low, step, -reach, step] along both variables, and [*cells, *fold]."""
        numbers = np.array([self.low, self.steps[0], -self.reach, self.steps[1]])
        return numbers, np.array([*self.cells, *self.fold], dtype=np.int64)

    @cached_property
    def kinked(self) -> Array:
        """Coefficients of t^p of the function with the kink, t from 0 to 1 in a cell, shape (cells, 6); or (0, 6)."""
        out = np.zeros((self.cells[1], _SUPPORT)) if self.kink else np.zeros((0, _SUPPORT))
        for cell in range(_KINK_REACH if self.kink else 0):
            # |u| is cell + t above zero, and cell + 1 - t below.
            for column, offset, side in (
                (self.cells[1] // 2 + cell, cell, 1),
                (self.cells[1] // 2 - 1 - cell, cell + 1, -1),
            ):
                for height, end in ((1.0, _KINK_REACH), (-16.0, 1)):
                    if cell < end:
                        powers = [math.comb(DEGREE, p) * float(end - offset) ** (DEGREE - p) for p in range(_SUPPORT)]
                        out[column] += (
                            height * np.array(powers) * (-side) ** np.arange(_SUPPORT) / math.factorial(DEGREE)
                        )
        return out

    def rows(self, at: Array, along_first: int, along_second: int) -> Array:
        """Mixed derivative of the basis functions at points (m, 2), shape (m, size)."""
        first = self._along_first(at[:, 0], along_first)
        second = self._along_second(at[:, 1], along_second) @ self._unfold
        out: Array = np.einsum("mi,mj->mij", first, second).reshape(len(at), self.size)
        return out

    def patches(self, coefficients: Array) -> Array:
        """Polynomial coefficients of t^m s^n in each cell, shape (*cells, 6, 6), for `derivatives_at`."""
        table = coefficients.reshape(self.functions)
        cells = np.lib.stride_tricks.sliding_window_view(table[:, self.fold], (_SUPPORT, _SUPPORT))
        out = np.ascontiguousarray(np.einsum("rm,abrs,sn->abmn", CARDINAL, cells, CARDINAL, optimize=True))
        if self.kink:
            along = np.lib.stride_tricks.sliding_window_view(table[:, -1], _SUPPORT) @ CARDINAL
            out += along[:, None, :, None] * self.kinked[None, :, None, :]
        return out

    def squares(self) -> tuple[Array, Array]:
        """Exact coefficients of x^2 and y^2: squared Greville abscissae less a constant (by blossoming)."""

        def square(low: float, step: float, functions: int) -> Array:
            greville = low + step * (np.arange(functions) - (DEGREE - 1) / 2.0)
            return np.asarray(greville**2 - step**2 * (DEGREE + 1) / 12.0, dtype=np.float64)

        (nx, ny), (x_step, y_step) = self.functions, self.steps
        x, y = square(self.low, x_step, nx), square(-self.reach, y_step, ny - self.kink)
        # The function with the kink has no share in either.
        y, one = np.append(y, [0.0] * self.kink), np.append(np.ones(ny - self.kink), [0.0] * self.kink)
        return np.kron(x, one), np.tile(y, nx)

    def on(self, other: EvenSpline, coefficients: Array) -> Array:
        """Coefficients in another basis, by least squares; beyond this rectangle gradients continue linearly."""
        many = 8 * np.maximum(self.cells, other.cells)
        x = np.linspace(other.low, other.high, many[0])
        y = np.linspace(0.0, other.reach, many[1])
        own_first = _continued(self._along_first, x, self.low, self.high)
        own_second = _continued(self._along_second, y, 0.0, self.reach) @ self._unfold
        first = np.linalg.lstsq(other._along_first(x), own_first, rcond=None)[0]
        second = np.linalg.lstsq(other._along_second(y) @ other._unfold, own_second, rcond=None)[0]
        return np.ascontiguousarray(first @ coefficients.reshape(self.functions) @ second.T).reshape(-1)

    def differences(self, order: int) -> list[Array]:
        """All mixed derivatives of one order as differences of the coefficients, each of shape (rows, size).

        Each is weighted by the root of its multiplicity, so that the sum of squares does not depend on the axes'
        directions; the pure derivative along the first variable comes first. A kink is in none of them.
        """
        (nx, _), (x_step, y_step), full = self.functions, self.steps, len(self.fold)
        blocks = []
        for along_y in range(order + 1):
            along_x = order - along_y
            if nx <= along_x or full <= along_y:
                continue
            first = np.diff(np.eye(nx), n=along_x, axis=0) / x_step**along_x
            second = np.diff(self._unfold[:full], n=along_y, axis=0) / y_step**along_y
            blocks.append(np.asarray(math.sqrt(math.comb(order, along_y)) * np.kron(first, second), dtype=np.float64))
        return blocks

    def difference_places(self, order: int) -> Array:
        """Places of the rows of `differences`, shape (rows, 2), both from 0 to 1: along x, and from y = 0 outwards."""
        nx, full, places = self.functions[0], len(self.fold), []
        for along_y in range(order + 1):
            along_x = order - along_y
            if nx > along_x and full > along_y:
                x = np.linspace(0.0, 1.0, nx - along_x) if nx > along_x + 1 else np.full(1, 0.5)
                y = np.abs(np.linspace(-1.0, 1.0, full - along_y)) if full > along_y + 1 else np.zeros(1)
                places.append(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2))
        return np.concatenate(places)

    @cached_property
    def roughness(self) -> Array:
        """Matrix (size, size) of the integral of all squared fifth derivatives, in units of the half ranges.

        Raises
        ------
        ValueError
            For a basis with a kink, whose fifth derivative is no function.
        """
        if self.kink:
            raise ValueError("expected a basis without a kink")
        half = 0.5 * (self.high - self.low)
        firsts = _squared_derivatives(self.cells[0], self.steps[0] / half)
        seconds = _squared_derivatives(self.cells[1], self.steps[1] / self.reach)
        out = np.zeros((self.size, self.size))
        for k in range(DEGREE + 1):
            out += math.comb(DEGREE, k) * np.kron(firsts[k], self._unfold.T @ seconds[DEGREE - k] @ self._unfold)
        return out

    @property
    def smooth(self) -> int:
        """Dimension of the functions without roughness: even polynomials of the fourth degree."""
        return sum(DEGREE - k for k in range(0, DEGREE, 2))

    @cached_property
    def modes(self) -> Array:
        """Another basis, shape (size, size), one function per column.

        First come `smooth` polynomials by degree (1, x, x^2, y^2, ...), in units of the half ranges. The coefficient
        vectors of the others are orthogonal to them, and the sum of squares of their amplitudes is the roughness.
        """
        smooth = self._polynomials()
        rest = np.linalg.qr(smooth, mode="complete")[0][:, self.smooth :]
        root = np.linalg.cholesky(rest.T @ self.roughness @ rest)
        return np.concatenate([smooth, np.linalg.solve(root, rest.T).T], axis=1)

    def _polynomials(self) -> Array:
        d = np.linspace(self.low, self.high, 3 * DEGREE + self.functions[0])
        q = np.linspace(0.0, self.reach, 3 * DEGREE + len(self.fold))
        at = np.stack(np.meshgrid(d, q, indexing="ij"), axis=-1).reshape(-1, 2)
        x, y = (2.0 * at[:, 0] - self.low - self.high) / (self.high - self.low), at[:, 1] / self.reach
        degrees = [(n - k, k) for n in range(DEGREE) for k in range(0, n + 1, 2)]
        values = np.stack([x**m * y**n for m, n in degrees], axis=1)
        return np.asarray(np.linalg.lstsq(self.rows(at, 0, 0), values, rcond=None)[0])

    @cached_property
    def _unfold(self) -> Array:
        """Matrix from even functions of the second variable to its splines, of which mirrored pairs are equal.

        With a kink, its function comes last among both.
        """
        full = len(self.fold)
        out = np.zeros((full + self.kink, self.functions[1]))
        out[np.arange(full), self.fold] = 1.0
        out[full:, -1] = 1.0
        return out

    def _along_first(self, x: Array, order: int = 0) -> Array:
        return _values((x - self.low) / self.steps[0], self.cells[0], order) / self.steps[0] ** order

    def _along_second(self, y: Array, order: int = 0) -> Array:
        u = (y + self.reach) / self.steps[1]
        values = _values(u, self.cells[1], order)
        if self.kink:
            cell, powers, falling = _within_cells(u, self.cells[1], order)
            kinked = np.sum(powers * self.kinked[cell, order:] * falling, axis=1)
            values = np.column_stack([values, kinked])
        return values / self.steps[1] ** order


def _values(u: Array, cells: int, order: int) -> Array:
    """A derivative of all splines along one variable, in cell units, shape (points, cells + DEGREE)."""
    cell, powers, falling = _within_cells(u, cells, order)
    out = np.zeros((len(u), cells + DEGREE))
    np.put_along_axis(out, cell[:, None] + np.arange(_SUPPORT), powers @ (CARDINAL[:, order:] * falling).T, axis=1)
    return out


def _within_cells(u: Array, cells: int, order: int) -> tuple[Indices, Array, Array]:
    """Cell of each position, powers of the place in it, and the factors of a derivative's powers."""
    cell = np.clip(np.floor(u).astype(np.int64), 0, cells - 1)
    powers = (u - cell)[:, None] ** np.arange(_SUPPORT - order)
    return cell, powers, np.array([math.perm(p, order) for p in range(order, _SUPPORT)], dtype=np.float64)


def _continued(along: Callable[[Array, int], Array], x: Array, low: float, high: float) -> Array:
    """The splines along one variable, continued as parabolas beyond its range."""
    edge = np.clip(x, low, high)
    beyond = (x - edge)[:, None]
    return along(edge, 0) + beyond * (along(edge, 1) + 0.5 * beyond * along(edge, 2))


def _squared_derivatives(cells: int, step: float) -> list[Array]:
    """Integrals of products of the m-th derivatives, m = 0 to 5, exact by Gauss' rule in each cell."""
    nodes, weights = np.polynomial.legendre.leggauss(_SUPPORT)
    at = (np.arange(cells)[:, None] + 0.5 * (1.0 + nodes)).ravel()
    weight = np.tile(0.5 * step * weights, cells)
    each = [_values(at, cells, m) / step**m for m in range(_SUPPORT)]
    return [np.asarray((values * weight[:, None]).T @ values) for values in each]


@njit(cache=True, nogil=True, inline="always")
def derivatives_at(x: float, y: float, patches: Array, numbers: Array) -> tuple[float, float, float, float, float]:
    """f_x, f_y, f_xx, f_xy, f_yy at one point; beyond the rectangle the gradient continues linearly from its edge."""
    u = (x - numbers[0]) / numbers[1]
    v = (y - numbers[2]) / numbers[3]
    m = min(max(int(u), 0), patches.shape[0] - 1)
    n = min(max(int(v), 0), patches.shape[1] - 1)
    s = min(max(u - m, 0.0), 1.0)
    t = min(max(v - n, 0.0), 1.0)
    # Horner's scheme along the first variable, of f, f_y and f_yy / 2 from Horner's scheme along the second.
    f = 0.0
    f_x = 0.0
    f_xx = 0.0
    f_y = 0.0
    f_xy = 0.0
    f_yy = 0.0
    for r in range(5, -1, -1):
        row = patches[m, n, r, 5]
        row_y = 0.0
        row_yy = 0.0
        for k in range(4, -1, -1):
            row_yy = row_yy * t + row_y
            row_y = row_y * t + row
            row = row * t + patches[m, n, r, k]
        f_xx = f_xx * s + f_x
        f_x = f_x * s + f
        f = f * s + row
        f_xy = f_xy * s + f_y
        f_y = f_y * s + row_y
        f_yy = f_yy * s + 2.0 * row_yy
    slope_xx = 2.0 * f_xx / (numbers[1] * numbers[1])
    slope_xy = f_xy / (numbers[1] * numbers[3])
    slope_yy = f_yy / (numbers[3] * numbers[3])
    beyond_x = (u - m - s) * numbers[1]
    beyond_y = (v - n - t) * numbers[3]
    slope_x = f_x / numbers[1] + slope_xx * beyond_x + slope_xy * beyond_y
    slope_y = f_y / numbers[3] + slope_xy * beyond_x + slope_yy * beyond_y
    return slope_x, slope_y, slope_xx, slope_xy, slope_yy


@njit(cache=True, nogil=True)
def derivatives(at: Array, patches: Array, numbers: Array) -> tuple[Array, Array]:
    """`derivatives_at` many points (n, 2): the first (n, 2), and the second (n, 3)."""
    n = at.shape[0]
    slopes = np.empty((n, 2))
    curvatures = np.empty((n, 3))
    for k in range(n):
        slopes[k, 0], slopes[k, 1], curvatures[k, 0], curvatures[k, 1], curvatures[k, 2] = derivatives_at(
            at[k, 0], at[k, 1], patches, numbers
        )
    return slopes, curvatures
