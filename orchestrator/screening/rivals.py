"""The map that other effects would give in the place of a model's own, as far as the recording does not exclude them.

With the objective 1/2 |e|^2 (priors included), linear in its parameters about the fit, H its normal matrix and g its
gradient, an effect of the model is taken out (its amplitudes move by d = -x), and every absent effect of the library
may take its place, at a cost of its prior alone:

    y = -H_rr^-1 (g_r + H_re d),    dJ = d'H_ee d / 2 + (g_r + H_re d)'y / 2

y is the change of all the rest, R_s and the map among it. Where dJ is less than the evidence that an effect has to
have, which of the two is true is not known, and neither is the map to better than their difference. One sensor's gain,
for example, is unequal resistance to a rotor at one angle, and only the gain changes the map.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.fitting.candidates import Library
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.map_band import AbsentEffect, MapUncertainty


def rivals_of(fitter: Fitter, fit: Fit, library: Library, uncertainty: MapUncertainty) -> tuple[AbsentEffect, ...]:
    """For each effect of a fit, the change of R_s and the map where absent effects take its place.

    Parameters
    ----------
    library : sequence of CandidateEffect
        Effects that may take its place.
    uncertainty : MapUncertainty
        Of the fit; the covariance beside a rival is taken as its own.
    """
    absent = [c for c in library if c.name not in fit.model.names]
    free, columns = fit.model.free, absent_columns(absent)
    if not free or not columns:
        return ()
    total, pulls = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).system()
    width, fitted = fit.normal.shape[0], fit.normal.shape[0] + len(free)
    gradient = pulls.sum(axis=0)
    gradient[:fitted] = 0.0  # the fit is a minimum
    gradient[fitted:] -= np.concatenate([c.standing for c in absent])
    rivals = []
    for active in fit.model.active:
        own = np.array([width + k for k, (other, _) in enumerate(free) if other.name == active.name], dtype=np.intp)
        names = [n for other, n in free if other.name == active.name]
        out = np.array([-active.standardised_value(n) if n in active.candidate.amplitudes else 0.0 for n in names])
        rest = np.setdiff1d(np.arange(len(total)), own)
        pull = gradient[rest] + total[np.ix_(rest, own)] @ out
        moved = -np.linalg.solve(total[np.ix_(rest, rest)], pull)
        cost = 0.5 * float(out @ total[np.ix_(own, own)] @ out + pull @ moved)
        # An effect is distinct from its rivals where it beats them by as much as it has to be worth to be added.
        odds = fit.criteria.selection.log_evidence - cost / max(fit.chi2_per_dof, 1.0)
        probability = 0.5 * (1.0 + math.tanh(0.5 * odds))
        rivals.append(AbsentEffect(probability, moved[:width], uncertainty.covariance))
    return tuple(rivals)
