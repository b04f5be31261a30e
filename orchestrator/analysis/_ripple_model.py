"""The current that an R-L winding draws from a voltage held between samples, exactly; free of the sensors' noise.

With A = H R and H constant,  i[k + 1] = exp(-A h) i[k] + (1 - exp(-A h)) A^-1 H v[k].
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from orchestrator.analysis._phase_loss import PhaseLoss
from orchestrator.analysis._phase_loss_kernels import take_out
from orchestrator.analysis._ripple_regression import SymmetricFit
from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.kernels import for_kernels
from orchestrator.numerics.types import Array
from protocols import Capture


def model_current(capture: Capture, angle_rad: float, delay: float, fit: SymmetricFit, loss: PhaseLoss) -> Array:
    """The current in the stator frame [A], shape (n, 2), from the first reading on.

    Parameters
    ----------
    capture : Capture
    angle_rad : float
        Angle of the dq frame of the fit.
    delay : float
        n, where v[k] acts from t_k + n Ts.
    fit : SymmetricFit
    loss : PhaseLoss
        Known voltage error of the inverter.
    """
    whole = math.floor(delay)
    part = delay - whole
    padded = np.concatenate([np.repeat(capture.v_ab[:1], whole + 1, axis=0), capture.v_ab]).astype(np.float64)
    late, later = padded[1 : len(capture) + 1], padded[: len(capture)]
    v = np.ascontiguousarray(to_dq(late + part * (later - late), angle_rad).T)
    if len(loss.knots_a):
        frame = (math.cos(angle_rad), math.sin(angle_rad))
        (i,) = for_kernels(capture.i_ab)
        take_out(i, 0, frame, loss.knots_a, loss.error_v, loss.areas, v)
    rates, vectors = np.linalg.eig(fit.decay_per_s.astype(np.complex128))
    inverse = np.linalg.inv(vectors)
    x = rates / capture.sampling_frequency_hz
    transition = ((vectors * np.exp(-x)) @ inverse).real
    drawn = ((vectors * (-np.expm1(-x) / rates)) @ inverse).real @ fit.hessian
    return to_ab(_recursion(transition, drawn @ v, to_dq(capture.i_ab[:1], angle_rad)[0]), angle_rad)


@njit(cache=True, nogil=True)
def _recursion(a: Array, drawn: Array, start: Array) -> Array:
    n = drawn.shape[1]
    out = np.empty((n, 2))
    d, q = start[0], start[1]
    for k in range(n):
        out[k, 0], out[k, 1] = d, q
        d, q = (a[0, 0] * d + a[0, 1] * q + drawn[0, k], a[1, 0] * d + a[1, 1] * q + drawn[1, k])
    return out
