"""The simulated plant and its current control, step by step, for drives that bring link and protections of their own.

Simulated time passes only in the steps that are drawn. Who may ask for what, and when it stops, is
not known here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from orchestrator.driving import refuse_excitation
from plugins.drives.simulated import _memory
from plugins.drives.simulated._bench import Bench
from plugins.drives.simulated._derive import Nameplate, bus_voltage, derive, read_nameplate
from plugins.drives.simulated._permission import Permission
from plugins.drives.simulated._program import DRAIN_S, Planner, Program, Stretch, tune
from plugins.drives.simulated._run import CONTROL, OFF, ControlParameters, Piece
from plugins.drives.simulated._simulator import Simulator, Step, Tripped
from plugins.drives.simulated._state import READING_A, READING_B, SQRT3
from plugins.drives.simulated.options import SimulatedOptions
from protocols import Capabilities, CurrentControl, DriveRefused, Excitation, GatesOff, Hold, Limits, Motor

__all__ = ["Nameplate", "Rig", "Step", "Stretch", "Tripped", "is_ramp"]

ENDLESS_SAMPLES = 1 << 60
"""Samples of a state that lasts until the next command."""
_LATEST = "latest"


@dataclass(frozen=True)
class _Power:
    """What the control is tuned with."""

    control: CurrentControl
    max_current_a: float
    max_voltage_v: float


class Rig:
    """Plant, bench and control of one drive.

    Parameters
    ----------
    options : SimulatedOptions
        Of the simulated drive; what belongs to its link (watchdog, faults, pace) is not looked at.
    motor : Motor
        The nameplate from which sizes that were left out are scaled.
    seed : int
        The same seed and the same programs give the same samples as `SimulatedDrive`.

    Raises `InputError` where the options make no motor.
    """

    safe_bandwidth_hz: ClassVar[float] = 250.0
    """Bandwidth with which a current is brought to safety, where the sampling allows it."""
    safe_ramp_s: ClassVar[float] = 6e-3
    """Shortest ramp to safety: fast, but without a jerk."""

    def __init__(self, options: SimulatedOptions, motor: Motor, seed: int) -> None:
        self.options = options
        self.own_nameplate = self.nameplate = read_nameplate(motor)
        bus_v = bus_voltage(options, self.nameplate)
        plant = derive(options, self.nameplate, bus_v)
        self.permission = Permission.of(options, self.nameplate, plant, bus_v)
        self.bench = Bench(options.plant, seed)
        rest, fs = self.bench.rest_angle(), options.sampling_frequency_hz
        self.simulator = Simulator(plant, fs, seed, rest, thermometer=options.thermometer)
        self.simulator.hold_rotor(self.bench.mechanics(self.simulator))
        own = self.permission.capabilities
        self._power = _Power(CurrentControl(), own.max_current_a, own.max_voltage_v)
        self.pwm_ratio = 1.0
        self.number = 0
        """Programs so far: the noise of each is its own."""
        self._draws = 0

    # What it is

    @property
    def capabilities(self) -> Capabilities:
        """What the options make of the drive."""
        return self.permission.capabilities

    @property
    def trip_a(self) -> float:
        """Length of the current vector above which a step raises `Tripped`."""
        return self.options.trip_ratio * self._power.max_current_a

    @property
    def ticks(self) -> int:
        """Samples since the plant was made."""
        memory = self.simulator.memory
        return memory.ticks + round(memory.base_s * self.options.sampling_frequency_hz)

    @property
    def reading_a(self) -> float:
        """Length of the current vector as the sensors see it now, without noise."""
        x = self.simulator.memory.state
        return math.hypot(x[READING_A], (x[READING_A] + 2.0 * x[READING_B]) / SQRT3)

    @property
    def braked(self) -> bool:
        return self.bench.braked

    # Commands

    def limit(self, limits: Limits) -> None:
        """Take over the limits of an experiment."""
        self._power = replace(self._power, max_current_a=limits.current_a, max_voltage_v=limits.voltage_v)

    def believe(self, nameplate: Nameplate) -> None:
        """Tune the control with this nameplate."""
        self.nameplate = nameplate

    def set_brake(self, engaged: bool) -> None:
        """Move the brake; as it engages it turns the shaft by the plant's misalignment."""
        self.bench.set_brake(engaged, self.simulator)

    def check(self, excitation: Excitation, limits: Limits) -> None:
        """Raises `DriveRefused` for what these limits, or this drive, do not allow."""
        refuse_excitation(excitation, limits, self.capabilities, self.own_nameplate.resistance_ohm)
        self.permission.check(excitation, braked=self.braked)

    # What it does

    def excite(self, excitation: Excitation, samples: int) -> Iterator[Step]:
        """A program, from the present operating point on; its end is held by `hold`."""
        self.number += 1
        program = self.program(excitation)
        noise = self.simulator.noise(0, self.number)
        return self.simulator.stepwise(program, self.tuning(), self.pwm_ratio, noise, samples)

    def program(self, excitation: Excitation) -> Program:
        """Take over an excitation's control, frame and PWM frequency; its program from the present operating point."""
        self._power = replace(self._power, control=excitation.control)
        pwm = excitation.pwm_frequency_hz
        self.pwm_ratio = 1.0 if pwm is None else pwm / self.capabilities.pwm_frequency_hz
        self.simulator.believe(excitation.rotor_angle_rad)
        return self.planner.program(excitation, self.simulator.set_point)

    def length(self, excitation: Excitation) -> int:
        """Samples of a program, settling included; nothing moves."""
        return self.planner.program(excitation, self.simulator.set_point).samples

    def hold(self, samples: int) -> Iterator[Step]:
        """The present operating point, without end."""
        still = Piece(CONTROL, ENDLESS_SAMPLES, *self.simulator.set_point)
        return self._run(Program((Stretch(still),)), samples)

    def record(self, rows: int, off: bool, samples: int) -> Iterator[Step]:
        """Capture so many rows of what is being held (of the gates' being off)."""
        still = Piece(OFF, rows) if off else Piece(CONTROL, rows, *self.simulator.set_point)
        return self._run(Program((Stretch(still, captured=True),)), samples)

    def off(self, samples: int) -> Iterator[Step]:
        """Gates off, without end."""
        return self._run(Program((Stretch(Piece(OFF, ENDLESS_SAMPLES)),)), samples)

    def drain(self) -> None:
        """Gates off at once, until the diodes have brought the current to zero."""
        for _ in self._run(self.gates_off(), ENDLESS_SAMPLES):
            pass

    def to_zero(self, samples: int) -> Iterator[Step]:
        """Current to zero at the pace of the control's bandwidth."""
        return self._run(self.down(), samples)

    def down(self) -> Program:
        """From the present set-point to zero, and a rotor that is turned to rest."""
        program = self.planner.to_zero(self._power.control, self.simulator.set_point)
        if not self.simulator.turns:
            return program
        return Program((*program.stretches, self.planner.at_rest(CONTROL, self.simulator.speed_rad_s)))

    def gates_off(self) -> Program:
        """Gates off until the diodes have brought the current to zero; a rotor that is turned comes to rest."""
        off = Stretch(Piece(OFF, max(1, self.planner.samples(DRAIN_S))))
        if not self.simulator.turns:
            return Program((off,))
        return Program((off, self.planner.at_rest(OFF, self.simulator.speed_rad_s)))

    def to_safety(self, samples: int) -> Iterator[Step]:
        """Current to zero as fast as voltage and sampling allow without a jerk: about 10 ms."""
        fs, (d, q) = self.options.sampling_frequency_hz, self.simulator.set_point
        reach_s = max(self.nameplate.l_d_h, self.nameplate.l_q_h) * math.hypot(d, q) / (0.5 * self._power.max_voltage_v)
        ramp = max(1, self.planner.samples(max(Rig.safe_ramp_s, reach_s)))
        fast = CurrentControl(bandwidth_hz=max(self._power.control.bandwidth_hz, min(Rig.safe_bandwidth_hz, fs / 20)))
        stretches = (
            Stretch(Piece(CONTROL, ramp, d, q, -d / ramp, -q / ramp)),
            Stretch(Piece(CONTROL, ramp // 2)),
        )
        return self._run(Program(stretches), samples, fast)

    def warm_up(self) -> None:
        """Compile everything; nothing moves."""
        simulator, number = self.simulator, self.number
        memory = simulator.memory
        simulator.memory = replace(memory, state=memory.state.copy())
        for excitation in (
            Hold(current_d_a=0.0, current_q_a=0.0, settle_s=0.0, duration_s=2e-3),
            GatesOff(duration_s=2e-3),
        ):
            for _ in self.excite(excitation, ENDLESS_SAMPLES):
                pass
        simulator.memory, self.number = memory, number

    def _run(self, program: Program, samples: int, control: CurrentControl | None = None) -> Iterator[Step]:
        self._draws += 1
        noise = self.simulator.noise(7, self._draws)
        return self.simulator.stepwise(program, self.tuning(control), self.pwm_ratio, noise, samples)

    @property
    def planner(self) -> Planner:
        """Makes programs by the present nameplate."""
        return Planner(self.options.sampling_frequency_hz, self.nameplate, self.capabilities.max_voltage_v)

    def tuning(self, control: CurrentControl | None = None) -> ControlParameters:
        """The control as it is tuned now."""
        return tune(
            self.nameplate,
            control or self._power.control,
            self.simulator.memory.angle_rad,
            self.options.sampling_frequency_hz,
            max_v=self._power.max_voltage_v,
            trip_a=self.trip_a,
            overload_s=self.options.overload_s,
            encoder_ratio=self.options.plant.rotor.encoder_ratio,
            delay_samples=self.capabilities.voltage_delay_samples,
        )

    # Memory

    def save(self, directory: Path, point_id: str = _LATEST, fired: Iterable[int] = ()) -> None:
        """Write the plant's state, and which faults have struck; raises `StorageError`."""
        memory, power = self.simulator.memory, self._power.control
        saved = _memory.Saved(memory, self.number, self.braked, power.bandwidth_hz, power.damping, tuple(sorted(fired)))
        _memory.save(directory, point_id, saved)

    def take_up(self, directory: Path, point_id: str) -> tuple[int, ...]:
        """Go on from a state that was saved; which faults had struck. Raises `DriveRefused` where there is none."""
        saved = _memory.load(directory, point_id)
        self.simulator.memory = saved.memory
        self.number, self.bench.braked = saved.number, saved.braked
        control = CurrentControl(bandwidth_hz=saved.bandwidth_hz, damping=saved.damping)
        self._power = replace(self._power, control=control)
        self.simulator.parameters = self.bench.mechanics(self.simulator)
        return saved.fired

    def load(self, directory: Path) -> bool:
        """Take up the latest state that was saved, gates off; whether there was one."""
        try:
            self.take_up(directory, _LATEST)
        except DriveRefused:
            return False
        self.drain()
        return True


def is_ramp(stretch: Stretch) -> bool:
    """Whether the set-point is under way."""
    return stretch.piece.mode == CONTROL and (stretch.piece.slope_d, stretch.piece.slope_q) != (0.0, 0.0)
