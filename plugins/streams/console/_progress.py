"""What the messages of a run add up to: where it stands, and how long it will take. Shows nothing."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from protocols import (
    Message,
    PointDone,
    PointStarted,
    ResistanceEstimate,
    ResistanceEstimated,
    RunStarted,
    StagesAppended,
    StageStarted,
    StageSufficed,
    StateChanged,
    UnderWay,
)

Point = tuple[float, float]
WITHOUT_POINTS = ("stopping", "finished", "faulted", "aborted")
"""States that end a stage of measuring: every way out of it leads through the first."""


@dataclass
class StageProgress:
    """One stage of the run."""

    index: int
    name: str
    """As people call it."""
    points: int
    begun_s: float
    """On the wall clock."""
    done: int = 0
    drive_s: float = 0.0
    """Planned time on the drive's clock of the points done."""


@dataclass
class Progress:
    """A run so far, as its messages tell it, in whichever order they come.

    Attributes
    ----------
    run : Path
        The run directory.
    clock : callable
        Seconds on the wall; replaced in tests.
    stages : int
        How many the procedure has.
    drive_s, left_s : float
        Planned time on the drive's clock: of what has been measured since the start or resumption, and of the rest.
    """

    run: Path = Path()
    clock: Callable[[], float] = time.monotonic
    name: str = ""
    state: str = "idle"
    stages: int = 0
    points: int = 0
    points_done: int = 0
    stage: StageProgress | None = None
    finished: StageProgress | None = None
    """The stage that the latest message has ended."""
    point: str = ""
    target: Point | None = None
    achieved: Point | None = None
    resistance: ResistanceEstimate | None = None
    drive_s: float = 0.0
    left_s: float = 0.0
    begun_s: float = field(default=0.0)
    measuring_s: float = 0.0
    """Time on the wall that the points done have taken."""
    work: str = ""
    """What the computer is at work on."""
    _point_begun_s: float | None = None
    _point_s: float = 0.0

    def take(self, message: Message) -> None:
        """Take one message in."""
        self.finished = None
        if isinstance(message, RunStarted):
            self._start(message)
        elif isinstance(message, StateChanged):
            self.state = message.target
            # The drive is disarmed while the computer works on a stage that measures nothing: that goes on.
            goes_on = message.target == "stopping" and self.stage is not None and not self.stage.points
            if message.target in WITHOUT_POINTS and not goes_on:
                self._end_stage()
        elif isinstance(message, StageStarted):
            self._end_stage()
            name = message.title or message.stage.replace("_", " ")
            self.stage = StageProgress(message.index, name, message.points, self.clock())
        elif isinstance(message, PointStarted):
            self.point = message.id
            has_target = message.target_d_a is not None and message.target_q_a is not None
            self.target = (message.target_d_a or 0.0, message.target_q_a or 0.0) if has_target else None
            self._point_begun_s, self._point_s = self.clock(), message.seconds
        elif isinstance(message, PointDone):
            self._finish_point(message)
        elif isinstance(message, ResistanceEstimated):
            self.resistance = message.estimate
        elif isinstance(message, StageSufficed):
            self.points -= message.points_spared
            self.left_s = max(0.0, self.left_s - message.seconds_spared)
        elif isinstance(message, UnderWay) and not message.is_result:
            self.work = message.text
        elif isinstance(message, StagesAppended):
            self.stages += len(message.stages)

    @property
    def fraction(self) -> float:
        """Part of all points that is done, 0 to 1."""
        return min(1.0, self.points_done / self.points) if self.points else 0.0

    @property
    def wall_left_s(self) -> float | None:
        """Time on the wall that the rest will take at the pace so far; None before there is a pace."""
        if self.drive_s <= 0.0 or self.measuring_s <= 0.0:
            return None
        running = 0.0 if self._point_begun_s is None else self.clock() - self._point_begun_s
        return max(0.0, self.left_s * self.measuring_s / self.drive_s - running)

    def _start(self, message: RunStarted) -> None:
        self.name = message.name
        self.points, self.points_done = message.points, message.points_done
        self.left_s, self.begun_s = message.seconds, self.clock()
        self.stages = message.stages

    def _finish_point(self, message: PointDone) -> None:
        self.points_done, self.points = message.points_done, message.points
        self.left_s = message.seconds_left
        # Without a set-point, as with the gates off, the readings are the sensors' offsets and no current.
        self.achieved = None if self.target is None else (message.achieved_d_a, message.achieved_q_a)
        if self._point_begun_s is not None:
            self.measuring_s += self.clock() - self._point_begun_s
            self.drive_s += self._point_s
            self._point_begun_s = None
        if self.stage is not None:
            self.stage.done += 1
            self.stage.drive_s += self._point_s

    def _end_stage(self) -> None:
        self.finished, self.stage = self.stage, None
        self.target, self.point, self.work = None, "", ""
