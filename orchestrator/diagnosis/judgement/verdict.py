"""The record of a search from which `judge` derives the verdict."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import (
    excitation_v,
    gates_off_error,
    held_out_covariance,
    left_of_excitation,
)
from orchestrator.diagnosis.judgement.form_mixture import FormMixture
from orchestrator.diagnosis.judgement.judge import jointly_implausible, judge, residual_fraction
from orchestrator.diagnosis.nuisances.segment_scatter import MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH
from protocols import Verdict, VerdictLimits, VerdictRecord


def verdict_limits(criteria: Criteria) -> VerdictLimits:
    """The verdict's limits from the criteria of a diagnosis."""
    return VerdictLimits(
        **criteria.verdict.model_dump(exclude={"widest_band_percent", "noise_accuracy_excess_chi2"}),
        **criteria.materiality.model_dump(),
    )


def verdict_record(
    before: Fit,
    after: Fit,
    effects: int,
    *,
    periodic_lines: int = 0,
    noise_v: float | None = None,
    current_error: float | None = None,
    map_error: float | None = None,
    hidden_map_error: float | None = None,
    mixture: FormMixture | None = None,
) -> VerdictRecord:
    """The record of a finished search.

    Parameters
    ----------
    before, after : Fit
        Fits without any effect, and with all of them.
    effects : int
        Number of named effects.
    periodic_lines : int
        Number of lines in the holds' spectrum other than switching ripple.
    noise_v : float, optional
        rms residual by noise alone [V].
    current_error : float, optional
        rms error of the simulated current over its range.
    map_error : float, optional
        Half width of the map's 95 % band over the rated flux.
    hidden_map_error : float, optional
        The part of it by absent effects.
    mixture : FormMixture, optional
        Mixture of the named effects' forms, where the effects leave more than noise.
    """
    return VerdictRecord(
        **_of_fitted_stages(before, after, effects),
        held_out_chi2=held_out_chi2(after),
        held_out_equations=_prediction(after)[2],
        **gates_off_error(after),
        effect_widths={a.name: _widths(a, a.candidate.amplitudes) for a in after.model.active},
        periodic_lines=periodic_lines,
        noise_v=noise_v,
        excitation_v=excitation_v(after),
        current_error=current_error,
        map_error=map_error,
        hidden_map_error=hidden_map_error,
        chi2_in_other_forms=None if mixture is None else 1.0 + (1.0 - mixture.share) * (after.chi2_per_dof - 1.0),
        other_forms=() if mixture is None else mixture.effects,
        limits=verdict_limits(after.criteria),
    )


def fitted_verdict(before: Fit, after: Fit) -> Verdict:
    """The verdict from the fitted stages alone, for decisions of the search: held-out stages bring in no effect.

    Its limit of chi2 is wider than the report's.
    """
    changes = {"explained_excess_chi2": MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH}
    limits = verdict_limits(after.criteria).model_copy(update=changes)
    fields = _of_fitted_stages(before, after, len(after.model.active))
    return judge(VerdictRecord(**fields, limits=limits)).verdict


def _of_fitted_stages(before: Fit, after: Fit, effects: int) -> dict[str, Any]:
    """The fields of a record that the fitted stages determine."""
    strains = {a.name: _widths(a, a.free_refinements) for a in after.model.active}
    return {
        "chi2_before": before.chi2_per_dof,
        "chi2_after": after.chi2_per_dof,
        "degrees_of_freedom": after.dof,
        "effects": effects,
        "left_of_excitation": left_of_excitation(after),
        "shape_widths": max(strains.values(), default=0.0),
        "shape_effect": max(strains, key=lambda name: strains[name], default=None),
    }


def residual_fraction_of(before_chi2: float, after: Fit) -> float:
    """u = sqrt((chi2_after - 1) / (chi2_before - 1)); 0 where the first model already fits."""
    return residual_fraction(before_chi2, after.chi2_per_dof, after.criteria.verdict.noise_chi2)


def most_strained(fit: Fit) -> str | None:
    """The effect whose form is least plausible under its prior; None where all are within the limit."""
    strains = {a.name: _widths(a, [n for n in a.free if n not in a.candidate.amplitudes]) for a in fit.model.active}
    furthest = max(strains, key=lambda name: strains[name], default=None)
    return furthest if furthest is not None and strains[furthest] > fit.criteria.verdict.shape_widths else None


def large_effects_together(fit: Fit) -> list[str]:
    """Effects larger than in most drives, the largest first; empty unless they are implausibly many."""
    widths = {a.name: _widths(a, a.candidate.amplitudes) for a in fit.model.active}
    return jointly_implausible(widths, verdict_limits(fit.criteria))


def _widths(active: EffectTerm, names: Iterable[str]) -> float:
    """Largest deviation of some parameters from typical, in standard deviations of their priors."""
    return max((abs(active.prior_residual(n)) for n in names), default=0.0)


def held_out_chi2(fit: Fit) -> float | None:
    """Mean square of the held-out residual over noise and the uncertainty of R_s and the map; None without any."""
    squares, _, rows = _prediction(fit)
    return squares / rows if rows else None


def prediction_gain(trial: Fit, fit: Fit) -> float:
    """Gain in log likelihood of the held-out stages, which neither fit has seen; their excess chi2 counts as noise."""
    (squares, log_det, rows), (before, log_det_before, _) = _prediction(trial), _prediction(fit)
    noise = max(min(squares, before) / rows, 1.0) if rows else 1.0
    return -0.5 * ((squares - before) / noise + log_det - log_det_before)


def _prediction(fit: Fit) -> tuple[float, float, int]:
    """Squared held-out residual over its covariance, the log determinant of that, and the number of rows."""
    squares, log_det, rows = 0.0, 0.0, 0
    for k, covariance in held_out_covariance(fit).items():
        e = fit.residual[k]
        squares += float(e @ np.linalg.solve(covariance, e))
        log_det += float(np.linalg.slogdet(covariance)[1]) + fit.linearisation.pieces[k].whitener.log_det
        rows += len(e)
    return squares, log_det, rows
