"""Uncertainty of R_s and the map: by noise, by the model's effects, and by absent effects that may exist."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, Library
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.form_mixture import FormMixture
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS, form_std, projected_rows
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class AbsentEffect:
    """First-order estimate of an effect that is not in the model.

    Attributes
    ----------
    probability : float
        Probability that it exists.
    shift : array, shape (1 + free,)
        Change of R_s and the map's free coefficients with it.
    covariance : array, shape (1 + free, 1 + free)
        Their covariance with the effect free.
    """

    probability: float
    shift: Array
    covariance: Array


@dataclass(frozen=True)
class MapUncertainty:
    """Uncertainty of R_s and the map's free coefficients, with all effects of the model free.

    Attributes
    ----------
    covariance : array, shape (1 + free, 1 + free)
        Covariance by noise, inflated to the residual.
    pulls : array, shape (segments, 1 + free)
        Estimates from each segment alone, for the sandwich estimate (H. White 1980, doi:10.2307/1912934).
    forms : array, shape (coordinates, 1 + free)
        Change by the error of the effects' forms, a row for each free coordinate.
    absent : tuple of AbsentEffect
    """

    fit: Fit
    covariance: Array
    pulls: Array
    forms: Array
    absent: tuple[AbsentEffect, ...]

    @classmethod
    def of(cls, fitter: Fitter, fit: Fit, library: Library = ()) -> MapUncertainty:
        """Uncertainty of a fit; effects of the library that are not in the model may exist nevertheless."""
        width, count = fit.normal.shape[0], len(fit.model.free)
        absent = [c for c in library if c.name not in fit.model.names]
        columns = absent_columns(absent)
        loose = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit) if columns else fit
        total, pulls = loose.system()
        fitted = np.arange(width + count)
        inverse = np.linalg.inv(total[np.ix_(fitted, fitted)])
        noise = max(fit.chi2_per_dof, 1.0)
        forms = np.zeros((0, width))
        if count:
            rows = [(p, x[:, :count] @ inverse[width:, width:]) for p, _, x in projected_rows(loose)]
            moved = np.linalg.solve(fit.normal, total[:width, width : width + count])
            forms = moved.T * form_std(fit, rows)[:, None]
        places = [(c, [width + count + k for k, (a, _) in enumerate(columns) if a.name == c.name]) for c in absent]
        return cls(
            fit=fit,
            covariance=noise * inverse[:width, :width],
            pulls=pulls[:, fitted] @ inverse[:, :width],
            forms=forms,
            absent=tuple(_absent_effect(fit, total, pulls.sum(axis=0), fitted, np.array(at), c) for c, at in places),
        )

    def with_mixture(self, mixture: FormMixture | None) -> MapUncertainty:
        """The uncertainty with other forms of the named effects, if the data prefer them."""
        if mixture is None or not mixture.is_detected:
            return self
        return replace(self, absent=(*self.absent, AbsentEffect(1.0, mixture.shift, mixture.covariance)))

    def spread(self, rows: Array) -> Array:
        """Standard deviation (n,) of linear combinations (n, 1 + free) of R_s and the map's free coefficients."""
        noise = _quadratic(rows, self.covariance)
        variance = np.maximum(noise, np.sum((self.pulls @ rows.T) ** 2, axis=0))
        variance = variance + np.sum((self.forms @ rows.T) ** 2, axis=0)
        variance = variance + self._variance_by_absent_effects(rows, noise)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _variance_by_absent_effects(self, rows: Array, noise: Array) -> Array:
        variance = np.zeros(len(rows))
        for one in self.absent:
            more = np.maximum(_quadratic(rows, one.covariance) - noise, 0.0)
            variance = variance + one.probability * (more + (rows @ one.shift) ** 2)
        return variance

    @property
    def resistance_ohm(self) -> float:
        """Standard deviation of R_s [ohm]."""
        row = np.zeros((1, len(self.covariance)))
        row[0, 0] = 1.0
        return float(self.spread(row)[0])

    def band_wb(self, i_dq: Array) -> float:
        """Half width of the flux's 95 % band, rms over given currents and both axes [Wb]."""
        rows = self._rows_of_flux(i_dq)
        return INTERVAL_SIGMAS * math.sqrt(float(np.mean(self.spread(rows) ** 2))) if len(rows) else 0.0

    def hidden_wb(self, i_dq: Array) -> float:
        """The part of `band_wb` by absent effects, which the recording may hide [Wb]."""
        rows = self._rows_of_flux(i_dq)
        variance = self._variance_by_absent_effects(rows, _quadratic(rows, self.covariance))
        return INTERVAL_SIGMAS * math.sqrt(float(np.mean(variance))) if len(rows) else 0.0

    def _rows_of_flux(self, i_dq: Array) -> Array:
        """Derivative of the flux by R_s and the map's free coefficients; empty for a map that is not free."""
        if self.fit.model.space.directions.shape[1] == 0:
            return np.zeros((0, len(self.covariance)))
        rows = flux_rows(self.fit, i_dq)
        return np.column_stack([np.zeros(len(rows)), rows])

    def of_map(self, i_dq: Array) -> Array:
        """Standard deviations (n, 5) of psi_d, psi_q (from zero current), L_dd, L_dq, L_qq at currents (n, 2)."""
        space, at_rest = self.fit.model.space, np.zeros((1, 2))
        spreads = []
        for order in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
            rows = space.grid.rows(i_dq, *order)
            if sum(order) == 1:
                rows = rows - space.grid.rows(at_rest, *order)
            free = rows @ space.directions
            spreads.append(self.spread(np.column_stack([np.zeros(len(free)), free])))
        return np.stack(spreads, axis=1)


