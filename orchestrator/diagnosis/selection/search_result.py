"""What a search hands on: the models that it accepted, and its findings beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import MAP_RUNGS
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import Contribution
from orchestrator.diagnosis.selection.scoring import LinearView


@dataclass(frozen=True)
class AcceptedModel:
    """One step of the ladder: the effect added, the model with it, and the effect's log evidence [nat]."""

    added: str | None
    fit: Fit
    log_evidence: float = 0.0


@dataclass
class SearchResult:
    """The ladder of models that a search has accepted, and its findings beside them."""

    steps: list[AcceptedModel]
    detected_not_named: list[str] = field(default_factory=list)
    indistinguishable: dict[str, list[str]] = field(default_factory=dict)
    """For an effect of the model, those that fit as well in its place."""
    view: LinearView | None = None
    """Linear view of the last fit; None where it is not known."""
    below_materiality: tuple[str, ...] = ()
    """Effects of the last fit that are too small to be causes."""
    contributions: Mapping[str, Contribution] = field(default_factory=dict)
    """Contribution of each effect of a joint model; empty where effects were added one by one."""

    @property
    def fit(self) -> Fit:
        return self.steps[-1].fit


def baseline_models(steps: Sequence[AcceptedModel]) -> list[AcceptedModel]:
    """The models without any effect: the first, and those that only free the map."""
    return [step for step in steps if step.added is None or step.added in MAP_RUNGS]


def refit_steps(setup: DiagnosisSetup, steps: Sequence[AcceptedModel]) -> list[AcceptedModel]:
    """The models refitted with the setup's noise; as they are where they have it."""
    if all(step.fit.linearisation.noise is setup.fitter.noise for step in steps):
        return list(steps)
    return [replace(step, fit=setup.fitter.fit(step.fit.model)) for step in steps]
