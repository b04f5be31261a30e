"""Flux from the inductances measured at scattered currents: least squares over the graph of neighbours.

d psi = L(i) di along the edge between two neighbouring points, by the trapezoidal rule with its end correction,

    psi_b - psi_a = 1/2 (L_a + L_b) di + 1/12 (L'_a - L'_b)[di, di],

where L' follows from the ripple's measured curvature. The edges overdetermine the flux; their closure error
measures its accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis._ripple import Ripple
from orchestrator.numerics.surface import TaylorSurface, require_area, triangulate
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Inductances:
    """Inductance matrices at the measured points, with slopes and covariances.

    Attributes
    ----------
    current : array, shape (n, 2)
        [A].
    matrix : array, shape (n, 2, 2)
        L = dpsi/di [H].
    slope : array, shape (n, 2, 2, 2)
        dL/di, symmetric in all indices [H/A].
    covariance : array, shape (n, 7, 7)
        Covariance of (L_dd, L_dq, L_qq, L_ddd, L_ddq, L_dqq, L_qqq), from the noise of the current.
    misfit : array, shape (n, 7), or None
        Standard deviations of the same due to model error of the regression beyond noise, such as dead time where a
        phase current changes sign. Correlated between neighbouring points. None where unknown.
    """

    current: Array
    matrix: Array
    slope: Array
    covariance: Array
    misfit: Array | None = None


PAIRS = np.array([[0, 1], [1, 2]])
TRIPLES = np.array([[[0, 1], [1, 2]], [[1, 2], [2, 3]]])
"""Indices of a symmetric tensor's entries among its distinct ones, in falling order of d."""


def invert(ripples: list[Ripple]) -> Inductances:
    """Inductances L = (Hess H)^-1 and their slopes dL_abc = -L_ai L_bj L_ck H_ijk, errors propagated."""
    h = np.stack([r.hessian for r in ripples])
    third = np.stack([r.third for r in ripples])[:, TRIPLES]
    matrix = np.linalg.inv(h).astype(np.float64)
    slope = -np.einsum("nai,nbj,nck,nijk->nabc", matrix, matrix, matrix, third)
    # d L = -L dH L; the slope's own errors are those of H_ijk, L being far better known.
    jacobian = np.zeros((len(h), 7, 7))
    for m, (i, j) in enumerate(((0, 0), (0, 1), (1, 1))):
        for a in range(2):
            for b in range(2):
                jacobian[:, m, PAIRS[a, b]] -= matrix[:, i, a] * matrix[:, b, j]
    for m, (i, j, k) in enumerate(((0, 0, 0), (0, 0, 1), (0, 1, 1), (1, 1, 1))):
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    jacobian[:, 3 + m, 3 + TRIPLES[a, b, c]] -= matrix[:, i, a] * matrix[:, j, b] * matrix[:, k, c]
    covariance = jacobian @ np.stack([r.covariance for r in ripples]) @ jacobian.transpose(0, 2, 1)
    missed = jacobian @ _misfit_covariance(ripples) @ jacobian.transpose(0, 2, 1)
    misfit = np.sqrt(np.einsum("nii->ni", missed))
    return Inductances(np.stack([r.current_dq for r in ripples]), matrix, slope, covariance, misfit)


def _misfit_covariance(ripples: list[Ripple], quiet: float = 0.25, sigmas: float = 3.0, worth: float = 45.0) -> Array:
    """Covariance of the derivatives due to the regression's model error at some of the points, shape (n, 7, 7).

    The noise is the same at all points, so a variance above the typical one is model error. Unlike noise it does not
    average out over the samples. Its effective number of samples comes from simulated motors: over dead times of 0 to
    11 V, errors of 45^-1/2 times the excess share of the residual.

    Parameters
    ----------
    ripples : list of Ripple
    quiet : float
        Share of the points whose residual counts as noise alone.
    sigmas : float
        Excess of a residual's variance over theirs, in standard deviations, that counts as model error.
    worth : float
        Effective number of independent samples of a model error, which repeats from period to period at any duration.
    """
    samples = np.array([r.samples for r in ripples], dtype=np.float64)[:, None]
    covariance = np.stack([r.covariance for r in ripples])
    # Per sample and flux, so that points of different length and ripple compare.
    order = np.array([2, 2, 2, 4, 4, 4, 4])
    size = np.array([r.flux_rms_wb for r in ripples])[:, None] ** order
    variance = np.einsum("nii->ni", covariance) * samples * size
    typical = np.quantile(variance, quiet, axis=0) * (1.0 + sigmas / np.sqrt(samples))
    share = np.maximum(variance - typical, 0.0) / np.maximum(variance, 1e-300)
    scale = np.sqrt(samples / worth * share)
    out: Array = scale[:, :, None] * covariance * scale[:, None, :]
    return out


@dataclass(frozen=True)
class IntegratedFlux:
    """Flux linkage at the points, psi(0, 0) = 0.

    Attributes
    ----------
    psi, std : array, shape (n, 2)
        [Wb].
    closure_rms_wb : float
        rms closure error of the edges.
    anchored : bool
        Whether zero current lies within the points; else it was extrapolated from the nearest.
    """

    psi: Array
    std: Array
    closure_rms_wb: float
    anchored: bool


