"""Least squares for the derivatives of an energy, whose symmetry ties the two current components together.

The input is a normal matrix from `_ripple_moments`. P is the integral over time of the voltage's ripple, Q that of the
current's: the flux ripple is P - R Q.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from protocols import NotMeasuredError

# The unknowns: H_11 H_12 H_22 | H_111 H_112 H_122 H_222 | four of the free matrix on Q | H_1111 .. H_2222.
_HESSIAN, _THIRD, _FREE, _FOURTH = slice(0, 3), slice(3, 7), slice(7, 11), slice(11, 16)
_P, _Q = slice(0, 2), slice(2, 4)
_FEATURES_OF_ORDER = {1: 4, 2: 7, 3: 11}
_UNKNOWNS_OF_ORDER = {1: [0, 1, 2, 7, 8, 9, 10], 2: list(range(11)), 3: list(range(16))}
MIN_UNEXPLAINED_SHARE = 0.05
"""Smallest part of Q not explained by P for R_s to be separable. Observed: at least 0.24 with a wave of rotating axis,
at most 0.003 with a vector that rotates at the wave's own frequency."""
DEPENDENT = "both currents are the same signal: the readings cover one axis only"
ONE_AXIS_ERROR = "the injected voltage excites one axis only: its direction has to rotate"
NO_RESISTANCE = "the voltage rotates at its own frequency: inductances need a known R_s, and none is known"


def _design() -> Array:
    """Coefficient of each feature in each current component, shape (11, 2, 16 unknowns)."""
    x = np.zeros((11, 2, 16))
    for axis in range(2):
        for k in range(2):
            x[k, axis, axis + k] = 1.0
            x[2 + k, axis, 7 + 2 * k + axis] = 1.0
        for k, factor in enumerate((0.5, 1.0, 0.5)):
            x[4 + k, axis, 3 + k + axis] = factor
        for k, factor in enumerate((1 / 6, 0.5, 0.5, 1 / 6)):
            x[7 + k, axis, 11 + k + axis] = factor
    return x


_DESIGN = _design()


@dataclass(frozen=True)
class SymmetricFit:
    """Derivatives of the energy with the covariance of the first seven; undetermined ones are zero.

    `decay_per_s`, shape (2, 2), is the matrix H R of a transient's decay.
    """

    hessian: Array
    third: Array
    covariance: Array
    decay_per_s: Array


def symmetric_regression(
    normal: Array, freedom: int, sampling_s: float, where: str, resistance_ohm: float | None = None
) -> SymmetricFit:
    """Generalised least squares for H_11 .. H_222, symmetric by construction.

    Parameters
    ----------
    normal : array, shape (13, 13)
        Sums of products of eleven features (P, Q, second- and third-order products of the flux ripple) and currents.
    freedom : int
        Samples less the parameters fitted before.
    sampling_s : float
        Time between the samples, whose trapezoids make Q.
    resistance_ohm : float, optional
        Known resistance: the coefficient of Q where Q is not separable from P.

    Raises
    ------
    NotMeasuredError
        Where the injection moves the flux along one direction only, or rotates and no resistance is known, or the two
        currents depend on each other.
    """
    known_ohm = None
    if not _separable(normal):
        if resistance_ohm is None:
            raise NotMeasuredError(where, "v_alpha, v_beta", NO_RESISTANCE)
        known_ohm = resistance_ohm
        normal = normal.copy()
        for lines in (normal, normal.T):
            lines[_P] -= known_ohm * lines[_Q]
    for order in (3, 2, 1):
        features = np.arange(_FEATURES_OF_ORDER[order])
        unknowns = np.array(_UNKNOWNS_OF_ORDER[order])
        if known_ohm is not None:
            features = np.delete(features, _Q)
            unknowns = unknowns[(unknowns < _FREE.start) | (unknowns >= _FREE.stop)]
        scale = np.sqrt(np.diag(normal)[features])
        if not (scale > 0).all():
            continue
        scaled = normal[np.ix_(features, features)] / np.outer(scale, scale)
        if np.linalg.eigvalsh(scaled)[0] > 1e-6:
            try:
                fit = _solved(normal, features, scale, scaled, freedom, unknowns)
                if known_ohm is not None:
                    fit = replace(fit, decay_per_s=known_ohm * fit.hessian)
                return _undo_trapezoid_error(fit, sampling_s)
            except np.linalg.LinAlgError:
                # Currents that are an exact multiple of each other leave a residual of rank one.
                raise NotMeasuredError(where, "i_alpha, i_beta", DEPENDENT) from None
    raise NotMeasuredError(where, "v_alpha, v_beta", ONE_AXIS_ERROR)


