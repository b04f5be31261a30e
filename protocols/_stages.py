"""The stage: the points of a procedure's entry, its defaults from the nameplate, and its evaluation.

A stage plugin is a frozen model of its settings, a subclass of `Stage`; its entry point in the group
``fluxbench.stages`` is the word that a procedure writes as the entry's `kind`. The engine, the state machine and
the streams know a stage by what is declared here and by nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, Self, runtime_checkable

from protocols._base import Strict
from protocols._drive import Capabilities, Telemetry
from protocols._estimation_report import EstimationReport
from protocols._events import Message
from protocols._excitations import CurrentControl, Excitation
from protocols._procedure import Procedure, StageEntry
from protocols._recording import RecordingReader, Segment, SegmentStage


class StageState(NamedTuple):
    """A state of the run that belongs to a stage; two stages may share one that they declare alike."""

    name: str
    """Name of the state: ``sweeping_injection``."""
    trigger: str
    """Trigger of the transition to it: ``sweep_injection``."""
    after: str | None = None
    """The one state that it may follow. None: whatever is at rest."""


class PluginUse(NamedTuple):
    """A plugin that a stage works with; looked for before anything is energised."""

    kind: Literal["estimators", "effects"]
    name: str | None
    """None: all that are installed."""
    field: str = ""
    """The setting that names it."""


@dataclass(frozen=True)
class StagePoint:
    """One excitation, and settings for the recording beside the excitation's own."""

    excitation: Excitation
    """Its `rotor_angle_rad` is put in by whoever plans: the run's believed angle."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    spare: bool = False
    """Measured only where those before it show that it is wanted; `Stage.as_run` says."""


@dataclass(frozen=True)
class StageContext:
    """What a stage's missing settings may be derived from.

    `orchestrator.stages.Scaling` has the project's own rules.
    """

    procedure: Procedure
    """Motor, limits, and the current control of stages that name none."""
    index: int
    """Place of the stage among all, for errors and notes."""
    sampling_frequency_hz: float
    """The drive's, or a nominal one where no drive is connected."""
    later: Sequence[Stage] = ()
    """The filled stages after it, for a stage that `looks_ahead`."""
    notes: list[str] = field(default_factory=list)
    """What a person should know of what was filled in."""


class Stage(Strict):
    """Base of all stages: the settings of one entry, and what they come to.

    A stage that measures says `measuring` and `records_as`, and gives `points`; one that works on what was measured
    (or asks the operator) does so in `work`. A stage may do both.
    """

    name: ClassVar[str]
    """The `kind` of its entries, and the beginning of its points' ids."""
    title: ClassVar[str]
    """Title: ``signal injection``."""
    measuring: ClassVar[StageState | None] = None
    """The state in which its points are measured, the drive armed. None: it has no points."""
    records_as: ClassVar[SegmentStage | None] = None
    """Kind of measurement of its segments in the recording."""
    working: ClassVar[tuple[StageState, ...]] = ()
    """The states that `work` and `as_run` enter, the drive disarmed."""
    looks_ahead: ClassVar[bool] = False
    """Whether it is filled in after the others, and sees them."""
    journalled: ClassVar[bool] = True
    """Whether the journal keeps what `work` finds; if not, the last stage of its kind works anew in a resumed run."""

    def filled(self, context: StageContext) -> Self:
        """The stage with all settings; raises `ProcedureError` where the nameplate lacks a value for one."""
        return self

    def points(self) -> Iterable[StagePoint]:
        """The points of a filled stage, in order."""
        return ()

    def as_run(self, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
        """Yield the remaining planned excitations as they are to be run, each after those before it are measured.

        What differs from the plan is of the same kind, no longer than planned, and within what limits and drive allow:
        whoever runs it sees to that. Where they end early, what was measured is enough. The drive is armed, and holds
        what it held; who computes enters a `working` state first, and the drive is armed again when there is a point.
        """
        yield from planned

    def after_point(self, run: StageRun, segment: Segment) -> None:
        """What to look at with each point (a thermometer), shortly: the drive still holds it."""

    def work(self, run: StageRun) -> None:
        """What is left to do when all points are measured; not done again once the run is beyond it."""

    def uses(self) -> Sequence[PluginUse]:
        """The plugins that `work` takes from `StageRun.plugins`."""
        return ()

    @property
    def believed_angle_rad(self) -> float | None:
        """The rotor's angle from this stage on. None: unchanged."""
        return None

    @property
    def leaves_brake(self) -> Literal["engage", "release"] | None:
        """State of the brake after it. None: unchanged."""
        return None

    @property
    def current_field(self) -> str:
        """Name of the setting to change where the current exceeds the limits."""
        return ""

    @property
    def voltage_field(self) -> str:
        """Name of the setting to change where the voltage exceeds the limits; by default `current_field`."""
        return self.current_field

    def entry(self) -> StageEntry:
        """The stage as a procedure, a run and the journal write it."""
        return StageEntry(kind=self.name, **self.model_dump(mode="json"))


class EnergisedStage(Stage):
    """A stage that measures under current control."""

    control: CurrentControl | None = None
    """None: the procedure's."""


class StageRun(Protocol):
    """The run, as a stage at work sees it. All is called from the run's one thread."""

    @property
    def path(self) -> Path:
        """The run directory."""
        ...

    @property
    def procedure(self) -> Procedure:
        """With the stages that were appended."""
        ...

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities of the connected drive."""
        ...

    @property
    def segments(self) -> Sequence[Segment]:
        """Segments of this stage so far, in order."""
        ...

    @property
    def appended(self) -> int:
        """Number of times that stages were appended to the run."""
        ...

    def recording(self) -> RecordingReader:
        """All that was measured so far."""
        ...

    def plugins(self, kind: Literal["estimators", "effects"]) -> Sequence[Any]:
        """Plugins of a kind that the run's stages use, by name."""
        ...

    def telemetry(self) -> Telemetry:
        """A reading of the drive, now."""
        ...

    def enter(self, state: StageState) -> None:
        """Stand the drive down and be in one of the stage's own `working` states."""
        ...

    def publish(self, message: Message, *, durable: bool = False) -> None:
        """Publish to journal and streams; `durable` returns when it is on the disk."""
        ...

    def ask(self, prompt: str, *, answered: bool) -> None:
        """Have the operator say yes, or the procedure where it has `answered`; the drive is disarmed meanwhile.

        Raises `RunAborted` where the answer is no, or nobody is there.
        """
        ...

    def set_brake(self, engaged: bool) -> None:
        """Move the drive's brake, where it has one."""
        ...

    def check(self) -> None:
        """Raise `RunInterrupted` after a request to stop; to be called several times a second."""
        ...

    def plan(self, stages: Sequence[StageEntry]) -> None:
        """Raise `InputError` where limits or drive do not allow these stages after the last one."""
        ...

    def append(self, stages: Sequence[StageEntry]) -> None:
        """Go on with these stages after the last one; raises what `plan` does."""
        ...

    def conclude(self, estimates: EstimationReport) -> None:
        """What the run's last message says was found."""
        ...


@runtime_checkable
class ProposingStage(Protocol):
    """A stage whose proposals a finished run can be gone on with (`fluxbench run --from`)."""

    def going_on(self, experiment: dict[str, Any], procedure: Procedure, rounds: int) -> Sequence[StageEntry]:
        """What to append to a finished run that this stage's proposal is from; raises `ProcedureError`."""
        ...
