"""Stages of the catalogue to add to a plan for the effects that it cannot separate, by pairs separated per minute."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from orchestrator.config import Plan, check_plan, make_plan
from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.experiment_design.contrasts import Stage, minutes
from orchestrator.experiment_design.information import Information, information
from orchestrator.experiment_design.isolability import Isolability, required_size
from orchestrator.experiment_design.machine import Machine
from orchestrator.experiment_design.proposal import catalogue
from orchestrator.experiment_design.rehearsal import Rehearsal, rehearse
from protocols import Capabilities, InputError, StageEntry


@dataclass(frozen=True)
class Addition:
    """A stage to add to a plan.

    Attributes
    ----------
    stage : dict
        In a procedure's form.
    minutes : float
    settles : tuple
        Effects (a,) that it makes detectable, and pairs (a, b) that it separates.
    """

    stage: Stage
    minutes: float
    settles: tuple[tuple[str, ...], ...]


def additions(
    rehearsal: Rehearsal,
    drive: Capabilities,
    machine: Machine,
    library: Sequence[CandidateEffect],
    known: Information,
    result: Isolability,
) -> list[Addition]:
    """The stages to add, best first, until none settles another open question; each builds on those before it.

    Parameters
    ----------
    known : Information
        Information of the rehearsal.
    result : Isolability
        Isolability of the rehearsal.
    """
    criteria = rehearsal.setup.prepared.criteria
    size = criteria.rehearsal.parted_size
    questions = result.beyond(size)
    stages = allowed_stages(rehearsal.plan, drive, catalogue(rehearsal.setup)) if questions else []
    if not stages:
        return []
    planned = len(rehearsal.plan.stages)
    rehearsed = rehearse(extended_plan(rehearsal.plan, drive, stages), drive, machine, rehearsal.noise_a, criteria)
    added = range(planned, planned + len(stages))
    gained = information(replace(rehearsed, model=rehearsal.model), library, added)
    normal = known.total
    chosen: list[Addition] = []
    remaining = dict(zip(added, stages, strict=True))
    while questions and remaining:
        options = []
        for index, stage in remaining.items():
            extended = normal + gained.of_stages([index])
            settled = tuple(q for q in questions if required_size(known, extended, q, criteria) <= size)
            options.append((len(settled) / minutes(stage), index, Addition(stage, minutes(stage), settled)))
        _, index, best = max(options, key=lambda option: option[0])
        if not best.settles:
            break
        chosen.append(best)
        normal = normal + gained.of_stages([index])
        questions = [q for q in questions if q not in best.settles]
        del remaining[index]
    return chosen


def allowed_stages(plan: Plan, drive: Capabilities, stages: Sequence[Stage]) -> list[Stage]:
    """The stages that limits and drive allow after a plan, each by itself, without the limits of the whole."""
    allowed = []
    for stage in stages:
        with suppress(InputError):
            check_plan(extended_plan(plan, drive, [stage]), drive)
            allowed.append(stage)
    return allowed


def extended_plan(plan: Plan, drive: Capabilities, stages: Sequence[Stage]) -> Plan:
    """A plan with stages added after its last, without limits of energy and duration."""
    unlimited = plan.procedure.limits.model_copy(update={"energy_j": None, "duration_s": None})
    procedure = plan.procedure.model_copy(update={"limits": unlimited})
    return make_plan(procedure, drive, [StageEntry.model_validate(stage) for stage in stages])
