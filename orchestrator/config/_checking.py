"""The dry run: a plan's points, time and loads, checked against limits and capabilities of the drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

from orchestrator.config._loads import Load, load_of
from orchestrator.config._planning import Plan, PlannedPoint
from orchestrator.config._requirements import Requirements
from orchestrator.config._slips import nameplate_doubts, root_two_question
from orchestrator.formatting.quantities import quantity
from orchestrator.stages import NOMINAL_SAMPLING_HZ
from protocols import Capabilities, CapabilityError, Motor, Point, Strict

_POWER_FACTOR_PEAK_DQ = 3 / 2
"""Power over (v i) of peak-valued dq vectors."""
_MAX_RMS_RATIO = 1.25
"""rms current over the rated one above which a note is given."""
_ROUNDING = 0.02
"""Relative difference of equal numbers after rounding."""
LONGEST_RUN_S = 7 * 86_400.0
_BYTES_PER_ROW = 11.0
"""Compressed row of a capture with sensor noise: measured 8 to 14."""


class StageRow(Strict):
    """Totals of one stage."""

    index: int
    stage: str
    points: int
    duration_s: float
    captured_s: float
    peak_current_a: float
    peak_voltage_v: float | None
    energy_j: float | None


class PlanSummary(Strict):
    """Totals of a procedure. None: the nameplate has no R_s."""

    points: int
    duration_s: float
    """On the drive's clock."""
    captured_s: float
    rows: int | None
    """None: the sampling frequency is not known without the drive."""
    bytes: int | None
    """Approximate size on disk."""
    peak_current_a: float
    """The longest set-point and the injection's ripple on it."""
    peak_voltage_v: float | None
    """R_s i, injection, ramps, and the current control's steps from point to point, within the limit."""
    energy_j: float | None
    """Copper loss at the nameplate's R_s, settling included."""
    rms_current_a: float
    """Over the whole duration, peak-valued: compare with the rated current as the length of its vector."""
    stages: tuple[StageRow, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    """Contradictions of the nameplate, and slips that would explain them."""


def check_plan(plan: Plan, capabilities: Capabilities | None) -> PlanSummary:
    """Check a plan against its limits and the drive, and return its totals; nothing is energised.

    Parameters
    ----------
    plan : Plan
    capabilities : Capabilities, optional
        The drive's capabilities; without them only the procedure's own limits are checked.

    Raises
    ------
    CapabilityError
        Names the stage and field that exceed a limit or the drive.
    """
    loads = _loads(plan, capabilities)
    requirements = Requirements(plan, capabilities)
    requirements.check_drive()
    for point, load in zip(plan.points, loads, strict=True):
        requirements.check_point(point, load)
    summary = _summary(plan, loads, capabilities)
    _check_totals(plan, summary)
    return summary


def check_point(plan: Plan, point: PlannedPoint, capabilities: Capabilities | None) -> None:
    """Check one changed point against limits and drive; raises `CapabilityError`."""
    load = load_of(point, (0.0, 0.0), plan.procedure.motor, _reversal_delay_s(capabilities))
    Requirements(plan, capabilities).check_point(point, load)


def _reversal_delay_s(capabilities: Capabilities | None) -> float:
    """Delay from a current's limit crossing to the effect of the reversed voltage [s]."""
    if capabilities is None:
        return 1.0 / NOMINAL_SAMPLING_HZ
    return (1.0 + capabilities.voltage_delay_samples) / capabilities.sampling_frequency_hz


def _loads(plan: Plan, capabilities: Capabilities | None) -> list[Load]:
    loads, delay_s = [], _reversal_delay_s(capabilities)
    previous: Point = (0.0, 0.0)
    for point in plan.points:
        loads.append(load_of(point, previous, plan.procedure.motor, delay_s))
        previous = point.excitation.start_dq_a
    return loads


def _summary(plan: Plan, loads: Sequence[Load], capabilities: Capabilities | None) -> PlanSummary:
    rows = [_row(plan, index, loads) for index in sorted({point.stage_index for point in plan.points})]
    duration = sum(row.duration_s for row in rows)
    captured = sum(row.captured_s for row in rows)
    samples = round(captured * capabilities.sampling_frequency_hz) if capabilities else None
    rms = math.sqrt(sum(load.current_square_a2_s for load in loads) / duration) if duration else 0.0
    return PlanSummary(
        points=len(plan.points),
        duration_s=duration,
        captured_s=captured,
        rows=samples,
        bytes=round(samples * _BYTES_PER_ROW) if samples is not None else None,
        peak_current_a=max((row.peak_current_a for row in rows), default=0.0),
        peak_voltage_v=_greatest([row.peak_voltage_v for row in rows]),
        energy_j=_total([row.energy_j for row in rows]),
        rms_current_a=rms,
        stages=tuple(rows),
        warnings=tuple(nameplate_doubts(plan.procedure.motor)),
        notes=(
            *_limit_notes(plan),
            *plan.notes,
            *_heat_notes(plan, rms),
            *(capabilities.notes if capabilities else ()),
            *root_two_question(plan.procedure.motor),
            *_measurable_notes(plan.procedure.motor),
        ),
    )


def _row(plan: Plan, index: int, loads: Sequence[Load]) -> StageRow:
    points = [(point, load) for point, load in zip(plan.points, loads, strict=True) if point.stage_index == index]
    resistance = plan.procedure.motor.stator_resistance_ohm
    squared = sum(load.current_square_a2_s for _, load in points)
    limit = plan.procedure.limits.voltage_v
    return StageRow(
        index=index,
        stage=plan.stages[index].name,
        points=len(points),
        duration_s=sum(point.seconds for point, _ in points),
        captured_s=sum(point.captured_s for point, _ in points),
        peak_current_a=max(load.peak_current_a for _, load in points),
        peak_voltage_v=_greatest([_peak_voltage(load, limit) for _, load in points]),
        energy_j=None if resistance is None else _POWER_FACTOR_PEAK_DQ * resistance * squared,
    )


def _peak_voltage(load: Load, limit: float) -> float | None:
    if load.steady_voltage_v is None or load.control_voltage_v is None:
        return None
    # The control's step saturates at the limit.
    return max(load.steady_voltage_v, min(load.control_voltage_v, limit))


def _check_totals(plan: Plan, summary: PlanSummary) -> None:
    limits, name = plan.procedure.limits, plan.procedure.name
    if summary.duration_s > LONGEST_RUN_S:
        longest = max(summary.stages, key=lambda row: row.duration_s)
        days = f"the plan takes {summary.duration_s / 86_400:.3g} days; the limit is {LONGEST_RUN_S / 86_400:g}"
        raise CapabilityError(name, f"stages.{longest.index}", f"{days}; most of it is this stage ({longest.stage})")
    if limits.duration_s is not None and summary.duration_s > limits.duration_s:
        longest = max(summary.stages, key=lambda row: row.duration_s)
        raise CapabilityError(
            name,
            "limits.duration_s",
            f"the plan takes {summary.duration_s:.0f} s, {limits.duration_s:g} s are allowed; "
            f"stages.{longest.index} ({longest.stage}) takes {longest.duration_s:.0f} s of it",
        )
    if limits.energy_j is None:
        return
    if summary.energy_j is None:
        raise CapabilityError(name, "limits.energy_j", "cannot be checked: motor.stator_resistance_ohm is missing")
    if summary.energy_j > limits.energy_j:
        hottest = max(summary.stages, key=lambda row: row.energy_j or 0.0)
        raise CapabilityError(
            name,
            "limits.energy_j",
            f"the plan dissipates {summary.energy_j:.0f} J, {limits.energy_j:g} J are allowed; "
            f"stages.{hottest.index} ({hottest.stage}) dissipates {hottest.energy_j:.0f} J of it",
        )


def _measurable_notes(motor: Motor) -> list[str]:
    """Expected readings between two terminals: data sheets often state these, twice those of a phase of the star."""
    ohm, henry = motor.stator_resistance_ohm, motor.d_inductance_h
    expected = [
        *([] if ohm is None else [f"an ohmmeter should read {quantity(2.0 * ohm, 'Ω')}"]),
        *([] if henry is None else [f"a bridge {quantity(2.0 * henry, 'H')} with the magnet along them"]),
    ]
    if not expected:
        return []
    stated = " and ".join(quantity(x, unit) for x, unit in ((ohm, "Ω"), (henry, "H")) if x is not None)
    between = f"motor: R and L are taken as of a phase: between two terminals {' and '.join(expected)}"
    return [f"{between}; if {'they read' if ohm and henry else 'it reads'} {stated}, halve these values in the file"]


def _limit_notes(plan: Plan) -> list[str]:
    """Note where the current limit is below the rated current's peak."""
    rated, limit = plan.procedure.motor.rated_current_a, plan.procedure.limits.current_a
    if rated is None or limit >= (1.0 - _ROUNDING) * rated:
        return []
    below = f"limits.current_a: {limit:.4g} A is below the rated current's peak of {rated:.4g} A"
    is_rms = abs(math.sqrt(2.0) * limit / rated - 1.0) <= _ROUNDING
    return [f"{below}: is it the rms value?" if is_rms else f"{below}: the map will not reach the rated current"]


def _heat_notes(plan: Plan, rms: float) -> list[str]:
    rated = plan.procedure.motor.rated_current_a
    if rated is None or rms <= _MAX_RMS_RATIO * rated:
        return []
    return [f"the rms current is {rms / rated:.2f} times the rated one: the winding gets hotter than it is rated for"]


def _greatest(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return max(known) if known and len(known) == len(values) else None


def _total(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None
