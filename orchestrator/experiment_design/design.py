"""A procedure that detects and separates a set of effects, in place of another procedure's measuring stages.

The candidate points are those of that procedure and of the catalogue of contrasts, as far as limits and drive allow.
The design comes from predictions point by point and is rehearsed as a whole before it is returned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.config import Plan, make_plan
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, observable_effects, scaled_library
from orchestrator.diagnosis.weak_form.preparation import USABLE
from orchestrator.experiment_design.additions import allowed_stages, extended_plan
from orchestrator.experiment_design.contrasts import Stage
from orchestrator.experiment_design.information import information
from orchestrator.experiment_design.isolability import Isolability, isolability
from orchestrator.experiment_design.machine import Machine
from orchestrator.experiment_design.optimal import ApproximateDesign
from orchestrator.experiment_design.proposal import catalogue
from orchestrator.experiment_design.rehearsal import Rehearsal, rehearse
from orchestrator.experiment_design.shortest import MAX_REPEATS, Offer, out_of_reach, shortest
from orchestrator.experiment_design.writing import stages_of
from protocols import Capabilities, Effect, ProcedureError, SegmentStage, StageEntry


@dataclass(frozen=True)
class ProcedureDesign:
    """A designed plan and its predicted isolability.

    Attributes
    ----------
    plan : Plan
    stages : list of dict
        The measuring stages, in a procedure's form; `other_stages` gives those before and after.
    isolability : Isolability
        Of the wanted effects alone, rehearsed as a whole.
    offered : int
        Number of candidate points.
    approximate : ApproximateDesign
    """

    plan: Plan
    stages: list[Stage]
    isolability: Isolability
    offered: int
    approximate: ApproximateDesign


def design(
    plan: Plan,
    drive: Capabilities,
    machine: Machine,
    effects: Sequence[Effect],
    *,
    size: float = 1.0,
    noise_a: float | None = None,
    criteria: Criteria | None = None,
) -> ProcedureDesign:
    """The shortest procedure that detects effects and separates them.

    Parameters
    ----------
    plan : Plan
        Its motor, its limits and its stages that measure nothing are kept.
    drive : Capabilities
    machine : Machine
    effects : sequence of Effect
        The effects to separate.
    size : float
        The size to detect, as a part of each effect's typical size.
    noise_a : float, optional
        Standard deviation of a phase current's reading.

    Raises
    ------
    ProcedureError
        Where the plan has no measuring stage to replace, or the candidate points do not suffice.
    """
    criteria, name = criteria or Criteria(), plan.procedure.name
    base = rehearse(plan, drive, machine, noise_a, criteria)
    every = scaled_library(effects, base.setup.prepared.manifest)
    library = observable_effects(every, [p.signals for p in base.setup.prepared.pieces])
    offer = _offer(base, drive, machine, library, criteria)
    if beyond := out_of_reach(offer, size, criteria):
        what = ", ".join(f"{q[0]} is not detected" if len(q) == 1 else "{} or {}".format(*q) for q in beyond)
        problem = f"the available points do not decide, at {size:g} of the typical size: {what}"
        raise ProcedureError(name, "stages", problem)
    at_least_s = 0.0
    while True:
        shortest_plan = shortest(offer, size, criteria, at_least_s=at_least_s)
        chosen = [(point, round(n)) for point, n in zip(offer.points, shortest_plan.times, strict=True) if n > 0]
        stages = stages_of(chosen, plan.procedure.control)
        whole = with_measuring(plan, drive, stages)
        known = information(rehearse(whole, drive, machine, noise_a, criteria), library)
        result = isolability(known, known.total, criteria)
        if not result.beyond(size):
            return ProcedureDesign(whole, stages, result, len(offer.points), shortest_plan.approximate)
        at_least_s = 2.0 * max(shortest_plan.seconds, sum(point.seconds * n for point, n in chosen))
        if at_least_s > MAX_REPEATS * float(np.sum(offer.seconds)):
            raise ProcedureError(name, "stages", f"no plan suffices at {size:g} of the typical size")


def with_measuring(plan: Plan, drive: Capabilities, stages: Sequence[Stage]) -> Plan:
    """A plan with its measuring stages replaced."""
    written = plan.procedure.stages
    before, after = other_stages(plan)
    more = [StageEntry.model_validate(stage) for stage in stages]
    entries = (*(written[k] for k in before), *more, *(written[k] for k in after))
    return make_plan(plan.procedure.model_copy(update={"stages": entries}), drive)


def other_stages(plan: Plan) -> tuple[list[int], list[int]]:
    """Indices of the stages that do not measure the motor, before and after the first that measures with current.

    Raises
    ------
    ProcedureError
        Where no stage measures.
    """
    measured = [stage.records_as for stage in plan.stages]
    others = [k for k, kind in enumerate(measured) if kind not in USABLE]
    for first, kind in enumerate(measured):
        if kind in USABLE and kind is not SegmentStage.GATES_OFF:
            return [k for k in others if k < first], [k for k in others if k > first]
    raise ProcedureError(plan.procedure.name, "stages", "none that measures, which the design could replace")


def _offer(
    base: Rehearsal, drive: Capabilities, machine: Machine, library: Sequence[CandidateEffect], criteria: Criteria
) -> Offer:
    whole = extended_plan(base.plan, drive, allowed_stages(base.plan, drive, catalogue(base.setup)))
    # Candidate points are not held out of fits.
    cutting = criteria.weak_form.model_copy(update={"held_out_from": np.iinfo(np.int64).max})
    all_in = criteria.model_copy(update={"weak_form": cutting})
    rehearsal = rehearse(whole, drive, machine, base.noise_a, all_in)
    known = information(rehearsal, library)
    points = {point.id: point for point in rehearsal.plan.points}
    use = [k for k, weight in enumerate(rehearsal.weights) if weight > 0.0]
    chosen = tuple(points[rehearsal.setup.prepared.pieces[k].segment.id] for k in use)
    return Offer(chosen, replace(known, pieces=known.pieces[use], stages=tuple(known.stages[k] for k in use)))
