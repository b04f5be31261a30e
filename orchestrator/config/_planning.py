"""A procedure laid out: every point with its id, excitation and settings, in order. Nothing is judged here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from orchestrator.config._fitting import Fitting
from orchestrator.stages import NOMINAL_SAMPLING_HZ, parse_stages
from protocols import (
    Capabilities,
    Excitation,
    ExcitationKind,
    Hold,
    Injection,
    Point,
    Procedure,
    ProcedureError,
    SegmentStage,
    Spin,
    Stage,
    StageContext,
    StageEntry,
    Trapezoid,
)


@dataclass(frozen=True)
class PlannedPoint:
    """One excitation of a plan, and what the recording will say of it."""

    id: str
    """``<stage>-<number>``, counted over the whole procedure: the segment's id."""
    stage_index: int
    stage: SegmentStage
    excitation: Excitation
    settings: dict[str, Any]
    """The set-point, as the segment's settings."""
    spare: bool = False
    """Measured only where those before it show that it is wanted: what the plan tells, it tells without."""

    def run_as(self, excitation: Excitation) -> PlannedPoint:
        """The point with another excitation of the same kind, and settings that state the set-point."""
        if excitation == self.excitation:
            return self
        now = excitation.model_dump()
        return replace(self, excitation=excitation, settings={k: now.get(k, v) for k, v in self.settings.items()})

    @property
    def target(self) -> Point | None:
        """(i_d, i_q) [A]; None where the current is swept, or there is none."""
        return self.excitation.start_dq_a if isinstance(self.excitation, Hold | Injection | Spin) else None

    @property
    def seconds(self) -> float:
        """What it takes on the drive's clock [s]."""
        return self.captured_s + self.excitation.settling_s

    @property
    def captured_s(self) -> float:
        """How much of it is captured [s]."""
        return self.excitation.captured_s


@dataclass(frozen=True)
class Plan:
    """A procedure with nothing left open."""

    procedure: Procedure
    """With the stages that were appended to it."""
    stages: tuple[Stage, ...]
    """The procedure's stages, with all settings filled in."""
    points: tuple[PlannedPoint, ...]
    """In the order in which they are measured."""
    notes: tuple[str, ...] = ()
    """What a person should know of how it was filled in."""

    def points_of(self, stage_index: int) -> tuple[PlannedPoint, ...]:
        """The points of one stage, by its place in the procedure."""
        return tuple(point for point in self.points if point.stage_index == stage_index)


def make_plan(procedure: Procedure, capabilities: Capabilities | None, appended: Sequence[StageEntry] = ()) -> Plan:
    """Fill in what the procedure leaves out, lay out its points, and fit them to the drive.

    The same procedure and capabilities give the same plan, so that a resumed run finds its points; stages appended
    to it change nothing of what is before them.

    Parameters
    ----------
    procedure : Procedure
    capabilities : Capabilities, optional
        What the drive states of itself; without it the sampling frequency is taken to be 10 kHz.
    appended : sequence of StageEntry
        What a run goes on with after the procedure's last stage.

    Raises
    ------
    ProcedureError
        A stage that is not installed or has a wrong setting, or a nameplate that lacks a value that a setting left
        out is derived from.
    """
    sampling_hz = capabilities.sampling_frequency_hz if capabilities else NOMINAL_SAMPLING_HZ
    notes: list[str] = []
    own = len(procedure.stages)
    written = parse_stages(procedure, appended)
    stages = [
        *_filled(procedure, written[:own], 0, sampling_hz, notes),
        *_filled(procedure, written[own:], own, sampling_hz, notes),
    ]
    fitting = Fitting(capabilities)
    points = _points(procedure.name, stages, capabilities.pwm_frequency_hz if capabilities else None, fitting)
    whole = procedure.model_copy(update={"stages": (*procedure.stages, *appended)})
    return Plan(whole, tuple(stages), tuple(points), (*notes, *fitting.notes))


def _filled(
    procedure: Procedure, written: Sequence[Stage], first: int, sampling_hz: float, notes: list[str]
) -> list[Stage]:
    """Stages with nothing left out; those that look ahead come after the others."""
    stages = list(written)
    for ahead in (False, True):
        for k, stage in enumerate(stages):
            if stage.looks_ahead is ahead:
                later = stages[k + 1 :] if ahead else ()
                stages[k] = stage.filled(StageContext(procedure, first + k, sampling_hz, later, notes))
    return stages


def _points(procedure: str, stages: Sequence[Stage], own_pwm_hz: float | None, fitting: Fitting) -> list[PlannedPoint]:
    counter: Counter[str] = Counter()
    points: list[PlannedPoint] = []
    angle = 0.0
    for index, stage in enumerate(stages):
        if stage.believed_angle_rad is not None:
            angle = stage.believed_angle_rad
        before = len(points)
        for point in stage.points():
            assert stage.records_as is not None
            turned = point.excitation.model_copy(update={"rotor_angle_rad": angle})
            for excitation in fitting.of(turned, stage, index):
                settings = {**_set_point(excitation, own_pwm_hz), **point.settings}
                identifier = f"{stage.name}-{counter[stage.name]:03d}"
                counter[stage.name] += 1
                points.append(PlannedPoint(identifier, index, stage.records_as, excitation, settings, point.spare))
        if stage.measuring is not None and len(points) == before:
            raise ProcedureError(procedure, f"stages.{index}", f"{stage.name} without a point to measure")
    return points


def _set_point(excitation: Excitation, own_pwm_hz: float | None) -> dict[str, Any]:
    """An excitation's numbers as the recording format has them in a segment's settings."""
    settings = excitation.model_dump(include=_SET_POINT_FIELDS[excitation.kind])
    if isinstance(excitation, Trapezoid) and excitation.swept_axis == "dq":
        del settings["held_a"]
    if excitation.pwm_frequency_hz not in (None, own_pwm_hz):
        settings["pwm_frequency_hz"] = excitation.pwm_frequency_hz
    return settings


_SET_POINT_FIELDS: dict[ExcitationKind, set[str]] = {
    "gates_off": set(),
    "hold": {"current_d_a", "current_q_a"},
    "trapezoid": {"swept_axis", "held_a", "amplitude_a", "period_s", "periods"},
    "injection": {"target_d_a", "target_q_a", "amplitude_v", "frequency_hz", "rotation_hz", "waveform"},
    "steps": {"voltage_d_v", "voltage_q_v", "turn_d_a", "turn_q_a"},
    "spin": {"speed_rad_s", "bridge", "current_d_a", "current_q_a"},
}
