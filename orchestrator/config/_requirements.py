"""Checks a plan against limits and drive, rule by rule; the first violation is reported with stage and field."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

from orchestrator.config._adapting import longest_capture_s, on_grid
from orchestrator.config._loads import Load
from orchestrator.config._planning import Plan, PlannedPoint
from orchestrator.stages import parse_stages
from protocols import (
    Capabilities,
    CapabilityError,
    GatesOff,
    Injection,
    NoWatchdogSentence,
    Spin,
    Stage,
    Trapezoid,
    VoltageSteps,
)

PHASE_PEAK = math.sqrt(2.0 / 3.0)
"""Peak voltage of a phase over the rms voltage from line to line."""


@dataclass(frozen=True)
class _Rules:
    """Thresholds of the rules."""

    inverter_error: float = 0.02
    """Share of the bus voltage lost to dead time and device drops."""
    max_q_share: float = 0.1
    """Share of a free rotor's current allowed on its q axis: sensor offsets are no torque."""
    min_samples: int = 10
    """Samples of a capture that is averaged."""
    min_per_period: int = 4
    """Samples of an injection's period."""
    max_rotation_ratio: float = 0.2
    """Rotation over the injection's frequency: a period then has nearly one direction."""
    min_per_trapezoid: int = 1000
    """Samples of a trapezoid's period."""
    min_per_control_period: int = 20
    """Samples over which current control acts, at its bandwidth."""
    min_per_swing: int = 8
    """Rows of a voltage step from limit to limit."""
    min_per_turn: int = 20
    """Samples of an electrical turn."""
    min_voltage_ratio: float = 1.5
    """Step voltage over R_s i at the limit: with less the current reaches it late or never."""


_RULES = _Rules()


