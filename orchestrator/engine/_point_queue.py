"""Plan and progress of a run: stages, appended stages, measured points."""

from __future__ import annotations

from collections.abc import Sequence

from orchestrator.config import Plan, PlannedPoint, check_plan, check_point, make_plan
from orchestrator.engine._probing import measured_scale
from orchestrator.runs import RunDirectory
from protocols import Capabilities, Excitation, PluginError, Segment, Stage, StageEntry, StagesAppended, StageSufficed


class PointQueue:
    """The stages of one run, in order, and their progress.

    Attributes
    ----------
    plan : Plan
        Grows when stages are appended.
    done : dict of str to Segment
        Measured points, by id.
    appended : int
        Number of times that stages were appended.
    """

    def __init__(self, run: RunDirectory, plan: Plan, capabilities: Capabilities) -> None:
        self._run, self._capabilities = run, capabilities
        self.plan = plan
        self.done = dict(run.completed())
        self._appended = list(run.appended())
        self._sufficed = set(run.sufficed())
        self._resumed_at = self._first_not_passed()
        self._spared = sum(p.stage_index in self._sufficed and p.id not in self.done for p in plan.points)
        self._remaining_s = self._planned_s()

    @property
    def stages(self) -> Sequence[Stage]:
        """The plan's stages, with all settings."""
        return self.plan.stages

    @property
    def appended(self) -> int:
        return len(self._appended)

    @property
    def points(self) -> int:
        """Number of points, without those that turned out not to be needed."""
        return len(self.plan.points) - self._spared

    @property
    def seconds_left(self) -> float:
        """Planned time of the remaining points on the drive's clock [s]."""
        return max(0.0, self._remaining_s)

    def mark_done(self, point: PlannedPoint, segment: Segment) -> None:
        """Record a measured point."""
        self.done[point.id] = segment
        self._remaining_s -= point.seconds

    def points_left(self, index: int) -> list[PlannedPoint]:
        """The points of a stage that are not done and may be needed."""
        return [point for point in self.plan.points_of(index) if self._remains(point)]

    def validated(self, point: PlannedPoint, excitation: Excitation) -> PlannedPoint:
        """The point with a stage's changed excitation; `InputError` where it exceeds plan, limits or drive."""
        if excitation == point.excitation:
            return point
        changed = point.run_as(excitation)
        if excitation.kind != point.excitation.kind or changed.seconds > point.seconds * (1.0 + 1e-9):
            stage = self.stages[point.stage_index].name
            raise PluginError("stages", stage, f"{point.id} is run as another kind of excitation, or a longer one")
        check_point(self.plan, changed, self._capabilities)
        return changed

    def finish_early(self, index: int) -> StageSufficed:
        """End a stage early: its remaining points are not needed."""
        spared = self.points_left(index)
        self._sufficed.add(index)
        seconds = sum(point.seconds for point in spared)
        self._spared += len(spared)
        self._remaining_s -= seconds
        return StageSufficed(index=index, points_spared=len(spared), seconds_spared=seconds)

    def injection_scale(self, index: int) -> float | None:
        """Injection of a stage over the planned one; None before its first measured point."""
        scales = (measured_scale(p, self.done[p.id]) for p in self.plan.points_of(index) if p.id in self.done)
        return next((scale for scale in scales if scale is not None), None)

    def passed(self, index: int) -> bool:
        """Whether the run passed this stage before it was resumed: its questions and results are in the journal."""
        return index < self._resumed_at or any(
            point.id in self.done for point in self.plan.points if point.stage_index > index
        )

    def has_work(self, index: int) -> bool:
        """Whether a stage still has to evaluate its points: not if the journal already holds the result."""
        stage = self.stages[index]
        if not self.passed(index):
            return True
        return not stage.journalled and not any(type(later) is type(stage) for later in self.stages[index + 1 :])

    def end_of_appended(self, index: int) -> int | None:
        """Index after the stages that were appended together with this one; None for a stage of the procedure."""
        end = len(self.stages)
        for message in reversed(self._appended):
            first = end - len(message.stages)
            if first <= index < end:
                return end
            end = first
        return None

    def extended_plan(self, more: Sequence[StageEntry]) -> Plan:
        """The plan with these stages appended; raises `InputError` where they exceed limits or drive."""
        before = [stage for message in self._appended for stage in message.stages]
        plan = make_plan(self._run.procedure(), self._capabilities, (*before, *more))
        check_plan(plan, self._capabilities)
        return plan

    def append(self, message: StagesAppended, plan: Plan) -> None:
        """Adopt appended stages that `extended_plan` has planned and the journal holds."""
        self._appended.append(message)
        self.plan = plan
        self._remaining_s = self._planned_s()

    def _first_not_passed(self) -> int:
        """Index of the first stage not passed: stages that appended others, and all of a finished run, are passed."""
        place = len(self.stages) - sum(len(message.stages) for message in self._appended)
        first = 0
        for message in self._appended:
            first = max(first, place if message.by is None else message.by + 1)
            place += len(message.stages)
        return first

    def _planned_s(self) -> float:
        return sum(point.seconds for point in self.plan.points if self._remains(point))

    def _remains(self, point: PlannedPoint) -> bool:
        return point.id not in self.done and point.stage_index not in self._sufficed
