"""A procedure that finds a set of effects and tells them apart, in place of what another procedure measures.

Offered are the points of that procedure and of the catalogue of contrasts, as far as limits and drive allow. What is
designed from predictions one by one is rehearsed as a whole before it is handed out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.config import Plan, make_plan
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.candidates import Candidate, scaled_library, those_that_can_show
from orchestrator.diagnosis.weak_form.segments import USABLE
from orchestrator.experiment_design.additions import allowed, longer
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
class Designed:
    """A plan, and what it is predicted to tell.

    Attributes
    ----------
    plan : Plan
    stages : list of dict
        What measures, as a procedure has it; `kept` says what stands before and after.
    told : Isolability
        Rehearsed as a whole, of the asked effects alone.
    offered : int
        Points that could be chosen from.
    approximate : ApproximateDesign
    """

    plan: Plan
    stages: list[Stage]
    told: Isolability
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
) -> Designed:
    """The shortest procedure that finds effects and tells them apart.

    Parameters
    ----------
    plan : Plan
        Its motor, limits and all that measures nothing are kept.
    drive : Capabilities
    machine : Machine
    effects : sequence of Effect
        Those to be told.
    size : float
        At which, as a part of what is typical of each.
    noise_a : float, optional
        Standard deviation of a phase current's reading.

    Raises
    ------
    ProcedureError
        Where the plan measures nothing that could be replaced, or nothing that is offered will do.
    """
    criteria, name = criteria or Criteria(), plan.procedure.name
    base = rehearse(plan, drive, machine, noise_a, criteria)
    every = scaled_library(effects, base.setup.prepared.manifest)
    library = those_that_can_show(every, [p.signals for p in base.setup.prepared.pieces])
    offer = _offer(base, drive, machine, library, criteria)
    if beyond := out_of_reach(offer, size, criteria):
        what = ", ".join(f"{q[0]} is not found" if len(q) == 1 else "{} or {}".format(*q) for q in beyond)
        raise ProcedureError(name, "stages", f"nothing that is offered tells, at {size:g} of the typical size: {what}")
    at_least_s = 0.0
    while True:
        found = shortest(offer, size, criteria, at_least_s=at_least_s)
        chosen = [(point, round(n)) for point, n in zip(offer.points, found.times, strict=True) if n > 0]
        stages = stages_of(chosen, plan.procedure.control)
        whole = with_measuring(plan, drive, stages)
        known = information(rehearse(whole, drive, machine, noise_a, criteria), library)
        told = isolability(known, known.total, criteria)
        if not told.beyond(size):
            return Designed(whole, stages, told, len(offer.points), found.approximate)
        at_least_s = 2.0 * max(found.seconds, sum(point.seconds * n for point, n in chosen))
        if at_least_s > MAX_REPEATS * float(np.sum(offer.seconds)):
            raise ProcedureError(name, "stages", f"no plan that does at {size:g} of the typical size was found")


def with_measuring(plan: Plan, drive: Capabilities, stages: Sequence[Stage]) -> Plan:
    """A plan whose measuring stages are others."""
    written = plan.procedure.stages
    before, after = kept(plan)
    more = [StageEntry.model_validate(stage) for stage in stages]
    entries = (*(written[k] for k in before), *more, *(written[k] for k in after))
    return make_plan(plan.procedure.model_copy(update={"stages": entries}), drive)


def kept(plan: Plan) -> tuple[list[int], list[int]]:
    """Places of those stages that measure nothing of the motor, before the first that does with current, and after it.

    Raises
    ------
    ProcedureError
        Where there is no such stage.
    """
    measured = [stage.records_as for stage in plan.stages]
    others = [k for k, kind in enumerate(measured) if kind not in USABLE]
    for first, kind in enumerate(measured):
        if kind in USABLE and kind is not SegmentStage.GATES_OFF:
            return [k for k in others if k < first], [k for k in others if k > first]
    raise ProcedureError(plan.procedure.name, "stages", "none that measures, in whose place others could stand")


def _offer(
    base: Rehearsal, drive: Capabilities, machine: Machine, library: Sequence[Candidate], criteria: Criteria
) -> Offer:
    whole = longer(base.plan, drive, allowed(base.plan, drive, catalogue(base.setup)))
    # What is to be chosen from is not kept out of fits.
    cutting = criteria.weak_form.model_copy(update={"held_out_from": np.iinfo(np.int64).max})
    all_in = criteria.model_copy(update={"weak_form": cutting})
    rehearsal = rehearse(whole, drive, machine, base.noise_a, all_in)
    known = information(rehearsal, library)
    points = {point.id: point for point in rehearsal.plan.points}
    use = [k for k, weight in enumerate(rehearsal.weights) if weight > 0.0]
    chosen = tuple(points[rehearsal.setup.prepared.pieces[k].segment.id] for k in use)
    return Offer(chosen, replace(known, pieces=known.pieces[use], stages=tuple(known.stages[k] for k in use)))
