"""What to add to a plan for those effects that it cannot part: stages of the catalogue, by pairs parted a minute."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from orchestrator.config import Plan, check_plan, make_plan
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.experiment_design.contrasts import Stage, minutes
from orchestrator.experiment_design.information import Information, information
from orchestrator.experiment_design.isolability import Isolability, answer
from orchestrator.experiment_design.machine import Machine
from orchestrator.experiment_design.proposal import catalogue
from orchestrator.experiment_design.rehearsal import Rehearsal, rehearse
from protocols import Capabilities, InputError, StageEntry


@dataclass(frozen=True)
class Addition:
    """A stage that is worth its time.

    Attributes
    ----------
    stage : dict
        As a procedure has it.
    minutes : float
    settles : tuple
        Effects (a,) that are found with it, and pairs (a, b) that are told apart.
    """

    stage: Stage
    minutes: float
    settles: tuple[tuple[str, ...], ...]


def additions(
    rehearsal: Rehearsal,
    drive: Capabilities,
    machine: Machine,
    library: Sequence[Candidate],
    known: Information,
    told: Isolability,
) -> list[Addition]:
    """The stages to add, best first, until none settles any more of what is open; each counts on those before it.

    Parameters
    ----------
    known : Information
        Of the rehearsal.
    told : Isolability
        By all of it.
    """
    criteria = rehearsal.setup.prepared.criteria
    size = criteria.rehearsal.parted_size
    questions = told.beyond(size)
    stages = allowed(rehearsal.plan, drive, catalogue(rehearsal.setup)) if questions else []
    if not stages:
        return []
    own = len(rehearsal.plan.stages)
    rehearsed = rehearse(longer(rehearsal.plan, drive, stages), drive, machine, rehearsal.noise_a, criteria)
    added = range(own, own + len(stages))
    brings = information(replace(rehearsed, model=rehearsal.model), library, added)
    normal = known.total
    found: list[Addition] = []
    left = dict(zip(added, stages, strict=True))
    while questions and left:
        options = []
        for index, stage in left.items():
            more = normal + brings.of_stages([index])
            settled = tuple(q for q in questions if answer(known, more, q, criteria) <= size)
            options.append((len(settled) / minutes(stage), index, Addition(stage, minutes(stage), settled)))
        _, index, best = max(options, key=lambda option: option[0])
        if not best.settles:
            break
        found.append(best)
        normal = normal + brings.of_stages([index])
        questions = [q for q in questions if q not in best.settles]
        del left[index]
    return found


def allowed(plan: Plan, drive: Capabilities, stages: Sequence[Stage]) -> list[Stage]:
    """Those stages that limits and drive allow after a plan, each by itself, whatever the whole comes to."""
    return [stage for stage in stages if _is_allowed(plan, drive, stage)]


def longer(plan: Plan, drive: Capabilities, stages: Sequence[Stage]) -> Plan:
    """A plan with stages after its last."""
    free = plan.procedure.limits.model_copy(update={"energy_j": None, "duration_s": None})
    procedure = plan.procedure.model_copy(update={"limits": free})
    return make_plan(procedure, drive, [StageEntry.model_validate(stage) for stage in stages])


def _is_allowed(plan: Plan, drive: Capabilities, stage: Stage) -> bool:
    try:
        check_plan(longer(plan, drive, [stage]), drive)
    except InputError:
        return False
    return True
