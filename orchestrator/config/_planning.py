"""A procedure laid out: every point with its id, excitation and settings, in order. Nothing is judged here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from orchestrator.config._scaling import NOMINAL_SAMPLING_HZ, Scaling
from protocols import (
    AlignmentStage,
    Capabilities,
    ClassicalStage,
    DiagnoseStage,
    EstimateStage,
    Excitation,
    GatesOff,
    GatesOffStage,
    Hold,
    Injection,
    InjectionStage,
    LockCheckStage,
    OperatorStage,
    Point,
    Procedure,
    ProcedureError,
    ResistanceStage,
    SegmentStage,
    Stage,
    Trapezoid,
)

T = TypeVar("T")


@dataclass(frozen=True)
class PlannedPoint:
    """One excitation of a plan, and what the recording will say of it."""

    id: str
    """``<stage>-<number>``, counted over the whole procedure: the segment's id."""
    stage_index: int
    stage: SegmentStage
    excitation: Excitation
    settings: dict[str, Any]
    """What was asked for, as the segment's settings."""
    target: tuple[float, float] | None
    """(i_d, i_q) [A]; None where the current is swept, or there is none."""

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


def make_plan(procedure: Procedure, capabilities: Capabilities | None, appended: Sequence[Stage] = ()) -> Plan:
    """Fill in what the procedure leaves out and lay out its points.

    The same procedure and capabilities give the same plan, so that a resumed run finds its points; stages appended
    to it change nothing of what is before them.

    Parameters
    ----------
    procedure : Procedure
    capabilities : Capabilities, optional
        What the drive said of itself; without it the sampling frequency is taken to be 10 kHz.
    appended : sequence of Stage
        What a run goes on with after the procedure's last stage.

    Raises
    ------
    ProcedureError
        Where the nameplate lacks a value that a setting left out is derived from.
    """
    scaling = Scaling(procedure, capabilities.sampling_frequency_hz if capabilities else NOMINAL_SAMPLING_HZ)
    stages = scaling.fill_all(appended)
    own_pwm = capabilities.pwm_frequency_hz if capabilities else None
    counter: Counter[SegmentStage] = Counter()
    points: list[PlannedPoint] = []
    angle = 0.0
    for index, stage in enumerate(stages):
        if isinstance(stage, AlignmentStage):
            angle = stage.angle_rad
        drafts = list(_drafts(stage, angle, own_pwm))
        if not drafts and not isinstance(stage, OperatorStage | EstimateStage | DiagnoseStage):
            raise ProcedureError(procedure.name, f"stages.{index}", f"{stage.kind} without a point to measure")
        for draft in drafts:
            kind = SegmentStage(stage.kind)
            identifier = f"{kind.value}-{counter[kind]:03d}"
            counter[kind] += 1
            points.append(PlannedPoint(identifier, index, kind, draft.excitation, draft.settings, draft.target))
    whole = procedure.model_copy(update={"stages": (*procedure.stages, *appended)})
    return Plan(whole, stages, tuple(points), tuple(scaling.notes))


@dataclass(frozen=True)
class _Draft:
    excitation: Excitation
    settings: dict[str, Any]
    target: Point | None


def _drafts(stage: Stage, angle: float, own_pwm: float | None) -> Iterator[_Draft]:
    match stage:
        case GatesOffStage():
            yield _Draft(GatesOff(rotor_angle_rad=angle, duration_s=stage.duration_s), {}, None)
        case AlignmentStage():
            yield _hold(stage, (_filled(stage.current_a), 0.0), angle, None, {})
        case LockCheckStage():
            yield from _lock_check(stage, angle)
        case ResistanceStage():
            yield from _resistance(stage, angle, own_pwm)
        case ClassicalStage():
            yield from _classical(stage, angle)
        case InjectionStage():
            yield from _injection(stage, angle)
        case _:
            return


def _hold(
    stage: AlignmentStage | ResistanceStage, target: Point, angle: float, pwm: float | None, extra: dict[str, Any]
) -> _Draft:
    excitation = Hold(
        current_d_a=target[0],
        current_q_a=target[1],
        settle_s=_filled(stage.settle_s),
        duration_s=_filled(stage.duration_s),
        rotor_angle_rad=angle,
        pwm_frequency_hz=pwm,
        control=_filled(stage.control),
    )
    return _Draft(excitation, {"current_d_a": target[0], "current_q_a": target[1], **extra}, target)


def _resistance(stage: ResistanceStage, angle: float, own_pwm: float | None) -> Iterator[_Draft]:
    frequencies: Sequence[float | None] = stage.pwm_frequencies_hz or (None,)
    for frequency in frequencies:
        is_own = frequency is None or frequency == own_pwm
        extra: dict[str, Any] = {} if is_own else {"pwm_frequency_hz": frequency}
        if stage.anchor:
            extra["anchor"] = True
        for target in _filled(stage.points_a):
            yield _hold(stage, target, angle, frequency, extra)


def _classical(stage: ClassicalStage, angle: float) -> Iterator[_Draft]:
    for axis in stage.axes:
        for held in (0.0,) if axis == "dq" else _filled(stage.held_a):
            excitation = Trapezoid(
                swept_axis=axis,
                held_a=held,
                amplitude_a=_filled(stage.amplitude_a),
                period_s=stage.period_s,
                periods=stage.periods,
                settle_s=_filled(stage.settle_s),
                rotor_angle_rad=angle,
                control=_filled(stage.control),
            )
            asked = excitation.model_dump(include={"swept_axis", "held_a", "amplitude_a", "period_s", "periods"})
            if axis == "dq":
                del asked["held_a"]
            yield _Draft(excitation, asked, None)


def _injection(stage: InjectionStage, angle: float) -> Iterator[_Draft]:
    extra = {"anchor": True} if stage.anchor else {}
    points = _filled(stage.points_a)
    for sweep, amplitude in enumerate(_filled(stage.amplitudes_v)):
        # Every second sweep goes backwards: it starts where the one before has ended.
        for target in points if sweep % 2 == 0 else reversed(points):
            yield _injected(stage, target, amplitude, stage.waveform, stage.discard_s, angle, extra)


def _lock_check(stage: LockCheckStage, angle: float) -> Iterator[_Draft]:
    torque, amplitude = _filled(stage.torque_current_a), _filled(stage.amplitude_v)
    for sign in (0, 1, 0, -1, 0):
        target = (0.0, sign * torque + 0.0)
        yield _injected(stage, target, amplitude, "square", 0.0, angle, {"torque": sign})


def _injected(
    stage: InjectionStage | LockCheckStage,
    target: Point,
    amplitude_v: float,
    waveform: Any,
    discard_s: float,
    angle: float,
    extra: dict[str, Any],
) -> _Draft:
    excitation = Injection(
        target_d_a=target[0],
        target_q_a=target[1],
        settle_s=_filled(stage.settle_s),
        discard_s=discard_s,
        duration_s=_filled(stage.duration_s),
        amplitude_v=amplitude_v,
        frequency_hz=_filled(stage.frequency_hz),
        rotation_hz=_filled(stage.rotation_hz),
        waveform=waveform,
        rotor_angle_rad=angle,
        control=_filled(stage.control),
    )
    names = {"target_d_a", "target_q_a", "amplitude_v", "frequency_hz", "rotation_hz", "waveform"}
    return _Draft(excitation, {**excitation.model_dump(include=names), **extra}, target)


def _filled(setting: T | None) -> T:
    """What scaling has left nothing open in."""
    assert setting is not None
    return setting
