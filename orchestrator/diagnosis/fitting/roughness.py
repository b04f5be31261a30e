"""Local roughness of a map by empirical Bayes.

Bridges saturate within a few percent of the current range, and elsewhere the same map is smooth. With one variance for
all fourth derivatives of W the map is too stiff there, and too uncertain elsewhere. So the precision of derivative k is
multiplied by exp(sum_j s_jk theta_j). s_jk is the share of node j of a coarse grid, theta_j ~ N(0, sigma^2), and theta
maximises the evidence (D. MacKay, doi:10.1162/neco.1992.4.3.415),

    d log p / d theta_j = 1/2 sum_k s_jk (h_k - m_k) - theta_j / sigma^2,

h_k = E[r_k^2] under the prior alone and m_k under the posterior, r_k the derivative in units of its standard deviation.
No node is smoother than usual: that would make the map's band too narrow between its points.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.solution import free_coefficients
from orchestrator.diagnosis.weak_form.magnetics import ORDER_OF_SMOOTHNESS, shares_of_nodes
from orchestrator.numerics.local_rows import triangular_factor
from orchestrator.numerics.types import Array

NODES: tuple[int, int] = (5, 4)
"""Nodes along i_d, and from i_q = 0 outwards."""
STD_OF_LOG_PRECISION: float = 2.0
"""Of theta: by one standard deviation the roughness changes by e."""
STEPS: int = 6
"""Steps of the ascent, of one in theta at most each; more of them hardly change the map."""


def estimated_roughness(fit: Fit) -> Array:
    """Roughness at the nodes, shape `NODES`, for which the evidence of a fit's free map is largest.

    The effects stay as they are, and the equations linear. chi2 above one counts as noise.
    """
    space = fit.model.space
    places = space.grid.difference_places(ORDER_OF_SMOOTHNESS)
    shares, rows = shares_of_nodes(places, NODES), len(places)
    before = np.exp(
        -2.0 * shares_of_nodes(_nodes(), space.roughness.shape) @ np.log(space.roughness).reshape(-1)
    )  # precision at the nodes
    usual = space.prior[:rows] * np.exp(-0.5 * shares @ np.log(before))[:, None]
    others = space.prior[rows:]
    noise = max(fit.chi2_per_dof, 1.0)
    x = np.append(fit.model.r_s, free_coefficients(space, fit.model.magnetics.coefficients))
    data = fit.normal.copy()
    data[1:, 1:] -= space.prior.T @ space.prior
    right = fit.normal @ x / noise
    theta = np.log(before)
    for _ in range(STEPS):
        smooth = usual * np.exp(0.5 * shares @ theta)[:, None]
        prior = np.concatenate([smooth, others])
        normal = data / noise
        normal[1:, 1:] += prior.T @ prior
        covariance = np.linalg.inv(normal)
        derivatives = smooth @ (covariance @ right)[1:]
        by_posterior = shares.T @ (derivatives**2 + np.sum((smooth @ covariance[1:, 1:]) * smooth, axis=1))
        factor = triangular_factor(prior, space.grid.functions[1])
        leverage = solve_triangular(factor, smooth.T, trans="T", check_finite=False)
        by_prior = shares.T @ np.sum(leverage**2, axis=0)
        slope = 0.5 * (by_prior - by_posterior) - theta / STD_OF_LOG_PRECISION**2
        step = slope / (0.5 * np.maximum(by_prior, by_posterior) + 1.0 / STD_OF_LOG_PRECISION**2)
        theta = np.minimum(theta + step, 0.0)
    return np.asarray(np.exp(-0.5 * theta).reshape(NODES))


def _nodes() -> Array:
    """Places of the nodes, shape (nodes, 2)."""
    grids = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in NODES), indexing="ij")
    return np.stack(grids, axis=-1).reshape(-1, 2)
