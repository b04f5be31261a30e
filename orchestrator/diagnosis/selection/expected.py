"""Effects that a fleet has nearly always: they are in the model before any search begins, as large as there.

A search takes first what explains most by itself, and one effect may stand for two that it knows nothing of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.diagnosis.selection.forward_search import Step
from orchestrator.diagnosis.selection.refining import refit_newest
from orchestrator.diagnosis.selection.scoring import log_evidence
from protocols import ParameterRole


def include_expected(setup: DiagnosisSetup, steps: Sequence[Step], library: Sequence[CandidateEffect]) -> list[Step]:
    """The ladder with each effect that the fleet includes a priori; the end of the search tests it."""
    given, steps = len(steps), list(steps)
    for candidate in library:
        before = steps[-1].fit
        if not candidate.included_a_priori or candidate.name in before.model.names:
            continue
        active = candidate.absent().release(*candidate.of_role(ParameterRole.SHAPE))
        for name, x in candidate.centres.items():
            active = active.moved(name, x)
        fit = setup.fitter.fit(before.model.with_active([*before.model.active, active]), before.frame, renewals=0)
        inflation = max(1.0, min(before.chi2_per_dof, fit.chi2_per_dof))
        gain = log_evidence(fit, inflation) - log_evidence(before, inflation)
        named, note = [candidate.name], "the fleet has it nearly always"
        setup.fitter.trace.record(
            "add", named, before=before, after=fit, measure="log_evidence", score=gain, taken=True, note=note
        )
        steps.append(Step(candidate.name, fit, gain))
    if len(steps) > given:
        # Refinements are released once all of these effects are present: a missing one would distort them.
        last = steps[-1]
        fit = refit_newest(setup.fitter, last.fit, max(1.0, last.fit.chi2_per_dof))
        steps[-1] = replace(last, fit=fit)
    return steps
