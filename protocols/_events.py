"""What the engine says while it works: the validated messages that journal and streams receive."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from protocols._base import ArrayModel, Strict
from protocols._diagnosis import Compared, Diagnosed, DiagnosisStep, ExperimentProposed
from protocols._drive import Limits
from protocols._estimates import FluxMapEstimate, ResistanceEstimate
from protocols._motor import Motor
from protocols._procedure import About, StageEntry
from protocols._recording import Capture, Segment
from protocols._reports import EstimationReport


class RunStarted(Strict):
    """First message of a run, or of a resumption."""

    kind: Literal["run_started"] = "run_started"
    run: str
    """Name of the run directory, which may have been moved since."""
    name: str
    motor: Motor
    about: About = About()
    """What the run is of; older journals do not say."""
    limits: Limits
    drive: str
    stages: int
    points: int
    points_done: int
    seconds: float
    """Planned time on the drive's clock of what is still to be done."""


class StateChanged(Strict):
    kind: Literal["state_changed"] = "state_changed"
    source: str
    target: str
    reason: str = ""


class StageStarted(Strict):
    kind: Literal["stage_started"] = "stage_started"
    index: int
    """Place of the stage in the procedure."""
    stage: str
    title: str = ""
    """What people call it; runs of old have none."""
    points: int


class StagesAppended(Strict):
    """Stages more than the procedure has: from here on the run goes on with them after its last one.

    The journal alone holds them; the procedure in `run.json` stays what it was.
    """

    kind: Literal["stages_appended"] = "stages_appended"
    by: int | None
    """Index of the stage that appended them. None: a person extended the finished run."""
    stages: tuple[StageEntry, ...]


class StageSufficed(Strict):
    """What a stage has measured is enough: the rest of its plan is not measured, in a resumed run neither."""

    kind: Literal["stage_sufficed"] = "stage_sufficed"
    index: int
    points_spared: int
    seconds_spared: float
    """Planned time of these, on the drive's clock."""


class PointStarted(Strict):
    kind: Literal["point_started"] = "point_started"
    id: str
    stage_index: int
    target_d_a: float | None
    target_q_a: float | None
    seconds: float


class PointDone(Strict):
    """A point is measured and on disk."""

    kind: Literal["point_done"] = "point_done"
    id: str
    stage_index: int
    segment: Segment
    achieved_d_a: float
    achieved_q_a: float
    """Mean current over the segment in the believed frame."""
    points_done: int
    points: int
    seconds_left: float
    """Planned time of the rest, on the drive's clock."""


class SamplesCaptured(ArrayModel):
    """A block of waveforms, by reference."""

    kind: Literal["samples_captured"] = "samples_captured"
    segment: str
    rotor_angle_rad: float
    capture: Capture


class OperatorAsked(Strict):
    kind: Literal["operator_asked"] = "operator_asked"
    prompt: str


class OperatorAnswered(Strict):
    kind: Literal["operator_answered"] = "operator_answered"
    answer: str
    by: Literal["operator", "procedure"]
    through: str = ""
    """What the operator sat at, where that was no terminal: "page"."""
    words: str = ""
    """By which the procedure's answer was let count on a real drive, spelled out by whoever started the run."""


class LockChecked(Strict):
    """Verdict of the lock check."""

    kind: Literal["lock_checked"] = "lock_checked"
    locked: bool | None
    """None: not known; the rotation cannot be seen well enough to tell."""
    confidence: float
    """Probability that the lasting rotation is within the tolerance."""
    moved_rad: float
    moved_std_rad: float
    twist_rad: float
    """Apparent rotation of the saliency while the torque acts, half the difference between its signs: cross-saturation
    looks alike."""
    summary: str


class ResistanceEstimated(Strict):
    kind: Literal["resistance_estimated"] = "resistance_estimated"
    estimate: ResistanceEstimate


class MapEstimated(ArrayModel):
    kind: Literal["map_estimated"] = "map_estimated"
    estimate: FluxMapEstimate


class Note(Strict):
    kind: Literal["note"] = "note"
    level: Literal["info", "warning", "error"]
    text: str


class UnderWay(Strict):
    """What the computer is at work on, for whoever waits; the journal does not keep it."""

    kind: Literal["under_way"] = "under_way"
    text: str
    is_result: bool = False
    """Whether it says what was found so far, and not what is being done."""


class RunEnded(Strict):
    kind: Literal["run_ended"] = "run_ended"
    outcome: Literal["finished", "faulted", "aborted"]
    reason: str
    run: str
    """Name of the run directory, which may have been moved since."""
    estimates: Annotated[EstimationReport | None, BeforeValidator(lambda report: report or None)] = None
    """None where nothing was estimated; older journals have an empty object there."""


_Journalled = (
    RunStarted
    | StateChanged
    | StageStarted
    | StagesAppended
    | StageSufficed
    | PointStarted
    | PointDone
    | OperatorAsked
    | OperatorAnswered
    | LockChecked
    | ResistanceEstimated
    | Compared
    | Diagnosed
    | ExperimentProposed
    | Note
    | RunEnded
)

JournalledMessage = Annotated[_Journalled, Field(discriminator="kind")]
"""The messages without arrays, as the journal keeps them."""

Message = _Journalled | SamplesCaptured | MapEstimated | DiagnosisStep | UnderWay