def flux_rows(fit: Fit, i_dq: Array) -> Array:
    """Derivative of the flux at currents (n, 2), less its mean, by the map's free coefficients, (2 n, free)."""
    grid, rows = fit.model.space.grid, []
    for direction in fit.model.space.directions.T:
        flux = Magnetics(grid, direction).flux_and_inductance(i_dq)[0]
        rows.append((flux - flux.mean(axis=0)).ravel())
    return np.stack(rows, axis=1)


def _absent_effect(
    fit: Fit, total: Array, pull: Array, fitted: Array, at: Array, candidate: CandidateEffect
) -> AbsentEffect:
    """Estimate of one absent effect; `fitted` are the indices of all fitted parameters, `at` the effect's."""
    width, noise = fit.normal.shape[0], max(fit.chi2_per_dof, 1.0)
    both = np.concatenate([fitted, at])
    inverse = np.linalg.inv(total[np.ix_(both, both)])
    block, across = inverse[len(fitted) :, len(fitted) :], inverse[:width, len(fitted) :]
    best = -block @ (pull[at] - candidate.standing)
    # An estimate beyond the bounds, such as a negative hysteresis, is not this effect.
    size = _within_bounds(candidate, best)
    short = size - best
    prior = fit.criteria.selection.prior_probability
    gain = 0.5 * float(best @ np.linalg.solve(block, best) - short @ np.linalg.solve(block, short)) / noise
    odds = gain + 0.5 * float(np.linalg.slogdet(block)[1]) + math.log(prior / (1.0 - prior))
    odds += candidate.prior_log_odds - 0.5 * float(candidate.standing @ candidate.standing)
    probability = 0.5 * (1.0 + math.tanh(0.5 * odds))
    return AbsentEffect(probability, across @ np.linalg.solve(block, size), noise * inverse[:width, :width])


def _within_bounds(candidate: CandidateEffect, coordinates: Array) -> Array:
    """Standardised amplitudes of an effect, limited to their bounds."""
    absent, pairs = candidate.absent(), zip(candidate.amplitudes, coordinates, strict=True)
    return np.array([absent.moved(name, float(x)).standardised_value(name) for name, x in pairs])


def _quadratic(rows: Array, covariance: Array) -> Array:
    return np.asarray(np.sum((rows @ covariance) * rows, axis=1))
