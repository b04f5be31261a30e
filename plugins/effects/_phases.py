"""Stator-frame vectors and the three phases of a star connection: amplitude-invariant Clarke; numpy only."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array

_SQRT3 = math.sqrt(3.0)


def to_phases(x_ab: NDArray[np.floating]) -> Array:
    """(alpha, beta) of shape (n, 2) to phases a, b, c of shape (n, 3) that add up to zero."""
    alpha, beta = np.asarray(x_ab, dtype=np.float64).T
    return np.stack([alpha, -0.5 * alpha + 0.5 * _SQRT3 * beta, -0.5 * alpha - 0.5 * _SQRT3 * beta], axis=1)


def from_phases(x_abc: Array) -> Array:
    """Phases (n, 3) to (alpha, beta) (n, 2); a zero sequence does not reach a star connection."""
    a, b, c = x_abc.T
    return np.stack([(2.0 * a - b - c) / 3.0, (b - c) / _SQRT3], axis=1)


def from_two(a: Array, b: Array) -> Array:
    """Phases a and b, c being what closes the star, to (alpha, beta) of shape (n, 2)."""
    return np.stack([a, (a + 2.0 * b) / _SQRT3], axis=1)


def constant(a: float, b: float) -> Array:
    """The vector (2,) of constants in phases a and b, c closing the star."""
    return np.array([a, (a + 2.0 * b) / _SQRT3])
