"""What a fleet knows of the next motor, as the fit's own priors: where amplitudes stand, how widely, and how likely.

An amplitude's coordinate is its value over its prior's width; a fleet gives the width and where the middle is. Its
probability changes the evidence that is required. Nothing is fitted here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.analysis import KnownResistance
from orchestrator.diagnosis.criteria import SelectionCriteria
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, standardised
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.magnetics import linear_magnetics
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import EffectParameter, InputError, Manifest, ParameterRole
from protocols.fleet_priors import EffectPrior, FleetPriors, NormalPrior

LEAST_PROBABILITY_OF_INCLUSION = 0.8
"""Probability from which on an effect is in the model before any search: four of five motors have it."""


def require_same_motor(priors: FleetPriors, manifest: Manifest) -> None:
    """Raise `InputError` where the priors are another motor's."""
    if priors.motor is not None and priors.motor != manifest.motor.name:
        problem = f"they are of {priors.motor!r}, {manifest.name} is of {manifest.motor.name!r}"
        raise InputError("priors", "motor", problem)


def known_by(priors: FleetPriors | None) -> KnownResistance | None:
    """R_s as the fleet has it."""
    if priors is None or priors.resistance is None:
        return None
    return KnownResistance(priors.resistance.mean, priors.resistance.std, is_measured=True)


def inductances_at_rest(priors: FleetPriors | None, grid: EvenSpline) -> tuple[Array, Array] | None:
    """A map's coefficients with the fleet's inductances everywhere, and rows that measure how far it is off at rest.

    Rows are in standard deviations of the fleet, shape (2, coefficients); None where it has not both.
    """
    if priors is None or priors.d_inductance is None or priors.q_inductance is None:
        return None
    d, q, at_rest = priors.d_inductance, priors.q_inductance, np.zeros((1, 2))
    rows = np.concatenate([grid.rows(at_rest, 2, 0) / d.std, grid.rows(at_rest, 0, 2) / q.std])
    return linear_magnetics(grid, d.mean, q.mean).coefficients, np.asarray(rows, dtype=np.float64)


def with_priors(
    library: Sequence[CandidateEffect], priors: FleetPriors, criteria: SelectionCriteria
) -> tuple[CandidateEffect, ...]:
    """The library with each effect's priors where the fleet has them.

    Raises
    ------
    InputError
        Where a size is of no amplitude, or in another unit.
    """
    own, known = criteria.prior_probability, priors.effects
    unseen = EffectPrior(probability=1.0 / (priors.diagnosed + 2), found=0, asked=priors.diagnosed)
    return tuple(_with_prior(c, known.get(c.name, unseen), own) for c in library)


@dataclass(frozen=True)
class Disagreement:
    """From when on a motor's effect is not judged by the fleet.

    Attributes
    ----------
    unlike : float
        Standard deviations beyond what the fleet has: one of 16,000 by chance, of some twenty effects.
    least_learnt : float
        Largest part of a prior's variance that may be left: without information there is no disagreement.
    """

    unlike: float = 4.0
    least_learnt: float = 0.99


def contradicts_fleet(fit: Fit, limits: Disagreement | None = None) -> frozenset[str]:
    """Effects whose size the fleet would hardly have, as this recording alone has it.

    By the predictive distribution (Box 1980, doi:10.2307/2982063): a posterior x of variance s about a prior N(c, 1)
    comes from a reading (x - c) / (1 - s) off the middle, which has the variance 1 / (1 - s).
    """
    limits = limits or Disagreement()
    if not fit.model.free:
        return frozenset()
    variance = np.minimum(np.diag(fit.covariance()) * max(fit.chi2_per_dof, 1.0), limits.least_learnt)
    return frozenset(
        active.name
        for (active, name), s in zip(fit.model.free, variance, strict=True)
        if name in active.candidate.centres and abs(active.prior_residual(name)) / math.sqrt(1.0 - s) > limits.unlike
    )


def _with_prior(candidate: CandidateEffect, prior: EffectPrior, own: float) -> CandidateEffect:
    parameters, centres = list(candidate.parameters), {}
    for name, size in prior.sizes.items():
        place = next((k for k, p in enumerate(parameters) if p.name == name), None)
        if place is None or parameters[place].role is not ParameterRole.AMPLITUDE:
            raise InputError("priors", f"effects.{candidate.name}.sizes.{name}", "no amplitude of that effect")
        if size.unit != parameters[place].unit:
            problem = f"expected {parameters[place].unit}, got {size.unit}"
            raise InputError("priors", f"effects.{candidate.name}.sizes.{name}.unit", problem)
        parameters[place] = _narrowed(parameters[place], size)
        centres[name] = standardised(parameters[place], size.mean)
    odds, usual = (math.log(p / (1.0 - p)) for p in (prior.probability, own))
    return replace(
        candidate,
        parameters=tuple(parameters),
        centres=centres,
        prior_log_odds=odds - usual,
        included_a_priori=bool(centres) and prior.probability > LEAST_PROBABILITY_OF_INCLUSION,
    )


def _narrowed(p: EffectParameter, size: NormalPrior) -> EffectParameter:
    """The parameter with the fleet's width; of one that is strong when small, its inverse's."""
    if not p.strong_when_small:
        return replace(p, prior_width=size.std)
    return replace(p, prior_width=p.typical**2 * size.std / size.mean**2)
