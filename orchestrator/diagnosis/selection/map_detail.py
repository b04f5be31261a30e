"""The map made finer in the course of a search, and the record of it."""

from __future__ import annotations

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, with_finest_map
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit


def record_finest_map(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """The same model on the finest map that is worth its freedom; the fit itself where none is."""
    finer = with_finest_map(setup, fitter, fit)
    if finer is fit:
        fitter.trace.record("finer_map", before=fit, taken=False)
    else:
        gain = fit.objective - finer.objective
        fitter.trace.record("finer_map", before=fit, after=finer, measure="objective", score=gain, taken=True)
    return finer
