"""What a stage leaves out, derived from nameplate, limits and sampling frequency; no motor's numbers are in here.

With I the rated current (peak), L and R the nameplate's, f_s the drive's sampling frequency:
amplitudes are 1.25 I within 0.8 of the limit; injection is at f_s/20 with the voltage that
swings the flux by 0.2 I L_d (a square wave U swings it by U/(4 f), a sine by U/(2 pi f));
settling takes five time constants of the current control and of L/R, and as long again, since
the second half of it is averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from orchestrator.config import _patterns
from protocols import (
    AlignmentStage,
    ClassicalStage,
    CurrentControl,
    InjectionStage,
    LockCheckStage,
    Point,
    Procedure,
    ProcedureError,
    ResistanceStage,
    Stage,
)

NOMINAL_SAMPLING_HZ = 10_000.0
"""Taken where no drive was asked."""

_OVER_RATED = 1.25
_OF_LIMIT = 0.8
_HEADROOM = 0.95
_SAMPLES_PER_PERIOD = 20
_PERIODS_PER_TURN = 250
_TURNS = 2
_SWING = 0.2
_TIME_CONSTANTS = 5.0
_SHORTEST_HOLD_S = 0.5


@dataclass
class Scaling:
    """Fills stages of one procedure.

    Attributes
    ----------
    procedure : Procedure
    sampling_hz : float
        The drive's sampling frequency.
    notes : list of str
        What a person should know of what was filled in.
    """

    procedure: Procedure
    sampling_hz: float
    notes: list[str] = field(default_factory=list)

    def fill_all(self, appended: Sequence[Stage] = ()) -> tuple[Stage, ...]:
        """Every stage with nothing left out, the appended ones after the procedure's.

        Raises
        ------
        ProcedureError
            Where the nameplate lacks what a setting is scaled from; names both.
        """
        stages = [self._fill(index, stage) for index, stage in enumerate(self.procedure.stages)]
        for index, stage in enumerate(stages):
            if stage.kind == "lock_check":
                stages[index] = self._lock_check(index, stage, stages[index + 1 :])
        more = [self._fill(index, stage) for index, stage in enumerate(appended, start=len(stages))]
        return (*stages, *more)

    def _fill(self, index: int, stage: Stage) -> Stage:
        if isinstance(stage, AlignmentStage):
            return self._alignment(index, stage)
        if isinstance(stage, ResistanceStage):
            return self._resistance(index, stage)
        if isinstance(stage, ClassicalStage):
            return self._classical(index, stage)
        if isinstance(stage, InjectionStage):
            return self._injection(index, stage)
        return stage

    def _alignment(self, index: int, stage: AlignmentStage) -> AlignmentStage:
        current = stage.current_a
        if current is None:
            rated = self._rated_current(index, "current_a")
            current = _tidy(min(rated, _OF_LIMIT * self.procedure.limits.current_a))
        return stage.model_copy(update={"current_a": current, "control": self._control(stage.control)})

    def _resistance(self, index: int, stage: ResistanceStage) -> ResistanceStage:
        points = stage.points_a
        if points is None:
            amplitude = self._amplitude(index, "points_a")
            points = (self._anchor(amplitude),) if stage.anchor else tuple(_patterns.resistance_steps(amplitude))
        duration = stage.duration_s
        if duration is None:
            duration = max(_SHORTEST_HOLD_S, _tidy(2 * _TIME_CONSTANTS * self._time_constant(index, "duration_s")))
        settle = self._settle(index, stage.settle_s, stage.control)
        update = {"points_a": points, "settle_s": settle, "duration_s": duration}
        return stage.model_copy(update={**update, "control": self._control(stage.control)})

    def _classical(self, index: int, stage: ClassicalStage) -> ClassicalStage:
        amplitude = stage.amplitude_a if stage.amplitude_a is not None else self._amplitude(index, "amplitude_a")
        held = stage.held_a
        if held is None:
            # Corners of the swept square stay within the limit.
            room = (_HEADROOM * self.procedure.limits.current_a) ** 2 - amplitude**2
            held = _patterns.five_values(min(amplitude, _tidy(math.sqrt(room)))) if room > 0 else (0.0,)
        settle = self._settle(index, stage.settle_s, stage.control)
        update = {"amplitude_a": amplitude, "held_a": held, "settle_s": settle}
        return stage.model_copy(update={**update, "control": self._control(stage.control)})

    def _injection(self, index: int, stage: InjectionStage) -> InjectionStage:
        frequency = self._frequency(stage.frequency_hz)
        rotation, duration = _turns(stage.rotation_hz, stage.duration_s, frequency)
        amplitudes = stage.amplitudes_v
        if amplitudes is None:
            amplitude = self._voltage(index, "amplitudes_v", frequency, stage.waveform)
            amplitudes = tuple(_tidy(ratio * amplitude) for ratio in stage.amplitude_ratios)
        points = stage.points_a
        if points is None:
            points = self._pattern(index, stage, ripple_a=self.ripple_a(max(amplitudes), frequency, stage.waveform))
        update = {
            "points_a": points,
            "amplitudes_v": amplitudes,
            "frequency_hz": frequency,
            "rotation_hz": rotation,
            "duration_s": duration,
            "settle_s": self._settle(index, stage.settle_s, stage.control),
            "control": self._control(stage.control),
        }
        return stage.model_copy(update=update)

    def _lock_check(self, index: int, stage: LockCheckStage, later: Sequence[Stage]) -> LockCheckStage:
        frequency = self._frequency(stage.frequency_hz)
        rotation, duration = _turns(stage.rotation_hz, stage.duration_s, frequency)
        amplitude = stage.amplitude_v or self._voltage(index, "amplitude_v", frequency, "square")
        torque = stage.torque_current_a
        if torque is None:
            torque = max(map(largest_q, later), default=0.0) or self._amplitude(index, "torque_current_a")
        update = {
            "torque_current_a": torque,
            "amplitude_v": amplitude,
            "frequency_hz": frequency,
            "rotation_hz": rotation,
            "duration_s": duration,
            "settle_s": self._settle(index, stage.settle_s, stage.control),
            "control": self._control(stage.control),
        }
        return stage.model_copy(update=update)

    def _pattern(self, index: int, stage: InjectionStage, ripple_a: float) -> tuple[Point, ...]:
        reach = stage.range_a if stage.range_a is not None else self._amplitude(index, "range_a")
        if stage.anchor:
            return (self._anchor(reach),)
        step = stage.step_a if stage.step_a is not None else reach / (30 if stage.pattern == "paths" else 2)
        lines = 2 * len(stage.held_a or range(5)) + 1 if stage.pattern == "paths" else 2 * reach / step + 1
        if (2 * reach / step + 1) * lines > _patterns.MOST_POINTS:
            raise self._error(f"stages.{index}.step_a", f"{step:g} A gives more than {_patterns.MOST_POINTS} points")
        along = _patterns.steps(reach, step)
        if stage.pattern == "paths":
            points = _patterns.paths(stage.axes, stage.held_a or _patterns.five_values(reach), along)
        else:
            points = _patterns.grid(stage.held_a or along, along)
        if stage.range_a is not None or stage.held_a is not None:
            return tuple(points)
        return self._clipped(index, points, ripple_a)

    def _clipped(self, index: int, points: Sequence[Point], ripple_a: float) -> tuple[Point, ...]:
        kept = _patterns.within(points, _HEADROOM * self.procedure.limits.current_a - ripple_a)
        if not kept:
            problem = f"the injection's ripple of {ripple_a:.3g} A leaves no room below limits.current_a"
            raise self._error(f"stages.{index}.amplitudes_v", problem)
        if len(kept) < len(points):
            left_out = len(points) - len(kept)
            self.notes.append(
                f"stages.{index} (injection): {left_out} of {len(points)} points left out, beyond limits.current_a"
            )
        return tuple(kept)

    def ripple_a(self, amplitude_v: float, frequency_hz: float, waveform: str) -> float:
        """Peak of the current ripple on the axis of the smaller inductance [A]; 0 where none is known."""
        known = [value for value in (self.procedure.motor.d_inductance_h, self.procedure.motor.q_inductance_h) if value]
        return _swing_wb(amplitude_v, frequency_hz, waveform) / min(known) if known else 0.0

    def _anchor(self, amplitude: float) -> Point:
        return (_tidy(2 / 3 * amplitude), 0.0)

    def _amplitude(self, index: int, setting: str) -> float:
        rated = self._rated_current(index, setting)
        return _tidy(min(_OVER_RATED * rated, _OF_LIMIT * self.procedure.limits.current_a))

    def _frequency(self, given: float | None) -> float:
        return given if given is not None else self.sampling_hz / _SAMPLES_PER_PERIOD

    def _voltage(self, index: int, setting: str, frequency_hz: float, waveform: str) -> float:
        inductance = self._needed("d_inductance_h", self.procedure.motor.d_inductance_h, index, setting)
        swing = _SWING * self._rated_current(index, setting) * inductance
        resistance = self.procedure.motor.stator_resistance_ohm or 0.0
        room = self.procedure.limits.voltage_v - resistance * self.procedure.limits.current_a
        if room <= 0:
            problem = f"leaves no room for injection beside R_s i at limits.current_a (stages.{index}.{setting})"
            raise self._error("limits.voltage_v", problem)
        return _tidy(min(swing / _swing_wb(1.0, frequency_hz, waveform), _OF_LIMIT * room))

    def _settle(self, index: int, given: float | None, control: CurrentControl | None) -> float:
        if given is not None:
            return given
        used = self._control(control)
        of_control = 1 / (used.damping * 2 * math.pi * used.bandwidth_hz)
        return _tidy(2 * _TIME_CONSTANTS * (of_control + self._time_constant(index, "settle_s")))

    def _time_constant(self, index: int, setting: str) -> float:
        motor = self.procedure.motor
        resistance = self._needed("stator_resistance_ohm", motor.stator_resistance_ohm, index, setting)
        inductance = max(motor.d_inductance_h or 0.0, motor.q_inductance_h or 0.0) or None
        return self._needed("q_inductance_h", inductance, index, setting) / resistance

    def _rated_current(self, index: int, setting: str) -> float:
        return self._needed("rated_current_rms_a", self.procedure.motor.rated_current_a, index, setting)

    def _control(self, given: CurrentControl | None) -> CurrentControl:
        return given if given is not None else self.procedure.control

    def _needed(self, name: str, value: float | None, index: int, setting: str) -> float:
        if value is None:
            problem = f"missing, and stages.{index}.{setting} is derived from it: give one of the two"
            raise self._error(f"motor.{name}", problem)
        return value

    def _error(self, key: str, problem: str) -> ProcedureError:
        return ProcedureError(self.procedure.name, key, problem)


def largest_q(stage: Stage) -> float:
    """Largest current on the q axis that a filled stage asks for [A]."""
    if isinstance(stage, ResistanceStage | InjectionStage):
        return max((abs(q) for _, q in stage.points_a or ()), default=0.0)
    if isinstance(stage, ClassicalStage) and stage.amplitude_a is not None:
        held = max(map(abs, stage.held_a or ()), default=0.0)
        reach = {"q": stage.amplitude_a, "d": held, "dq": stage.amplitude_a / math.sqrt(2)}
        return max((reach[axis] for axis in stage.axes), default=0.0)
    return 0.0


def _swing_wb(amplitude_v: float, frequency_hz: float, waveform: str) -> float:
    return amplitude_v / ((4.0 if waveform == "square" else 2 * math.pi) * frequency_hz)


def _turns(rotation_hz: float | None, duration_s: float | None, frequency_hz: float) -> tuple[float, float]:
    """Rotation and duration such that the duration holds whole turns, where either is free."""
    usual = frequency_hz / _PERIODS_PER_TURN
    if duration_s is None:
        rotation_hz = rotation_hz if rotation_hz is not None else usual
        return rotation_hz, max(1, round(_TURNS * rotation_hz / usual)) / rotation_hz
    if rotation_hz is None:
        return max(1, round(usual * duration_s)) / duration_s, duration_s
    return rotation_hz, duration_s


def _tidy(value: float) -> float:
    """Rounded to two significant digits: these settings end up where people read them."""
    return float(f"{value:.2g}")
