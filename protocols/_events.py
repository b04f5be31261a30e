"""Messages of the engine: validated, for journal and streams."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from protocols._base import ArrayModel, Strict
from protocols._diagnosis import Compared, Diagnosed, DiagnosisStep, ExperimentProposed, LawLearned
from protocols._drive import Limits
from protocols._estimates import FluxMapEstimate, ResistanceEstimate
from protocols._estimation_report import EstimationReport
from protocols._motor import Motor
from protocols._procedure import About, StageEntry
from protocols._recording import Capture, Segment


class RunStarted(Strict):
    """First message of a run, or of a resumption."""

    kind: Literal["run_started"] = "run_started"
    run: str
    """Name of the run directory, which may have been moved since."""
    name: str
    motor: Motor
    about: About = About()
    """Description of the run; missing in older journals."""
    limits: Limits
    drive: str
    stages: int
    points: int
    points_done: int
    seconds: float
    """Planned remaining time on the drive's clock."""


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
    """Title; missing in older runs."""
    points: int


class StagesAppended(Strict):
    """Stages appended after the procedure's last one.

    The journal alone holds them; the procedure in `run.json` stays what it was.
    """

    kind: Literal["stages_appended"] = "stages_appended"
    by: int | None
    """Index of the stage that appended them. None: a person extended the finished run."""
    stages: tuple[StageEntry, ...]


class StageSufficed(Strict):
    """A stage ended early: the rest of its plan is not measured, nor in a resumed run."""

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
    """Statement by which the procedure's answer counts on a real drive, given at the start of the run."""


class LockChecked(Strict):
    """Verdict of the lock check."""

    kind: Literal["lock_checked"] = "lock_checked"
    locked: bool | None
    """None: unknown; the rotation is too uncertain."""
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
    """Progress of a computation; not stored in the journal."""

    kind: Literal["under_way"] = "under_way"
    text: str
    is_result: bool = False
    """Whether it states an interim result rather than the present activity."""


class RunEnded(Strict):
    kind: Literal["run_ended"] = "run_ended"
    outcome: Literal["finished", "faulted", "aborted"]
    reason: str
    run: str
    """Name of the run directory, which may have been moved since."""
    estimates: Annotated[EstimationReport | None, BeforeValidator(lambda report: report or None)] = None
    """None without estimates; an empty object in older journals."""


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
"""The messages without arrays, as stored in the journal."""

Message = _Journalled | SamplesCaptured | MapEstimated | DiagnosisStep | LawLearned | UnderWay
