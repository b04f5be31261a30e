"""The answer to what a plan will be able to tell, in an engineer's units, and what to add to it. Decides nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from orchestrator.config import Plan
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import (
    Candidate,
    scaled_library,
    those_that_can_show,
    typical_coordinate,
    value_at,
)
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds
from orchestrator.diagnosis.selection.identifiability import parted_by
from orchestrator.experiment_design.additions import additions
from orchestrator.experiment_design.information import information
from orchestrator.experiment_design.isolability import Isolability, isolability
from orchestrator.experiment_design.machine import Machine
from orchestrator.experiment_design.rehearsal import Rehearsal, rehearse
from protocols import Capabilities, Contrast, Effect, Strict


class EffectOutlook(Strict):
    """How well one effect will be seen. Sizes are parts of the typical one; None: no size will do."""

    name: str
    parameter: str
    """The first of its amplitudes, ..."""
    unit: str
    typical: float
    """... its typical value for this machine, ..."""
    least: float | None
    """... and the one from which it is found."""
    found_from: float | None
    """Size, where it is alone."""
    among_all_from: float | None
    """Size, where every other effect may be there as well."""


class PairOutlook(Strict):
    """How well two effects will be told apart."""

    effects: tuple[str, str]
    parted_from: float | None
    """Size, as a part of what is typical; of the one that is told worse. None: no size will do."""


class AdditionOutlook(Strict):
    """A stage to add."""

    stage: dict[str, Any]
    minutes: float
    settles: tuple[tuple[str, ...], ...]
    """Effects that are found with it, and pairs that are told apart, at their typical size."""


class OpenOutlook(Strict):
    """An effect that is not found at its typical size, or a pair that is not told apart, whatever stage is added."""

    effects: tuple[str, ...]
    needs: tuple[str, ...]
    """Contrasts that the plan lacks and that both say they need."""


class IsolabilityReport(Strict):
    """What a plan will be able to tell, before it is measured."""

    procedure: str
    noise_a: float
    """Standard deviation of a phase current's reading that it was rehearsed with."""
    effects: tuple[EffectOutlook, ...]
    pairs: tuple[PairOutlook, ...]
    additions: tuple[AdditionOutlook, ...]
    open: tuple[OpenOutlook, ...]

    def parted_from(self, first: str, second: str) -> float | None:
        """Of a pair, in either order."""
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
    """Rehearse a plan, and say which effects it will find and tell apart.

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
        Where the plan holds nothing that can be diagnosed, or an effect cannot be fitted.
    """
    criteria = criteria or Criteria()
    rehearsal = rehearse(plan, drive, machine, noise_a, criteria)
    every = scaled_library(effects, rehearsal.setup.prepared.manifest)
    library = those_that_can_show(every, [p.signals for p in rehearsal.setup.prepared.pieces])
    known = information(rehearsal, library)
    told = isolability(known, known.total, criteria)
    more = additions(rehearsal, drive, machine, library, known, told)
    settled = {question for addition in more for question in addition.settles}
    left = [question for question in told.beyond(criteria.rehearsal.parted_size) if question not in settled]
    return IsolabilityReport(
        procedure=plan.procedure.name,
        noise_a=rehearsal.noise_a,
        effects=tuple(_outlook_of(candidate, told) for candidate in library),
        pairs=tuple(PairOutlook(effects=pair, parted_from=_known(size)) for pair, size in told.parted.items()),
        additions=tuple(AdditionOutlook(stage=a.stage, minutes=a.minutes, settles=a.settles) for a in more),
        open=tuple(OpenOutlook(effects=q, needs=_needs(rehearsal, library, q)) for q in left),
    )


def _outlook_of(candidate: Candidate, told: Isolability) -> EffectOutlook:
    p, size = candidate.named(candidate.amplitudes[0]), told.found[candidate.name]
    least = value_at(p, size * typical_coordinate(p)) if math.isfinite(size) else None
    return EffectOutlook(
        name=candidate.name,
        parameter=p.name,
        unit=p.unit,
        typical=p.typical,
        least=least,
        found_from=_known(size),
        among_all_from=_known(told.among_all[candidate.name]),
    )


def _known(size: float) -> float | None:
    return size if math.isfinite(size) else None


def _needs(rehearsal: Rehearsal, library: Sequence[Candidate], question: tuple[str, ...]) -> tuple[str, ...]:
    """What they say themselves that it takes, where this plan has none of it."""
    effects = [candidate.effect for candidate in library if candidate.name in question]
    wanted: tuple[Contrast, ...] = parted_by(effects[0], effects[-1])
    return tuple(CONTRASTS[c].text for c in wanted if not holds(rehearsal.setup.prepared, c))
