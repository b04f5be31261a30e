"""What a run is to do and how far it is: plan, appended stages, points measured. Measures nothing itself."""

from __future__ import annotations

from collections.abc import Sequence

from orchestrator.config import Plan, PlannedPoint, check_plan, check_point, make_plan
from orchestrator.engine._probing import factor_of
from orchestrator.runs import RunDirectory
from protocols import Capabilities, Excitation, PluginError, Segment, Stage, StageEntry, StagesAppended, StageSufficed


class PointQueue:
    """The stages of one run, in order, and how far it is with them.

    Attributes
    ----------
    plan : Plan
        Grows when stages are appended.
    done : dict of str to Segment
        The points that are measured, by id.
    appended : int
        How many times stages were appended.
    """

    def __init__(self, run: RunDirectory, plan: Plan, capabilities: Capabilities) -> None:
        self._run, self._capabilities = run, capabilities
        self.plan = plan
        self.done = dict(run.completed())
        self._appended = list(run.appended())
        self._sufficed = set(run.sufficed())
        self._resumed_at = self._first_not_passed()
        self._spared = sum(p.stage_index in self._sufficed and p.id not in self.done for p in plan.points)
        self._left_s = self._planned_s()

    @property
    def stages(self) -> Sequence[Stage]:
        """Filled."""
        return self.plan.stages

    @property
    def appended(self) -> int:
        return len(self._appended)

    @property
    def points(self) -> int:
        """How many there are, without those that turned out not to be needed."""
        return len(self.plan.points) - self._spared

    @property
    def seconds_left(self) -> float:
        """Planned time of what is not done yet, on the drive's clock."""
        return max(0.0, self._left_s)

    def mark_done(self, point: PlannedPoint, segment: Segment) -> None:
        """A point of the plan is done."""
        self.done[point.id] = segment
        self._left_s -= point.seconds

    def points_left(self, index: int) -> list[PlannedPoint]:
        """The points of a stage that are not done and may be needed."""
        return [point for point in self.plan.points_of(index) if self._is_left(point)]

    def allowed(self, point: PlannedPoint, excitation: Excitation) -> PlannedPoint:
        """The point as a stage wants it run; `InputError` where that is more than plan, limits or drive allow."""
        if excitation == point.excitation:
            return point
        changed = point.run_as(excitation)
        if excitation.kind != point.excitation.kind or changed.seconds > point.seconds * (1.0 + 1e-9):
            stage = self.stages[point.stage_index].name
            raise PluginError("stages", stage, f"{point.id} is run as another kind of excitation, or a longer one")
        check_point(self.plan, changed, self._capabilities)
        return changed

    def suffice(self, index: int) -> StageSufficed:
        """What a stage has measured is enough."""
        spared = self.points_left(index)
        self._sufficed.add(index)
        seconds = sum(point.seconds for point in spared)
        self._spared += len(spared)
        self._left_s -= seconds
        return StageSufficed(index=index, points_spared=len(spared), seconds_spared=seconds)

    def factor(self, index: int) -> float | None:
        """By how much the injection of a stage is weaker than planned; None where nothing of it is measured yet."""
        every = (factor_of(point, self.done[point.id]) for point in self.plan.points_of(index) if point.id in self.done)
        return next((factor for factor in every if factor is not None), None)

    def passed(self, index: int) -> bool:
        """Whether the run passed this stage before it was resumed: its questions and results are in the journal."""
        return index < self._resumed_at or any(
            point.id in self.done for point in self.plan.points if point.stage_index > index
        )

    def has_work(self, index: int) -> bool:
        """Whether a stage has to work on what is measured, and did not in an earlier life where the journal has it."""
        stage = self.stages[index]
        if not self.passed(index):
            return True
        return not stage.journalled and not any(type(later) is type(stage) for later in self.stages[index + 1 :])

    def end_of_appended(self, index: int) -> int | None:
        """The stage after those that were appended together with this one; None where the procedure has it."""
        end = len(self.stages)
        for message in reversed(self._appended):
            first = end - len(message.stages)
            if first <= index < end:
                return end
            end = first
        return None

    def longer(self, more: Sequence[StageEntry]) -> Plan:
        """The plan with these stages at its end; raises `InputError` where limits or drive do not allow them."""
        before = [stage for message in self._appended for stage in message.stages]
        plan = make_plan(self._run.procedure(), self._capabilities, (*before, *more))
        check_plan(plan, self._capabilities)
        return plan

    def append(self, message: StagesAppended, plan: Plan) -> None:
        """Go on with these stages, as `longer` has planned them and the journal knows them."""
        self._appended.append(message)
        self.plan = plan
        self._left_s = self._planned_s()

    def _first_not_passed(self) -> int:
        """A stage that has appended others is passed; all stages are where a person appended to a finished run."""
        place = len(self.stages) - sum(len(message.stages) for message in self._appended)
        first = 0
        for message in self._appended:
            first = max(first, place if message.by is None else message.by + 1)
            place += len(message.stages)
        return first

    def _planned_s(self) -> float:
        return sum(point.seconds for point in self.plan.points if self._is_left(point))

    def _is_left(self, point: PlannedPoint) -> bool:
        return point.id not in self.done and point.stage_index not in self._sufficed
