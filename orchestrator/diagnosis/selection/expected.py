"""Effects that a fleet has nearly always: they are in the model before any search begins, as large as there.

A search takes first what explains most by itself, and one effect may stand for two that it knows nothing of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.diagnosis.selection.forward_search import Step
from orchestrator.diagnosis.selection.refining import polished
from orchestrator.diagnosis.selection.scoring import log_evidence
from protocols import ParameterRole


def with_expected(setup: DiagnosisSetup, steps: Sequence[Step], library: Sequence[Candidate]) -> list[Step]:
    """The ladder gone on with each effect that is expected; whether the data bear it out is asked at the end."""
    given, steps = len(steps), list(steps)
    for candidate in library:
        before = steps[-1].fit
        if not candidate.is_expected or candidate.name in before.model.names:
            continue
        active = candidate.absent().freeing(*candidate.of_role(ParameterRole.SHAPE))
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
        # Forms are asked for once all of them are there: another's lack would bend them.
        last = steps[-1]
        fit = polished(setup.fitter, last.fit, max(1.0, last.fit.chi2_per_dof))
        steps[-1] = replace(last, fit=fit)
    return steps
