"""Effects that are included before the search: those that the readings establish, and those that the fleet expects.

A forward search starts with the largest single gain, where one effect may explain the error of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, Library, standardised
from orchestrator.diagnosis.selection.scoring import log_evidence
from orchestrator.diagnosis.selection.search_result import AcceptedModel
from orchestrator.diagnosis.selection.search_state import SearchState
from orchestrator.diagnosis.selection.shape_moves import with_best_shapes
from protocols import ParameterRole, PluginError, Signals, hook_of


def include_expected(setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library) -> list[AcceptedModel]:
    """The ladder with each effect that the fleet's prior includes; the end of the search tests it."""
    given, steps = len(steps), list(steps)
    for candidate in library:
        before = steps[-1].fit
        if not candidate.included_a_priori or candidate.name in before.model.names:
            continue
        active = candidate.absent().release(*candidate.of_role(ParameterRole.SHAPE))
        for name, x in candidate.centres.items():
            active = active.moved(name, x)
        model = before.model.with_active([*before.model.active, active])
        fit = setup.fitter.fit(model, before.linearisation, relinearisations=0)
        inflation = max(1.0, min(before.chi2_per_dof, fit.chi2_per_dof))
        gain = log_evidence(fit, inflation) - log_evidence(before, inflation)
        named, note = [candidate.name], "the fleet has it nearly always"
        setup.fitter.trace.record(
            "add", named, before=before, after=fit, measure="log_evidence", score=gain, taken=True, note=note
        )
        steps.append(AcceptedModel(candidate.name, fit, gain))
    if len(steps) > given:
        # Refinements are released once all of these effects are present: a missing one would distort them.
        last = steps[-1]
        state = SearchState(setup, last.fit, last.fit.chi2_per_dof, is_part=False)
        steps[-1] = replace(last, fit=with_best_shapes(state).fit)
    return steps


def include_measured(setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library) -> list[AcceptedModel]:
    """The ladder extended by each effect that measures itself from the readings, where the evidence confirms it.

    Raises
    ------
    PluginError
        If an effect's `measured` fails.
    """
    signals, steps = [piece.signals for piece in setup.prepared.pieces], list(steps)
    for candidate in library:
        before = steps[-1].fit
        active = None if candidate.name in before.model.names else _from_readings(candidate, signals)
        if active is None:
            continue
        fit = setup.fitter.fit(before.model.with_active([*before.model.active, active]))
        gain = 0.5 * (before.chi2 - fit.chi2) / max(fit.chi2_per_dof, 1.0)
        min_gain = fit.criteria.selection.log_evidence
        setup.fitter.trace.record(
            "add",
            [candidate.name],
            before=before,
            after=fit,
            measure="log_evidence",
            score=gain,
            threshold=min_gain,
            taken=gain > min_gain,
            note="its size was measured by the readings alone",
        )
        if gain > min_gain:
            steps.append(AcceptedModel(candidate.name, fit, gain))
    return steps


def _from_readings(candidate: CandidateEffect, signals: Sequence[Signals]) -> EffectTerm | None:
    measured = hook_of(candidate.effect, "measured")
    try:
        found = None if measured is None else measured(signals)
        values = {} if found is None else {name: float(getattr(found, name)) for name in candidate.amplitudes}
    except Exception as error:  # somebody else's code may raise anything
        raise PluginError("effects", candidate.name, f"measured: {type(error).__name__}: {error}") from error
    active = candidate.absent()
    for name, value in values.items():
        active = active.moved(name, standardised(candidate.named(name), value))
    return None if active.is_absent else active
