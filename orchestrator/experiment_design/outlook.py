"""A report on the effects that a plan will detect and separate, in an engineer's units, and on stages to add."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from orchestrator.config import Plan
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import (
    CandidateEffect,
    observable_effects,
    scaled_library,
    typical_standardised_value,
    value_at,
)
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds, separating_contrasts
from orchestrator.experiment_design.additions import additions
from orchestrator.experiment_design.information import information
from orchestrator.experiment_design.isolability import Isolability, isolability
from orchestrator.experiment_design.machine import Machine
from orchestrator.experiment_design.rehearsal import Rehearsal, rehearse
from protocols import Capabilities, Contrast, Effect, Strict


class EffectOutlook(Strict):
    """Detection of one effect. Sizes are relative to the typical one; None: no size suffices."""

    name: str
    parameter: str
    """The first of its amplitudes."""
    unit: str
    typical: float
    """That parameter's typical value for this machine."""
    least: float | None
    """Its value from which the effect is detected."""
    found_from: float | None
    """Size from which the effect is detected, where it is alone."""
    among_all_from: float | None
    """Size from which it is detected, where every other effect may be present as well."""


class PairOutlook(Strict):
    """Separation of two effects."""

    effects: tuple[str, str]
    parted_from: float | None
    """Size from which both are separated, relative to the typical one. None: no size suffices."""


class AdditionOutlook(Strict):
    """A stage to add."""

    stage: dict[str, Any]
    minutes: float
    settles: tuple[tuple[str, ...], ...]
    """Effects that it makes detectable, and pairs that it separates, at their typical size."""


class OpenOutlook(Strict):
    """An effect not detected at its typical size, or a pair not separated, whatever stage is added."""

    effects: tuple[str, ...]
    needs: tuple[str, ...]
    """Contrasts that both effects declare as needed and that the plan lacks."""


class IsolabilityReport(Strict):
    """Isolability of a plan's effects, before it is measured."""

    procedure: str
    noise_a: float
    """Standard deviation of a phase current's reading in the rehearsal."""
    effects: tuple[EffectOutlook, ...]
    pairs: tuple[PairOutlook, ...]
    additions: tuple[AdditionOutlook, ...]
    open: tuple[OpenOutlook, ...]

    def parted_from(self, first: str, second: str) -> float | None:
        """Size from which a pair, in either order, is separated."""
        return next(p.parted_from for p in self.pairs if {first, second} == set(p.effects))


def outlook(
    plan: Plan,
    drive: Capabilities,
    machine: Machine,
    effects: Sequence[Effect],
    *,
    noise_a: float | None = None,
    criteria: Criteria | None = None,
) -> IsolabilityReport:
    """Rehearse a plan, and report the effects that it will detect and separate.

    Parameters
    ----------
    plan : Plan
    drive : Capabilities
    machine : Machine
    effects : sequence of Effect
        The library.
    noise_a : float, optional
        Standard deviation of a phase current's reading.

    Raises
    ------
    InputError
        Where nothing in the plan can be diagnosed, or an effect cannot be fitted.
    """
    criteria = criteria or Criteria()
    rehearsal = rehearse(plan, drive, machine, noise_a, criteria)
    every = scaled_library(effects, rehearsal.setup.prepared.manifest)
    library = observable_effects(every, [p.signals for p in rehearsal.setup.prepared.pieces])
    plan_information = information(rehearsal, library)
    result = isolability(plan_information, plan_information.total, criteria)
    proposed = additions(rehearsal, drive, machine, library, plan_information, result)
    settled = {question for addition in proposed for question in addition.settles}
    unsettled = [question for question in result.beyond(criteria.rehearsal.parted_size) if question not in settled]
    return IsolabilityReport(
        procedure=plan.procedure.name,
        noise_a=rehearsal.noise_a,
        effects=tuple(_outlook_of(candidate, result) for candidate in library),
        pairs=tuple(PairOutlook(effects=pair, parted_from=_finite(size)) for pair, size in result.separation.items()),
        additions=tuple(AdditionOutlook(stage=a.stage, minutes=a.minutes, settles=a.settles) for a in proposed),
        open=tuple(OpenOutlook(effects=q, needs=_needs(rehearsal, library, q)) for q in unsettled),
    )


def _outlook_of(candidate: CandidateEffect, result: Isolability) -> EffectOutlook:
    p, size = candidate.named(candidate.amplitudes[0]), result.detection[candidate.name]
    least = value_at(p, size * typical_standardised_value(p)) if math.isfinite(size) else None
    return EffectOutlook(
        name=candidate.name,
        parameter=p.name,
        unit=p.unit,
        typical=p.typical,
        least=least,
        found_from=_finite(size),
        among_all_from=_finite(result.among_all[candidate.name]),
    )


def _finite(size: float) -> float | None:
    return size if math.isfinite(size) else None


def _needs(rehearsal: Rehearsal, library: Sequence[CandidateEffect], question: tuple[str, ...]) -> tuple[str, ...]:
    """The contrasts that the effects declare as needed and that this plan lacks."""
    effects = [candidate.effect for candidate in library if candidate.name in question]
    wanted: tuple[Contrast, ...] = separating_contrasts(effects[0], effects[-1])
    return tuple(CONTRASTS[c].text for c in wanted if not holds(rehearsal.setup.prepared, c))
