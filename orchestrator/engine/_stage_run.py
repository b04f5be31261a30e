"""The engine's interface for one stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._operator import Questions
from orchestrator.engine._plugins import UsedPlugins
from orchestrator.engine._point_queue import PointQueue
from orchestrator.engine._power import PowerStage
from orchestrator.engine._states import StateMachine, Trigger, table_of
from orchestrator.formatting.events import DISARMED_WHILE
from orchestrator.recording import Recording, open_recording
from orchestrator.runs import RunDirectory
from protocols import (
    Capabilities,
    EstimationReport,
    Message,
    Note,
    Procedure,
    Segment,
    StageEntry,
    StagesAppended,
    StageState,
    Telemetry,
)


@dataclass(frozen=True)
class Engine:
    """Components of a run; each has its own module."""

    run: RunDirectory
    capabilities: Capabilities
    queue: PointQueue
    machine: StateMachine
    power: PowerStage
    log: RunLog
    questions: Questions
    interrupts: Interrupts
    plugins: UsedPlugins

    def stand_down(self, reason: str) -> None:
        """Disarm an armed drive and publish the result; raises where it may still be armed."""
        if self.power.armed:
            self.machine.fire(Trigger.STOP, reason)
            message, unsafe = self.power.stand_down(), self.power.unsafe
            self.log.publish(Note(level="info" if unsafe is None else "error", text=message))
            if unsafe is not None:
                raise unsafe


class EngineContext:
    """`protocols.StageRun` for one stage of a run."""

    def __init__(self, index: int, engine: Engine, conclude: Callable[[EstimationReport], None]) -> None:
        self._index, self._engine, self._conclude = index, engine, conclude

    @property
    def path(self) -> Path:
        return self._engine.run.path

    @property
    def procedure(self) -> Procedure:
        return self._engine.queue.plan.procedure

    @property
    def capabilities(self) -> Capabilities:
        return self._engine.capabilities

    @property
    def segments(self) -> Sequence[Segment]:
        queue = self._engine.queue
        return [queue.done[point.id] for point in queue.plan.points_of(self._index) if point.id in queue.done]

    @property
    def appended(self) -> int:
        return self._engine.queue.appended

    def recording(self) -> Recording:
        self._engine.run.write_manifest()
        return open_recording(self._engine.run.path)

    def plugins(self, kind: Literal["estimators", "effects"]) -> Sequence[Any]:
        return self._engine.plugins.of(kind)

    def telemetry(self) -> Telemetry:
        return self._engine.power.telemetry()

    def enter(self, state: StageState) -> None:
        # Disarm first: the duration of a computation on a busy machine is unknown.
        self._engine.stand_down(f"{DISARMED_WHILE} the computer works on what was measured")
        self._engine.machine.fire(state.trigger)

    def publish(self, message: Message, *, durable: bool = False) -> None:
        self._engine.log.publish(message, durable=durable)

    say = publish
    """The former name, for stages that call it."""

    def ask(self, prompt: str, *, answered: bool) -> None:
        self._engine.stand_down(f"{DISARMED_WHILE} the operator answers")
        self._engine.machine.fire(Trigger.ASK_OPERATOR)
        self._engine.questions.put(prompt, answered=answered)

    def set_brake(self, engaged: bool) -> None:
        self._engine.power.set_brake(engaged)

    def check(self) -> None:
        self._engine.interrupts.check()

    def plan(self, stages: Sequence[StageEntry]) -> None:
        self._engine.queue.extended_plan(stages)

    def append(self, stages: Sequence[StageEntry]) -> None:
        engine = self._engine
        plan = engine.queue.extended_plan(stages)
        engine.plugins.take(plan.stages)
        table = table_of(plan.stages)
        message = StagesAppended(by=self._index, stages=tuple(stages))
        engine.log.publish(message, durable=True)
        engine.queue.append(message, plan)
        engine.machine.extend(table)

    def conclude(self, estimates: EstimationReport) -> None:
        self._conclude(estimates)
