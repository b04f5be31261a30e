"""Two-axis vectors in the stator's frame, in the rotor's dq frame, and as the three phases of a star connection.

Vectors are amplitude-invariant: their length is the phases' peak. Versions for kernels are in `numerics.kernels`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.numerics.kernels import unit_vectors
from orchestrator.numerics.types import Array


def to_dq(x_ab: NDArray[np.floating[Any]], theta_rad: ArrayLike) -> Array:
    """Rotate stator-frame vectors into the dq frame: x_dq = R(-theta) x_ab.

    Parameters
    ----------
    x_ab : array, shape (n, 2)
        Vectors in the stator frame; any unit.
    theta_rad : float, or array of shape (n,)
        Electrical angle of the d axis [rad].

    Returns
    -------
    array of float64, shape (n, 2)
    """
    return _rotated(x_ab, -np.asarray(theta_rad, dtype=float))


def to_ab(x_dq: NDArray[np.floating[Any]], theta_rad: ArrayLike) -> Array:
    """Rotate dq-frame vectors into the stator frame: x_ab = R(theta) x_dq; inverse of `to_dq`."""
    return _rotated(x_dq, np.asarray(theta_rad, dtype=float))


def rotation(theta_rad: float) -> Array:
    """The matrix R(theta), shape (2, 2): from the dq frame into the stator's."""
    c, s = math.cos(theta_rad), math.sin(theta_rad)
    return np.array([[c, -s], [s, c]])


def _rotated(x: NDArray[np.floating[Any]], angle: Array) -> Array:
    # A C-contiguous (n, 2) array of doubles is an (n,) array of complex numbers, whose rotation is one product.
    vectors = np.ascontiguousarray(x, dtype=np.float64).view(np.complex128)[:, 0]
    if angle.size > 1 and (angle == angle[0]).all():
        # A locked rotor has one angle for all samples.
        angle = angle[:1]
    # Stages rotate vectors while the drive is armed, when no kernel may be loaded.
    turns = unit_vectors(angle).view(np.complex128)[:, 0] if angle.size > 1 else np.exp(1j * angle)
    turned: Array = (vectors * turns).view(np.float64).reshape(-1, 2)
    return turned


def to_phases(x_ab: NDArray[np.floating[Any]]) -> Array:
    """Vectors (alpha, beta) of shape (n, 2) as phases a, b, c of shape (n, 3), which add up to zero: inverse Clarke."""
    alpha, beta = np.asarray(x_ab, dtype=np.float64).T
    across = 0.5 * math.sqrt(3.0) * beta
    return np.stack([alpha, across - 0.5 * alpha, -across - 0.5 * alpha], axis=1)


def from_phases(x_abc: NDArray[np.floating[Any]]) -> Array:
    """Phases of shape (n, 3) as vectors (alpha, beta) of shape (n, 2): Clarke, in which a zero sequence drops out."""
    a, b, c = np.asarray(x_abc, dtype=np.float64).T
    return np.stack([(2.0 * a - b - c) / 3.0, (b - c) / math.sqrt(3.0)], axis=1)


def from_two_phases(a: ArrayLike, b: ArrayLike) -> Array:
    """Phases a and b of a star (c is minus their sum) as vectors of shape (n, 2); two numbers as one of shape (2,)."""
    alpha = np.asarray(a, dtype=np.float64)
    return np.stack([alpha, (alpha + 2.0 * np.asarray(b, dtype=np.float64)) / math.sqrt(3.0)], axis=-1)


def inductance_to_ab(inductance: Array, theta_rad: ArrayLike) -> Array:
    """L_aa, L_ab, L_bb (n, 3) in the stator frame of L_dd, L_dq, L_qq (n, 3) in a rotor at an angle, or at (n,)."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    dd, dq, qq = inductance.T
    aa, bb = c * c * dd - 2.0 * c * s * dq + s * s * qq, s * s * dd + 2.0 * c * s * dq + c * c * qq
    return np.column_stack([aa, c * s * (dd - qq) + (c * c - s * s) * dq, bb])
