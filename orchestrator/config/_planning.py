"""A procedure laid out: every point with its id, excitation and settings, in order; unchecked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from orchestrator.config._adapting import PlanAdapter
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
    """One excitation of a plan, with the id, stage and settings of its segment in the recording."""

    id: str
    """``<stage>-<number>``, counted over the whole procedure: the segment's id."""
    stage_index: int
    stage: SegmentStage
    excitation: Excitation
    settings: dict[str, Any]
    """The set-point, as the segment's settings."""
    spare: bool = False
    """Measured only if earlier points show that it is needed; counts and durations exclude it."""

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
        """Duration on the drive's clock, settling included [s]."""
        return self.captured_s + self.excitation.settling_s

    @property
    def captured_s(self) -> float:
        """Captured duration [s]."""
        return self.excitation.captured_s


@dataclass(frozen=True)
class Plan:
    """A procedure with all settings and points filled in."""

    procedure: Procedure
    """With the stages that were appended to it."""
    stages: tuple[Stage, ...]
    """The procedure's stages, with all settings filled in."""
    points: tuple[PlannedPoint, ...]
    """In the order in which they are measured."""
    notes: tuple[str, ...] = ()
    """Notes to the user on derived settings and adaptations."""

    def points_of(self, stage_index: int) -> tuple[PlannedPoint, ...]:
        """The points of one stage, by its index in the procedure."""
        return tuple(point for point in self.points if point.stage_index == stage_index)


def make_plan(procedure: Procedure, capabilities: Capabilities | None, appended: Sequence[StageEntry] = ()) -> Plan:
    """Fill in what the procedure leaves out, lay out its points, and adapt them to the drive.

    The same procedure and capabilities give the same plan, so that a resumed run finds its points; appended
    stages do not change earlier ones.

    Parameters
    ----------
    procedure : Procedure
    capabilities : Capabilities, optional
        The drive's capabilities; without them the sampling frequency is taken to be 10 kHz.
    appended : sequence of StageEntry
        Stages of a run after the procedure's last one.

    Raises
    ------
    ProcedureError
        A stage that is not installed or has a wrong setting, or a nameplate without a value from which a missing
        setting is derived.
    """
    sampling_hz = capabilities.sampling_frequency_hz if capabilities else NOMINAL_SAMPLING_HZ
    notes: list[str] = []
    own_count = len(procedure.stages)
    written = parse_stages(procedure, appended)
    stages = [
        *_filled(procedure, written[:own_count], 0, sampling_hz, notes),
        *_filled(procedure, written[own_count:], own_count, sampling_hz, notes),
    ]
    adapter = PlanAdapter(capabilities)
    points = _points(procedure.name, stages, capabilities.pwm_frequency_hz if capabilities else None, adapter)
    whole = procedure.model_copy(update={"stages": (*procedure.stages, *appended)})
    return Plan(whole, tuple(stages), tuple(points), (*notes, *adapter.notes))


def _filled(
    procedure: Procedure, written: Sequence[Stage], first: int, sampling_hz: float, notes: list[str]
) -> list[Stage]:
    """The stages in their order, all settings filled in; those that look ahead last, as they need the later ones."""
    stages = list(written)
    for ahead in (False, True):
        for k, stage in enumerate(stages):
            if stage.looks_ahead is ahead:
                later = stages[k + 1 :] if ahead else ()
                with _located(procedure.name, first + k, stage):
                    stages[k] = stage.filled(StageContext(procedure, first + k, sampling_hz, later, notes))
    return stages


@contextmanager
def _located(procedure: str, index: int, stage: Stage) -> Iterator[None]:
    """An impossible value that is derived, for example from limits that are too small, as an error of its stage."""
    try:
        yield
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        problem = first["msg"].removeprefix("Value error, ")
        text = f"{stage.name}: settings, nameplate and limits lead to an impossible {field}: {problem}"
        raise ProcedureError(procedure, f"stages.{index}", text) from None


def _points(procedure: str, stages: Sequence[Stage], pwm_hz: float | None, adapter: PlanAdapter) -> list[PlannedPoint]:
    counter: Counter[str] = Counter()
    points: list[PlannedPoint] = []
    angle = 0.0
    for index, stage in enumerate(stages):
        if stage.believed_angle_rad is not None:
            angle = stage.believed_angle_rad
        first = len(points)
        with _located(procedure, index, stage):
            planned = list(stage.points())
        for point in planned:
            assert stage.records_as is not None
            rotated = point.excitation.model_copy(update={"rotor_angle_rad": angle})
            for excitation in adapter.adapt(rotated, stage, index):
                settings = {**_set_point(excitation, pwm_hz), **point.settings}
                identifier = f"{stage.name}-{counter[stage.name]:03d}"
                counter[stage.name] += 1
                points.append(PlannedPoint(identifier, index, stage.records_as, excitation, settings, point.spare))
        if stage.measuring is not None and len(points) == first:
            raise ProcedureError(procedure, f"stages.{index}", f"{stage.name} without a point to measure")
    return points


def _set_point(excitation: Excitation, drive_pwm_hz: float | None) -> dict[str, Any]:
    """An excitation's set-point in the recording format of a segment's settings."""
    settings = excitation.model_dump(include=_SET_POINT_FIELDS[excitation.kind])
    if isinstance(excitation, Trapezoid) and excitation.swept_axis == "dq":
        del settings["held_a"]
    if excitation.pwm_frequency_hz not in (None, drive_pwm_hz):
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
