"""Parameters that a recording determines only in combination with another one, by the posterior's correlations.

With x the standardised deviation from neutral of an amplitude, s its standard deviation and r its correlation with
another parameter, zero fits where |x| < z s. With the other one held it fits only where |x| < z s sqrt(1 - r^2), by the
conditional standard deviation of a normal posterior. Between the two, the recording determines a combination alone.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS
from orchestrator.numerics.types import Array
from protocols import Companion, ParameterRole

MIN_CORRELATION: float = 0.95
"""Correlation below which the other parameter, if it were known, would leave a third of the interval or more."""
MAX_SLOPE_DEVIATION: float = 0.1
"""Deviation of the slope of one parameter over the other from -1 up to which their sum is what is determined."""


def companions(fit: Fit, covariance: Array) -> dict[tuple[str, str], Companion]:
    """The companion of each amplitude that has one, by effect and parameter.

    Parameters
    ----------
    covariance : array, shape (free, free)
        Of the standardised free parameters; see `standardised_covariance`.
    """
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    x = np.array([active.standardised_value(name) for active, name in fit.model.free])
    roles = [active.candidate.named(name).role for active, name in fit.model.free]
    sized = np.array([role is not ParameterRole.REFINEMENT for role in roles], dtype=bool)
    found: dict[tuple[str, str], Companion] = {}
    for k, (active, name) in enumerate(fit.model.free):
        others = np.where(sized & (np.arange(len(x)) != k), np.abs(correlation[k]), 0.0)
        if roles[k] is not ParameterRole.AMPLITUDE or others.max(initial=0.0) < MIN_CORRELATION:
            continue
        other, limit = int(others.argmax()), INTERVAL_SIGMAS * float(std[k])
        if limit * math.sqrt(max(1.0 - others[other] ** 2, 0.0)) < abs(x[k]) <= limit:
            found[active.name, name] = _companion(fit, covariance, k, other)
            partner, its_name = fit.model.free[other]
            if roles[other] is ParameterRole.AMPLITUDE and abs(x[other]) <= INTERVAL_SIGMAS * std[other]:
                found.setdefault((partner.name, its_name), _companion(fit, covariance, other, k))
    return found


def _companion(fit: Fit, covariance: Array, k: int, other: int) -> Companion:
    """The other parameter; with the sum of both where the two have one unit, and one falls as the other rises."""
    (active, name), (partner, its_name) = fit.model.free[k], fit.model.free[other]
    one, two = active.candidate.named(name), partner.candidate.named(its_name)
    alone = Companion(effect=partner.name, parameter=its_name)
    are_linear = two.role is ParameterRole.AMPLITUDE and not (one.strong_when_small or two.strong_when_small)
    if one.unit != two.unit or not are_linear:
        return alone
    widths = np.array([one.prior_width, two.prior_width])
    natural = covariance[np.ix_([k, other], [k, other])] * np.outer(widths, widths)
    if max(abs(natural[0, 1] / natural[j, j] + 1.0) for j in (0, 1)) > MAX_SLOPE_DEVIATION:
        return alone
    total, half = active.values[name] + partner.values[its_name], INTERVAL_SIGMAS * math.sqrt(float(natural.sum()))
    return alone.model_copy(update={"total": total, "total_low": total - half, "total_high": total + half})
