"""How much the current readings' zero differs from segment to segment: what is likeliest, whatever else is missing.

Sensors and their amplifiers wander while an experiment goes on. With e the whitened residual of the training segments,
X all columns (R_s, the map, every effect of the library) and U what an ampere on all readings of a segment does to it,

    e = X b + U d + noise,    d ~ N(0, sigma^2),    V = 1 + sigma^2 U U^T
    -2 log L(sigma) = log det V + log det (X^T V^-1 X + P) + e^T V^-1 e - h^T (X^T V^-1 X + P)^-1 h

P being the priors and h the gradient at b = 0: the restricted likelihood (H. D. Patterson, R. Thompson, Biometrika 58
(1971), doi:10.1093/biomet/58.3.545), in which what the map or an effect can take is not scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.numerics.types import Array
from protocols import ModelNoise


@dataclass(frozen=True)
class OffsetScatter:
    """Scatter of the readings' zero.

    Attributes
    ----------
    sigma_a : float
        Standard deviation of each phase's reading [A].
    log_likelihood : float
        What it gains over none.
    chi2 : float
        Per degree of freedom, where it is noise and all effects follow to first order.
    """

    sigma_a: float
    log_likelihood: float
    chi2: float


@dataclass(frozen=True)
class _Segment:
    """What the scatter of one segment meets: its own information, that shared with all columns, and its pull."""

    own: Array
    shared: Array
    pull: Array


@dataclass(frozen=True)
class _Likelihood:
    """The restricted likelihood of a scatter; costs are minus twice its logarithm."""

    segments: Sequence[_Segment]
    normal: Array
    gradient: Array
    chi2: float
    dof: float

    def cost(self, sigma_a: float) -> float:
        squares, log_det = self._squares(sigma_a)
        return squares + log_det

    def chi2_per_dof(self, sigma_a: float) -> float:
        return self._squares(sigma_a)[0] / self.dof

    def _squares(self, sigma_a: float) -> tuple[float, float]:
        """What is left of chi2, and the determinants' logarithms."""
        few = len(self.segments[0].own) if self.segments else 0
        roots, log_det = [], 0.0
        chi2 = self.chi2
        for one in self.segments:
            inside = np.eye(few) + sigma_a**2 * one.own
            factor = np.linalg.cholesky(inside)
            log_det += 2.0 * float(np.log(np.diag(factor)).sum())
            roots.append(sigma_a * np.linalg.solve(factor, np.column_stack([one.shared, one.pull])))
        taken = np.concatenate(roots)
        normal = self.normal - taken[:, :-1].T @ taken[:, :-1]
        gradient = self.gradient - taken[:, :-1].T @ taken[:, -1]
        chi2 -= float(taken[:, -1] @ taken[:, -1])
        squares = chi2 - float(gradient @ np.linalg.solve(normal, gradient))
        return squares, log_det + float(np.linalg.slogdet(normal)[1])


def explained_by_scatter(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> DiagnosisSetup | None:
    """The setup with a scatter as noise, where that and effects to first order are all that a part's fit lacks."""
    if setup.offset_scatter_a > 0.0:
        return None
    scatter = offset_scatter(setup.coarse_fitter, fit, library)
    limits = fit.criteria.selection
    if not _is_noise(scatter, setup) or scatter.chi2 > 1.0 + limits.explained_left:
        return None
    return setup.with_noise(ModelNoise(offset_scatter_a=scatter.sigma_a))


def beside_scatter(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> DiagnosisSetup | None:
    """The setup with a scatter as noise, where there is one in the whole recording beside all that a fit has."""
    scatter = offset_scatter(setup.fitter, fit, library)
    return setup.with_noise(ModelNoise(offset_scatter_a=scatter.sigma_a)) if _is_noise(scatter, setup) else None


def _is_noise(scatter: OffsetScatter, setup: DiagnosisSetup) -> bool:
    """Whether a scatter is there, and no larger than a sound sensor's."""
    limits = setup.prepared.criteria.selection
    small = scatter.sigma_a <= setup.prepared.criteria.uncertainty.most_offset_scatter * setup.current_a
    return small and scatter.log_likelihood > limits.log_evidence


def offset_scatter(fitter: Fitter, fit: Fit, library: Sequence[Candidate]) -> OffsetScatter:
    """The likeliest scatter of the readings' zero around a fit's model, all effects of the library following.

    Parameters
    ----------
    fitter : Fitter
        Whatever scatter it allows for is not.
    """
    from scipy.optimize import minimize_scalar

    likelihood = _likelihood(fitter.with_noise(ModelNoise()), fit, library)
    # From far below a sensor's noise to as much as there is current.
    decades = np.arange(-6.0, 1.0)
    near = min(decades.tolist(), key=lambda x: likelihood.cost(10.0**x))
    best = minimize_scalar(lambda x: likelihood.cost(10.0**x), bounds=(near - 1.0, near + 1.0), method="bounded")
    sigma_a = 10.0 ** float(best.x)
    gain = 0.5 * (likelihood.cost(0.0) - likelihood.cost(sigma_a))
    return OffsetScatter(sigma_a, gain, likelihood.chi2_per_dof(sigma_a))


def _likelihood(fitter: Fitter, fit: Fit, library: Sequence[Candidate]) -> _Likelihood:
    absent = absent_columns([c for c in library if c.name not in fit.model.names])
    loose = fitter.evaluate(fit.model, fitter.frame(fit.model), absent)
    normal, pulls = loose.system()
    width, free = loose.normal.shape[0], loose.model.free
    gradient = pulls.sum(axis=0)
    # R_s and the map are where their gradient, prior included, is nil.
    gradient[:width] = 0.0
    gradient[width : width + len(free)] += [a.coordinate(n) for a, n in free]
    segments = []
    training = loose.training()
    pieces = [(p, f) for p, f in zip(loose.prepared.pieces, loose.frame.pieces, strict=True) if not p.held_out]
    for (piece, frame), (linear, d, e) in zip(pieces, training, strict=True):
        u = fitter.equations.offsets(loose.model, piece, frame)
        segments.append(_Segment(u.T @ u, u.T @ np.column_stack([linear, d]), u.T @ e))
    return _Likelihood(segments, normal, gradient, loose.chi2, loose.dof)
