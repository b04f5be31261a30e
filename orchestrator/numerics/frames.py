"""Rotation of two-axis vectors between the stator frame and the rotor's dq frame; no phase quantities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from protocols import RealArray


def to_dq(x_ab: RealArray, theta_rad: ArrayLike) -> NDArray[np.float64]:
    """Rotate stator-frame vectors into the dq frame: x_dq = R(-theta) x_ab.

    Parameters
    ----------
    x_ab : array, shape (n, 2)
        Vectors in the stator frame, amplitude-invariant; any unit.
    theta_rad : float, or array of shape (n,)
        Electrical angle of the d axis [rad].

    Returns
    -------
    array of float64, shape (n, 2)
    """
    return _rotated(x_ab, -np.asarray(theta_rad, dtype=float))


def to_ab(x_dq: RealArray, theta_rad: ArrayLike) -> NDArray[np.float64]:
    """Rotate dq-frame vectors into the stator frame: x_ab = R(theta) x_dq; inverse of `to_dq`."""
    return _rotated(x_dq, np.asarray(theta_rad, dtype=float))


def _rotated(x: RealArray, angle: NDArray[np.float64]) -> NDArray[np.float64]:
    # A C-contiguous (n, 2) array of doubles is an (n,) array of complex numbers, whose rotation is one product.
    vectors = np.ascontiguousarray(x, dtype=np.float64).view(np.complex128)[:, 0]
    turned: NDArray[np.float64] = (vectors * np.exp(1j * angle)).view(np.float64).reshape(-1, 2)
    return turned
