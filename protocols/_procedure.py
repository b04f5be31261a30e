"""The procedure: what a commissioning run does, in which order, with which settings.

Settings left out are derived from the nameplate and the limits when the plan is made, so that
one procedure serves motors of every size.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from protocols._base import Strict
from protocols._drive import CurrentControl, Limits, NonNegative
from protocols._motor import Positive, ProcedureMotor

Point = tuple[float, float]
"""(i_d, i_q) in amperes, peak."""


class _Stage(Strict):
    """What all stages share."""


class _EnergisedStage(_Stage):
    control: CurrentControl | None = None
    """None: the procedure's."""


class GatesOffStage(_Stage):
    """Read the sensors with the bridge off: tells an offset of the sensors from one of the voltage."""

    kind: Literal["gates_off"]
    duration_s: Positive = 1.0


class AlignmentStage(_EnergisedStage):
    """Turn the free rotor onto a current vector; its angle is the believed one from then on."""

    kind: Literal["alignment"]
    current_a: Positive | None = None
    """None: the rated current."""
    angle_rad: float = 0.0
    settle_s: Positive = 1.0
    duration_s: Positive = 0.5


class OperatorStage(_Stage):
    """Ask the operator for a deed and wait for the answer; nothing is energised meanwhile."""

    kind: Literal["operator"]
    prompt: str
    answer: Literal["yes"] | None = None
    """The answer where nobody is there to ask. None: a person has to say it."""
    brake: Literal["engage", "release"] | None = None
    """What the drive does with its brake, where it has one, once the answer is yes."""


class LockCheckStage(_EnergisedStage):
    """Does the rotor move under torque of both signs? A failed check ends the run."""

    kind: Literal["lock_check"]
    torque_current_a: Positive | None = None
    """Current on the believed q axis. None: the largest that the later stages use."""
    amplitude_v: Positive | None = None
    frequency_hz: Positive | None = None
    rotation_hz: Positive | None = None
    settle_s: Positive | None = None
    duration_s: Positive | None = None
    tolerance_rad: Positive = 0.02
    """Largest lasting rotation (electrical) that still counts as locked."""
    accept_not_known: Literal["I have seen that the rotor is held"] | None = None
    """Where the motor shows too little saliency to tell, the run asks the operator, unless this is written out."""


class ResistanceStage(_EnergisedStage):
    """Hold direct currents at one or more PWM frequencies."""

    kind: Literal["resistance"]
    points_a: tuple[Point, ...] | None = None
    """None: steps on both axes, denser near zero."""
    pwm_frequencies_hz: tuple[Positive, ...] | None = None
    """None: the drive's own."""
    settle_s: Positive | None = None
    duration_s: Positive | None = None
    anchor: bool = False
    """Mark as a repetition of one and the same point."""


class ClassicalStage(_EnergisedStage):
    """The paper's trapezoids: q swept at held d, d swept at held q, and both together."""

    kind: Literal["classical"]
    axes: tuple[Literal["q", "d", "dq"], ...] = ("q", "d", "dq")
    amplitude_a: Positive | None = None
    """None: the rated current and a quarter more, within the limits."""
    held_a: tuple[float, ...] | None = None
    """None: five values over the amplitude."""
    period_s: Positive = 2.0
    periods: Annotated[int, Field(ge=1)] = 2
    settle_s: Positive | None = None


class InjectionStage(_EnergisedStage):
    """Signal injection at many operating points.

    `pattern` "paths" steps along the paths of the classical stage, "grid" covers a square grid
    row by row in alternating direction; `points_a`, where given, goes instead of both.
    """

    kind: Literal["injection"]
    pattern: Literal["paths", "grid"] = "grid"
    points_a: tuple[Point, ...] | None = None
    axes: tuple[Literal["q", "d", "dq"], ...] = ("q", "d", "dq")
    range_a: Positive | None = None
    """Largest current on an axis. None: the classical stage's default amplitude."""
    held_a: tuple[float, ...] | None = None
    step_a: Positive | None = None
    amplitudes_v: tuple[Positive, ...] | None = None
    """One sweep for each. None: `amplitude_ratios` of what swings the flux by a fifth of L_d I_rated."""
    amplitude_ratios: tuple[Positive, ...] = (1.0,)
    """One sweep for each, where `amplitudes_v` is left out."""
    frequency_hz: Positive | None = None
    rotation_hz: Positive | None = None
    waveform: Literal["square", "sine"] = "square"
    settle_s: Positive | None = None
    discard_s: NonNegative = 0.0
    duration_s: Positive | None = None
    anchor: bool = False


class EstimateStage(_Stage):
    """Run the estimators on what has been measured so far; the drive is disarmed meanwhile."""

    kind: Literal["estimate"]
    estimators: tuple[str, ...] | None = None
    """None: every installed one."""


class DiagnoseStage(_Stage):
    """Hold the model against what has been measured so far, and name what it lacks; disarmed meanwhile.

    Where two effects cannot be told apart and `rounds` allows it, the experiment that parts them is measured
    (a stage more, of the run's own recording), the estimators run anew, and so does the diagnosis.
    """

    kind: Literal["diagnose"]
    model: Literal["saturated", "linear"] = "saturated"
    without: tuple[str, ...] = ()
    """Effects taken out of the library."""
    rounds: Annotated[int, Field(ge=0, le=10)] = 0
    """Most proposed experiments that may follow."""


Stage = Annotated[
    GatesOffStage
    | AlignmentStage
    | OperatorStage
    | LockCheckStage
    | ResistanceStage
    | ClassicalStage
    | InjectionStage
    | EstimateStage
    | DiagnoseStage,
    Field(discriminator="kind"),
]


class DriveChoice(Strict):
    """Which drive plugin, and the options that it defines itself."""

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)

    name: str

    @property
    def options(self) -> dict[str, Any]:
        """What was written beside the name, for the plugin's own `Options` to validate."""
        return dict(self.model_extra or {})


class Procedure(Strict):
    """A commissioning run, whole."""

    format: Literal["fluxbench-procedure"]
    version: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    summary: str = ""
    motor: ProcedureMotor
    drive: DriveChoice
    limits: Limits
    seed: int = 1
    """Seeds everything random in the run (a simulated drive's noise)."""
    control: CurrentControl = CurrentControl()
    accept_no_watchdog: Literal["I stand beside the drive and can cut its power"] | None = None
    """A drive without a dead man is refused unless this sentence is written out."""
    stages: Annotated[tuple[Stage, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _brake_before_torque(self) -> Procedure:
        released = False
        for index, stage in enumerate(self.stages):
            if stage.kind == "operator" and stage.brake is not None:
                released = stage.brake == "release"
            elif released and stage.kind in ("lock_check", "classical", "injection"):
                raise ValueError(
                    f"stages.{index}: {stage.kind} with the brake released; "
                    "put an operator stage with brake: engage before it"
                )
        return self
