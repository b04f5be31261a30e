"""A fleet's statistics as priors of the fit: mean and width of amplitudes, and probability of effects.

A fleet gives the width that standardises an amplitude, its mean, and a probability that changes the evidence required.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orchestrator.analysis import KnownResistance
from orchestrator.diagnosis.criteria import SelectionCriteria
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, standardised
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.magnetics import linear_magnetics
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import DiagnosisReport, EffectParameter, InputError, Manifest, ParameterRole, Remark
from protocols.fleet_priors import EffectPrior, FleetPriors, NormalPrior

MIN_PROBABILITY_OF_INCLUSION = 0.8
"""Probability from which an effect is included before the search: four of five motors have it."""


def require_same_motor(priors: FleetPriors, manifest: Manifest) -> None:
    """Raise `InputError` where the priors are another motor's."""
    if priors.motor is not None and priors.motor != manifest.motor.name:
        problem = f"they are of {priors.motor!r}, {manifest.name} is of {manifest.motor.name!r}"
        raise InputError("priors", "motor", problem)


def known_by(priors: FleetPriors | None) -> KnownResistance | None:
    """R_s of the fleet; None where it has none."""
    if priors is None or priors.resistance is None:
        return None
    return KnownResistance(priors.resistance.mean, priors.resistance.std, is_measured=True)


def inductances_at_rest(priors: FleetPriors | None, grid: EvenSpline) -> tuple[Array, Array] | None:
    """Coefficients of a linear map with the fleet's inductances, and rows for a map's deviation at zero current.

    Rows are in standard deviations of the fleet, shape (2, coefficients); None unless both inductances are known.
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
        If a size belongs to no amplitude, or has another unit.
    """
    default_probability, known = criteria.prior_probability, priors.effects
    unseen = EffectPrior(probability=1.0 / (priors.diagnosed + 2), found=0, asked=priors.diagnosed)
    return tuple(_with_prior(c, known.get(c.name, unseen), default_probability) for c in library)


MAX_FLEET_SIGMAS: float = 4.0
"""Standard deviations of the predictive distribution beyond which an effect contradicts the fleet; chance exceeds them
once in 16,000."""
MAX_VARIANCE_RATIO: float = 0.99
"""Largest posterior over prior variance there: a recording without information cannot contradict."""


def contradicts_fleet(fit: Fit) -> frozenset[str]:
    """Effects whose size in this recording is improbable in the fleet.

    From the predictive distribution (Box 1980, doi:10.2307/2982063): a posterior x of variance s with a prior N(c, 1)
    implies a measurement (x - c) / (1 - s) from the mean, with the variance 1 / (1 - s).
    """
    if not fit.model.free:
        return frozenset()
    variance = np.minimum(np.diag(fit.covariance()) * max(fit.chi2_per_dof, 1.0), MAX_VARIANCE_RATIO)
    return frozenset(
        active.name
        for (active, name), s in zip(fit.model.free, variance, strict=True)
        if name in active.candidate.centres and abs(active.prior_residual(name)) / math.sqrt(1.0 - s) > MAX_FLEET_SIGMAS
    )


def _with_prior(candidate: CandidateEffect, prior: EffectPrior, default_probability: float) -> CandidateEffect:
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
    odds, usual = (math.log(p / (1.0 - p)) for p in (prior.probability, default_probability))
    return replace(
        candidate,
        parameters=tuple(parameters),
        centres=centres,
        prior_log_odds=odds - usual,
        included_a_priori=bool(centres) and prior.probability > MIN_PROBABILITY_OF_INCLUSION,
    )


def _narrowed(p: EffectParameter, size: NormalPrior) -> EffectParameter:
    """The parameter with the fleet's width; for one that is strong when small, the width of its inverse."""
    if not p.strong_when_small:
        return replace(p, prior_width=size.std)
    return replace(p, prior_width=p.typical**2 * size.std / size.mean**2)


def fleet_remarks(priors: FleetPriors, unlike: frozenset[str], report: DiagnosisReport) -> list[Remark]:
    """Remarks on the use of fleet priors, and on effects that contradict them."""
    text = "with what {count} recordings of a fleet let expect ({table})"
    remarks = [Remark.of("fleet", text, count=priors.recordings, table=priors.table)]
    for name in sorted(unlike):
        text = "{effect}: its size is none of the fleet's, which had no say in it"
        remarks.append(Remark.of("unlike_the_fleet", text, effect=name))
    here = {name for effect in (*report.effects, *report.minor) for name in (effect.name, *effect.twins)}
    for name, prior in priors.effects.items():
        if prior.probability > 0.9 and name not in here:
            text = "{effect}: in {found} of {asked} recordings of the fleet, not found here"
            remarks.append(Remark.of("not_found_here", text, effect=name, found=prior.found, asked=prior.asked))
    return remarks