def _separable(normal: Array) -> bool:
    """Whether Q adds information to P, so that a resistance is determined besides inductances."""
    p_products, across, q_products = normal[_P, _P], normal[_P, _Q], normal[_Q, _Q]
    size = np.sqrt(np.diag(q_products))
    if not (size > 0.0).all() or np.linalg.matrix_rank(p_products, hermitian=True) < 2:
        return True
    unexplained = q_products - across.T @ np.linalg.solve(p_products, across)
    return bool(np.linalg.eigvalsh(unexplained / np.outer(size, size))[0] > MIN_UNEXPLAINED_SHARE)


def _solved(
    normal: Array,
    features: NDArray[np.intp],
    scale: Array,
    scaled: Array,
    freedom: int,
    unknowns: NDArray[np.intp],
) -> SymmetricFit:
    used = len(features)
    right = normal[features, 11:] / scale[:, None]
    free = np.linalg.solve(scaled, right)
    noise = (normal[11:, 11:] - right.T @ free) / max(freedom - 2 * used, 1)
    noise += np.eye(2) * max(1e-12 * np.trace(normal[11:, 11:]) / max(freedom, 1), 1e-300)
    design = (_DESIGN[features][:, :, unknowns] * scale[:, None, None]).reshape(2 * used, -1)
    weight = np.kron(scaled, np.linalg.inv(noise))
    size = np.linalg.norm(design, axis=0)
    design = design / size
    information = design.T @ weight @ design
    covariance = np.linalg.inv(information)
    answer, spread = np.zeros(16), np.zeros((16, 16))
    answer[unknowns] = covariance @ (design.T @ (weight @ free.ravel())) / size
    spread[np.ix_(unknowns, unknowns)] = covariance / np.outer(size, size)
    h = answer[_HESSIAN]
    hessian = np.array([[h[0], h[1]], [h[1], h[2]]])
    return SymmetricFit(hessian, answer[_THIRD], spread[:7, :7], -answer[_FREE].reshape(2, 2).T)


def _undo_trapezoid_error(fit: SymmetricFit, sampling_s: float) -> SymmetricFit:
    """The fit corrected for trapezoids over a current that decays between two samples.

    With the decay matrix A = H R, the step h, x = A h / 2 and the trapezoid Q' of the current over a step, the sampled
    current obeys di = (tanh x / x) H v h - (2/h) tanh x Q' exactly. So A = (2/h) artanh(B h / 2) with B the fitted A,
    and H is A / B times the fitted H.
    """
    rates, vectors = np.linalg.eig(fit.decay_per_s.astype(np.complex128))
    x = 0.5 * sampling_s * rates
    # A rate faster than the samples is noise: no correction.
    x = np.where((np.abs(x) > 1e-6) & (np.abs(x) < 0.9), x, 1e-6)
    ratio = (vectors * (np.arctanh(x) / x)) @ np.linalg.inv(vectors)
    hessian = (ratio @ fit.hessian).real
    return SymmetricFit(
        hessian=0.5 * (hessian + hessian.T),
        third=fit.third,
        covariance=fit.covariance,
        decay_per_s=(ratio @ fit.decay_per_s).real,
    )
