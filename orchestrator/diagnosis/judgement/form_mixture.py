"""Deviation of the named effects' forms from the library's: a mixture of each effect's forms, drawn from its prior.

An effect of the library has one form, with a few free shapes; a plant's has its own. Where a model leaves more than
noise, each named effect is added `FORMS` times more, each time with shapes and refinements drawn from their priors.
Their amplitudes are random effects: R_s, the map and all fitted parameters follow, and their variance maximises the
restricted likelihood (D. A. Harville, J. Am. Stat. Assoc. 72 (1977) 320, doi:10.1080/01621459.1977.10480998). As in a
Gaussian process with random features (A. Rahimi, B. Recht, NIPS 2007), the mixture covers what such effects can do. If
it takes up much of what is left, the rest is the effect's form; if it takes up little, something else is missing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm, value_at
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.numerics.types import Array
from protocols import ParameterRole

FORMS: int = 64
"""Forms of each effect: with twice as many a foreign hysteresis' mixture takes up 60 % of the rest, not 42 %, at twice
the computing time."""
FORM_WIDTHS: float = 1.5
"""Standard deviation with which shapes and refinements are drawn, in those of their priors."""
REFINED_PROBABILITY: float = 0.5
"""Probability that a form has a given refinement; without it a form differs by too many at once."""
VARIANCE_DECADES: tuple[float, float] = (-4.0, 12.0)
"""Range of log10 of the amplitudes' variance, for columns of unit length in standard deviations of the noise."""


@dataclass(frozen=True)
class FormMixture:
    """Mixture of forms beside a fit, to first order.

    Attributes
    ----------
    effects : tuple of str
        Effects with a form that can vary.
    share : float
        Part of the excess chi2 of the fitted stages that it takes up.
    log_evidence : float
        Gain of the restricted log likelihood [nat].
    shift : array, shape (1 + free,)
        Change of R_s and the map's free coefficients with it.
    covariance : array, shape (1 + free, 1 + free)
        Their covariance with it.
    """

    effects: tuple[str, ...]
    share: float
    log_evidence: float
    shift: Array
    covariance: Array

    @property
    def is_detected(self) -> bool:
        """Whether the data prefer the mixture to the forms as fitted."""
        return self.log_evidence > 0.0


def mix_forms(fitter: Fitter, fit: Fit, names: Sequence[str]) -> FormMixture | None:
    """Mixture of the forms of some of a fit's effects; None where none of them has another form."""
    forms = {a.name: _drawn(a) for a in fit.model.active if a.name in names}
    columns = [(form, n) for drawn in forms.values() for form in drawn for n in form.candidate.amplitudes]
    if not columns:
        return None
    total, pulls = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).system()
    width, fitted = fit.normal.shape[0], len(total) - len(columns)
    across, pull = total[:fitted, fitted:], pulls.sum(axis=0)
    follow = np.linalg.solve(total[:fitted, :fitted], across)
    # The normal matrix has unit priors, which the estimated variance replaces.
    own = total[fitted:, fitted:] - np.eye(len(columns))
    length = np.sqrt(np.diag(own))
    scale = np.where(length > 0.0, 1.0 / np.maximum(length, 1e-300), 0.0)
    information, turn = np.linalg.eigh((own - across.T @ follow) * np.outer(scale, scale))
    information = np.maximum(information, 0.0)
    along = turn.T @ (scale * (pull[fitted:] - follow.T @ pull[:fitted]))
    variance, log_evidence = _likeliest_variance(information, along)
    posterior = 1.0 / (1.0 / variance + information)
    removed = float(np.sum(along**2 * (2.0 / variance + information) * posterior**2))
    used = float(np.sum(information * posterior))
    excess, left = fit.chi2_per_dof - 1.0, (fit.chi2 - removed) / max(fit.dof - used, 1.0) - 1.0
    to_fitted = follow @ (scale[:, None] * turn)
    inverse = np.linalg.inv(total[:fitted, :fitted]) + (to_fitted * posterior) @ to_fitted.T
    return FormMixture(
        effects=tuple(name for name, drawn in forms.items() if drawn),
        share=max(1.0 - left / excess, 0.0) if excess > 0.0 else 0.0,
        log_evidence=log_evidence,
        shift=(to_fitted @ (along * posterior))[:width],
        covariance=(1.0 + max(left, 0.0)) * inverse[:width, :width],
    )


def _likeliest_variance(information: Array, along: Array) -> tuple[float, float]:
    """The amplitudes' variance with the largest restricted likelihood, and its gain over none [nat]."""
    from scipy.optimize import minimize_scalar

    def cost(decade: float) -> float:
        variance = 10.0**decade
        return float(np.log1p(variance * information).sum() - (along**2 / (1.0 / variance + information)).sum())

    best = minimize_scalar(cost, bounds=VARIANCE_DECADES, method="bounded", options={"xatol": 0.05})
    return 10.0 ** float(best.x), -0.5 * float(best.fun)


def _drawn(term: EffectTerm) -> list[EffectTerm]:
    """Absent terms of an effect in other forms, each with a name of its own; always the same ones."""
    from scipy.stats import norm, qmc

    candidate = term.candidate
    shapes, refinements = candidate.of_role(ParameterRole.SHAPE), candidate.of_role(ParameterRole.REFINEMENT)
    if not shapes and not refinements:
        return []
    neutral = {name: candidate.named(name).neutral for name in candidate.amplitudes}
    # Low-discrepancy points cover the prior more evenly than random ones.
    points = qmc.Sobol(len(shapes) + 2 * len(refinements), seed=0).random_base2(round(math.log2(FORMS)))
    widths = FORM_WIDTHS * norm.ppf(np.clip(points, 1e-3, 1.0 - 1e-3))
    first = len(shapes)
    is_refined = points[:, first + len(refinements) :] < REFINED_PROBABILITY
    drawn = []
    for k in range(FORMS):
        form = {name: value_at(candidate.named(name), float(widths[k, j])) for j, name in enumerate(shapes)}
        form |= {
            name: value_at(candidate.named(name), float(widths[k, first + j]))
            for j, name in enumerate(refinements)
            if is_refined[k, j]
        }
        renamed = replace(candidate, alias=f"{candidate.name} in form {k + 1}")
        drawn.append(EffectTerm(renamed, {**term.values, **neutral, **form}, candidate.amplitudes))
    return drawn