def flux_steps(step: Array, start: tuple[Array, Array], end: tuple[Array, Array]) -> Array:
    """Flux difference over straight steps of current, from L and dL/di at both ends; shapes (e, 2) -> (e, 2)."""
    mean = 0.5 * (start[0] + end[0])
    bend = np.einsum("eijk,ej,ek->ei", start[1] - end[1], step, step)
    out: Array = np.einsum("eij,ej->ei", mean, step) + bend / 12.0
    return out


def integrate(points: Inductances, where: str) -> IntegratedFlux:
    """Integrate the inductances to fluxes over the graph of neighbouring points.

    Raises
    ------
    NotMeasuredError
        Where the points do not span an area.
    """
    require_area(points.current, where)
    scale = np.ptp(points.current, axis=0)
    edges = _edges(points.current / scale, where)
    a, b = edges.T
    step = points.current[b] - points.current[a]
    differences = flux_steps(step, (points.matrix[a], points.slope[a]), (points.matrix[b], points.slope[b]))
    # The rule's error grows with a high power of the step: short edges get the weight.
    length = np.linalg.norm(step / scale, axis=1)
    weight = np.maximum(length, 0.1 * np.median(length)) ** -4
    n = len(points.current)
    incidence = np.zeros((len(edges), n))
    incidence[np.arange(len(edges)), b], incidence[np.arange(len(edges)), a] = 1.0, -1.0
    weights_of_zero, offset, anchored = _origin(points, where)
    # Solved with the first point at zero, then shifted so that zero current has zero flux.
    normal = (incidence.T * weight) @ incidence
    solver = np.zeros((n, len(edges)))
    solver[1:] = np.linalg.solve(normal[1:, 1:], (incidence.T * weight)[1:])
    # psi(0) = sum over three corners of their weights * (psi + Taylor terms)
    solver -= weights_of_zero @ solver
    psi = solver @ differences - offset
    misfit = differences - incidence @ psi
    freedom = max(len(edges) - (n - 1), 1)
    closure = np.sqrt((weight[:, None] * misfit**2).sum(axis=0) / freedom)
    noise = _noise(points, edges, step, solver)
    std = np.sqrt(noise + (solver**2 / weight).sum(axis=1)[:, None] * closure**2)
    return IntegratedFlux(psi, std, float(np.sqrt((misfit**2).sum(axis=1).mean())), anchored)


def _edges(points: Array, where: str) -> NDArray[np.int64]:
    """Gabriel neighbours: no third point inside the circle over the edge, so none of the long edges along the hull."""
    triangles = triangulate(points, where)
    corners = triangles.simplices.astype(np.int64)
    edges, obtuse_flags = [], []
    for k in range(3):
        a, b, opposite = corners[:, k], corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]
        edges.append(np.sort(np.stack([a, b], axis=1), axis=1))
        obtuse_flags.append(np.einsum("ni,ni->n", points[a] - points[opposite], points[b] - points[opposite]) < -1e-12)
    every, obtuse = np.concatenate(edges), np.concatenate(obtuse_flags)
    neighbours = set(map(tuple, every)) - set(map(tuple, every[obtuse]))
    # Of coincident points only one is a corner of the triangulation; the others join it by an edge.
    neighbours |= {(min(point, at), max(point, at)) for point, _, at in triangles.coplanar.tolist()}
    return np.array(sorted(neighbours), dtype=np.int64)


def _origin(points: Inductances, where: str) -> tuple[Array, Array, bool]:
    """Weights and offset by which psi at zero current is `weights` @ psi + `offset`; whether the points surround it."""
    zero = np.zeros((1, 2))
    surface = TaylorSurface(points.current, zero, where)
    n = len(points.current)
    if surface.inside[0]:
        none, weights = np.zeros(n), np.zeros(n)
        weights[surface.corners[0]] = surface.weights[0]
        offset = [float(surface(none, points.matrix[:, k], points.slope[:, k])[0]) for k in range(2)]
        return weights, np.array(offset), True
    nearest = int(np.argmin(np.linalg.norm(points.current, axis=1)))
    step = -points.current[nearest]
    offset = points.matrix[nearest] @ step + 0.5 * points.slope[nearest] @ step @ step
    return np.eye(n)[nearest], np.asarray(offset), False


def _noise(points: Inductances, edges: NDArray[np.int64], step: Array, solver: Array) -> Array:
    """Variance of the flux from the inductances' errors, shape (n, 2): noise independent, misfit fully correlated."""
    from scipy.sparse import csr_array

    a, b = edges.T
    d, q = step.T
    n, rows = len(points.current), np.arange(len(edges))
    out = np.zeros((n, 2))
    for axis in range(2):
        half = (0.5 * d, 0.5 * q)
        curve = (d * d / 12.0, d * q / 6.0, q * q / 12.0)
        columns = [axis, axis + 1, 3 + axis, 4 + axis, 5 + axis]
        gain = np.zeros((len(columns), n, n))
        for m, factor in enumerate((*half, *curve)):
            sign = -1.0 if m >= 2 else 1.0
            ends = (np.concatenate([factor, sign * factor]), (np.concatenate([a, b]), np.concatenate([rows, rows])))
            gain[m] = (csr_array(ends, shape=(n, len(edges))) @ solver.T).T
        for m, first in enumerate(columns):
            for k, second in enumerate(columns):
                out[:, axis] += (gain[m] * gain[k]) @ points.covariance[:, first, second]
        if points.misfit is not None:
            out[:, axis] += sum((gain[m] @ points.misfit[:, c]) ** 2 for m, c in enumerate(columns))
    return out