class Requirements:
    """The rules for a plan.

    Parameters
    ----------
    plan : Plan
    capabilities : Capabilities, optional
        None: the drive's own rules are left out.
    """

    def __init__(self, plan: Plan, capabilities: Capabilities | None) -> None:
        self._plan, self._drive = plan, capabilities
        self._procedure, self._limits = plan.procedure, plan.procedure.limits
        self._released = _stages_with_brake(plan, "release")
        self._engaged = _stages_with_brake(plan, "engage")

    def check_drive(self) -> None:
        """Kinds of excitation, motor, interlocks, limits and dead man; raises `CapabilityError`."""
        if self._drive is None:
            return
        drive, limits = self._drive, self._limits
        self._check_excitations(self._plan.points, drive)
        self._check_motor(drive)
        missing = [name for name in self._procedure.interlocks if name not in drive.interlocks]
        if missing:
            those = ", ".join(drive.interlocks) or "none"
            raise self._error("interlocks", f"{drive.name!r} has no input {', '.join(missing)}; it has {those}")
        if limits.current_a > drive.max_current_a:
            drive_takes = f"the drive takes {drive.max_current_a:.4g} A"
            raise self._error(
                "limits.current_a",
                f"{limits.current_a:g} A, {drive_takes}: set it lower, by --set or in the motor file",
            )
        if limits.voltage_v > drive.max_voltage_v:
            self._check_rated_voltage(drive)
            drive_gives = f"the drive gives {drive.max_voltage_v:.4g} V"
            raise self._error(
                "limits.voltage_v",
                f"{limits.voltage_v:g} V, {drive_gives}: set it lower, by --set or in the motor file",
            )
        if self._procedure.accept_no_watchdog is None:
            self._check_watchdog(drive)

    def check_point(self, point: PlannedPoint, load: Load) -> None:
        """One point; raises `CapabilityError` naming its stage."""
        self._check_current(point, load)
        self._check_voltage(point, load)
        if point.stage_index in self._released:
            self._check_free_rotor(point)
        elif isinstance(point.excitation, Spin):
            has_brake = self._drive is not None and self._drive.has_brake
            if has_brake or point.stage_index in self._engaged:
                raise self._at(point, "", "with the brake engaged; put a stage with brake: release before it")
        if isinstance(point.excitation, VoltageSteps):
            self._check_turns(point, point.excitation)
        if self._drive is None:
            return
        self._check_offered(point, self._drive)
        self._check_sampling(point, self._drive.sampling_frequency_hz)

    def _check_excitations(self, points: Iterable[PlannedPoint], drive: Capabilities) -> None:
        """All stages that the drive cannot do, in one error."""
        unfit = {p.stage_index: p.excitation.kind for p in points if p.excitation.kind not in drive.excitations}
        if unfit:
            stages = ", ".join(f"stages.{index}" for index in sorted(unfit))
            missing, offered = (", ".join(sorted(kinds)) for kinds in (set(unfit.values()), drive.excitations))
            raise self._error(stages, f"the drive {drive.name!r} has no {missing}; it has {offered}")

    def _check_motor(self, drive: Capabilities) -> None:
        motor = self._procedure.motor
        if drive.motor_name is not None and drive.motor_name != motor.name:
            raise self._error("motor.name", f"{motor.name!r}, but the drive is set up for {drive.motor_name!r}")
        if motor.example and not drive.simulated and drive.motor_name is None:
            problem = f"{motor.name!r} is an example, and {drive.name!r} a real drive"
            raise self._error("motor.example", f"{problem}: give the real nameplate by --motor FILE")

    def _check_free_rotor(self, point: PlannedPoint) -> None:
        if isinstance(point.excitation, Spin):
            return
        if isinstance(point.excitation, Trapezoid | Injection | VoltageSteps):
            raise self._at(point, "", "with the brake released; put a stage with brake: engage before it")
        if point.target is not None and abs(point.target[1]) > _RULES.max_q_share * math.hypot(*point.target):
            raise self._at(point, self._written(point).current_field, "torque current while the brake is released")

    def _check_rated_voltage(self, drive: Capabilities) -> None:
        """Blame the nameplate where the limit of voltage follows from it."""
        rated_v = self._procedure.motor.rated_voltage_rms_v
        if rated_v is None or not math.isclose(self._procedure.limits.voltage_v, PHASE_PEAK * rated_v, rel_tol=1e-3):
            return
        most = (
            f"{rated_v:.4g} V is more than the {drive.max_voltage_v / PHASE_PEAK:.4g} V line to line rms of the drive"
        )
        hint = (
            f"is it the DC bus? Else set limits.voltage_v to {drive.max_voltage_v:.4g}, by --set or in the motor file"
        )
        raise self._error("motor.rated_voltage_rms_v", f"{most}: {hint}")

    def _check_watchdog(self, drive: Capabilities) -> None:
        advice = f'to do without, write accept_no_watchdog: "{get_args(NoWatchdogSentence)[0]}"'
        if drive.watchdog_s is None:
            raise self._error("drive.name", f"{drive.name!r} has no dead man: its power would stay on; {advice}")
        energised = {p.excitation.kind for p in self._plan.points if not isinstance(p.excitation, GatesOff)}
        uncovered = sorted((energised & drive.excitations) - drive.watchdog_covers)
        if uncovered:
            kinds = ", ".join(uncovered)
            raise self._error("drive.name", f"the dead man of {drive.name!r} does not work during {kinds}; {advice}")

    def _check_current(self, point: PlannedPoint, load: Load) -> None:
        if load.peak_current_a <= self._limits.current_a * (1 + 1e-9):
            return
        where = "" if point.target is None else f" at ({point.target[0]:g}, {point.target[1]:g}) A"
        ripple = f", {load.ripple_a:.3g} A of it ripple" if load.ripple_a else ""
        reaches = f"reaches {load.peak_current_a:.4g} A{where}{ripple}"
        problem = f"{reaches}; limits.current_a is {self._limits.current_a:g} A"
        raise self._at(point, self._written(point).current_field, problem)

    def _check_voltage(self, point: PlannedPoint, load: Load) -> None:
        required_v = load.steady_voltage_v
        if required_v is None:
            required_v = point.excitation.amplitude_v if isinstance(point.excitation, Injection) else 0.0
        if required_v > self._limits.voltage_v:
            field = self._written(point).voltage_field
            raise self._at(point, field, f"needs {required_v:.4g} V, limits.voltage_v is {self._limits.voltage_v:g} V")
        if self._drive is None:
            return
        bus = self._drive.dc_bus_voltage_v
        available = bus / math.sqrt(3) - _RULES.inverter_error * bus
        if required_v > available:
            problem = f"needs {required_v:.4g} V, a bus of {bus:g} V gives {available:.4g} V in every direction"
            raise self._at(point, self._written(point).voltage_field, problem)

    def _check_turns(self, point: PlannedPoint, e: VoltageSteps) -> None:
        resistance = self._procedure.motor.stator_resistance_ohm or 0.0
        for volts, turn_a in ((e.voltage_d_v, e.turn_d_a), (e.voltage_q_v, e.turn_q_a)):
            if volts < _RULES.min_voltage_ratio * resistance * turn_a:
                ohmic = f"{turn_a:.4g} A through R_s of {resistance:g} ohm"
                problem = f"{volts:.4g} V do not drive {ohmic} in time: at least"
                field = self._written(point).voltage_field
                raise self._at(point, field, f"{problem} {_RULES.min_voltage_ratio * resistance * turn_a:.3g} V")

    def _check_offered(self, point: PlannedPoint, drive: Capabilities) -> None:
        self._check_excitations([point], drive)
        e = point.excitation
        if e.pwm_frequency_hz is not None and e.pwm_frequency_hz not in drive.pwm_frequencies_hz:
            offered = ", ".join(f"{f:g}" for f in drive.pwm_frequencies_hz)
            problem = f"{e.pwm_frequency_hz:g} Hz is not offered by the drive ({offered} Hz)"
            raise self._at(point, "pwm_frequencies_hz", problem)
        longest_s = longest_capture_s(e, drive)
        if longest_s is not None and point.captured_s > longest_s * (1 + 1e-9):
            field = "periods" if isinstance(e, Trapezoid) else "duration_s"
            settles = f" after {e.settling_s:g} s of settling" if drive.longest_excitation_s is not None else ""
            longest = f"the drive's longest capture{settles} is {max(longest_s, 0.0):g} s"
            raise self._at(point, field, f"captures {point.captured_s:g} s; {longest}")
        if isinstance(e, Injection):
            if drive.injects_at_zero_only and e.longest_current_a > 0.0:
                problem = f"at ({e.target_d_a:g}, {e.target_q_a:g}) A; the drive {drive.name!r} injects at zero only"
                raise self._at(point, "points_a", problem)
            for name, step in (("frequency_hz", drive.frequency_step_hz), ("rotation_hz", drive.rotation_step_hz)):
                if not on_grid(getattr(e, name), step):
                    problem = f"{getattr(e, name):g} Hz: no nearby multiple of the drive's {step:g} Hz fits its rows"
                    raise self._at(point, name, problem)

    def _check_sampling(self, point: PlannedPoint, sampling_hz: float) -> None:
        e = point.excitation
        if point.captured_s * sampling_hz < _RULES.min_samples:
            field = "period_s" if isinstance(e, Trapezoid) else "duration_s"
            min_s = _RULES.min_samples / sampling_hz
            problem = f"captures {point.captured_s:g} s, too little to average: at least {min_s:g} s"
            raise self._at(point, field, problem)
        if isinstance(e, GatesOff):
            return
        bandwidth, highest = e.control.bandwidth_hz, sampling_hz / _RULES.min_per_control_period
        if bandwidth > highest and (self._drive is None or self._drive.heeds_bandwidth):
            problem = f"{bandwidth:g} Hz is too fast at {sampling_hz:g} Hz sampling: at most {highest:g} Hz"
            raise self._at(point, "control.bandwidth_hz", problem)
        if isinstance(e, Injection):
            self._check_injection(point, e, sampling_hz)
        if isinstance(e, VoltageSteps):
            self._check_swings(point, e, sampling_hz)
        if isinstance(e, Spin):
            self._check_spin(point, e, sampling_hz)
        if isinstance(e, Trapezoid) and e.period_s * sampling_hz < _RULES.min_per_trapezoid:
            shortest = _RULES.min_per_trapezoid / sampling_hz
            problem = f"{e.period_s:g} s is too short at {sampling_hz:g} Hz sampling: at least {shortest:g} s"
            raise self._at(point, "period_s", problem)

    def _check_swings(self, point: PlannedPoint, e: VoltageSteps, sampling_hz: float) -> None:
        motor = self._procedure.motor
        inductances = (motor.d_inductance_h, motor.q_inductance_h or motor.d_inductance_h)
        for volts, turn_a, inductance in zip(
            (e.voltage_d_v, e.voltage_q_v), (e.turn_d_a, e.turn_q_a), inductances, strict=True
        ):
            if volts == 0.0 or inductance is None:
                continue
            rows = 2.0 * turn_a * inductance / volts * sampling_hz
            if rows < _RULES.min_per_swing:
                max_v = volts * rows / _RULES.min_per_swing
                problem = f"{volts:.4g} V give {rows:.2g} rows from one turn to the next at {sampling_hz:g} Hz"
                field = self._written(point).voltage_field
                raise self._at(point, field, f"{problem}: at most {max_v:.3g} V, for {_RULES.min_per_swing} rows")

    def _check_spin(self, point: PlannedPoint, e: Spin, sampling_hz: float) -> None:
        speed, flux = abs(e.speed_rad_s), self._procedure.motor.pm_flux_wb or 0.0
        fastest = 2.0 * math.pi * sampling_hz / _RULES.min_per_turn
        if speed > fastest:
            problem = f"{speed:.4g} rad/s (electrical) is too fast at {sampling_hz:g} Hz sampling: at most"
            raise self._at(point, "speeds_rpm", f"{problem} {fastest:.4g}")
        if e.duration_s * speed < 4.0 * math.pi:
            captured = f"captures {e.duration_s * speed / (2.0 * math.pi):.2g} turns (electrical)"
            raise self._at(point, "turns", f"{captured}: two are needed at least")
        bus, emf = self._drive.dc_bus_voltage_v if self._drive else math.inf, math.sqrt(3.0) * speed * flux
        if e.bridge == "off" and emf > bus:
            problem = f"has a back-EMF of {emf:.4g} V between terminals, which the diodes feed to a bus of {bus:g} V"
            raise self._at(point, "speeds_rpm", problem)

    def _check_injection(self, point: PlannedPoint, injection: Injection, sampling_hz: float) -> None:
        # A square wave with an odd number of samples per period has a mean, which drives a direct current.
        unit = 2 if injection.waveform == "square" else 1
        per_period = sampling_hz / injection.frequency_hz
        nearest_rows = max(_RULES.min_per_period, unit * round(per_period / unit))
        if abs(per_period - nearest_rows) > 1e-6 * nearest_rows:
            kind = "an even number" if unit == 2 else "a whole number"
            frequency = f"{injection.frequency_hz:g} Hz gives {per_period:.4g} samples a period at {sampling_hz:g} Hz"
            requirement = f"{kind} of at least {_RULES.min_per_period} is needed"
            nearest = f"the nearest is {sampling_hz / nearest_rows:.10g} Hz"
            raise self._at(point, "frequency_hz", f"{frequency}; {requirement}: {nearest}")
        fastest = _RULES.max_rotation_ratio * injection.frequency_hz
        if injection.rotation_hz > fastest:
            problem = f"{injection.rotation_hz:g} Hz is too fast for an injection at {injection.frequency_hz:g} Hz"
            raise self._at(point, "rotation_hz", f"{problem}: at most {fastest:g} Hz")

    def _written(self, point: PlannedPoint) -> Stage:
        return parse_stages(self._procedure)[point.stage_index]

    def _at(self, point: PlannedPoint, field: str, problem: str) -> CapabilityError:
        stage = self._plan.stages[point.stage_index]
        # A third party's stage may lack settings that its excitations have.
        setting = field if field.partition(".")[0] in type(stage).model_fields else ""
        return self._error(f"stages.{point.stage_index}.{setting}".rstrip("."), f"{stage.name} {problem}")

    def _error(self, field: str, problem: str) -> CapabilityError:
        return CapabilityError(self._procedure.name, field, problem)


def _stages_with_brake(plan: Plan, state: Literal["engage", "release"]) -> set[int]:
    """Indices of the stages with the brake in this state."""
    last, indices = None, set()
    for index, stage in enumerate(plan.stages):
        last = stage.leaves_brake or last
        if last == state:
            indices.add(index)
    return indices
