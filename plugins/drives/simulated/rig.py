"""The simulated plant and its current control, step by step, for drives with their own link and protections.

Simulated time passes only while steps are drawn from an iterator. Permissions and aborts belong to the caller.
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
from plugins.drives.simulated._derive import Nameplate, bus_notes, bus_voltage, derive, read_nameplate
from plugins.drives.simulated._permission import Permission
from plugins.drives.simulated._program import DRAIN_S, Planner, Program, Stretch, tune
from plugins.drives.simulated._run import CONTROL, OFF, ControlParameters, Piece
from plugins.drives.simulated._simulator import Simulator, Step, Tripped
from plugins.drives.simulated._state import READING_A, READING_B, SQRT3
from plugins.drives.simulated.options import SimulatedOptions
from protocols import Capabilities, CurrentControl, DriveRefused, Excitation, GatesOff, Hold, Limits, Motor

__all__ = ["Nameplate", "Rig", "Step", "Stretch", "Tripped", "is_ramp"]

ENDLESS_SAMPLES = 1 << 60
"""Length of a state that lasts until the next command, in samples."""
_LATEST = "latest"


@dataclass(frozen=True)
class _Power:
    """Settings of the current control and its limits."""

    control: CurrentControl
    max_current_a: float
    max_voltage_v: float


class Rig:
    """Plant, bench and control of one drive.

    Parameters
    ----------
    options : SimulatedOptions
        Options of the simulated drive; those of its link (watchdog, faults, pace) are ignored.
    motor : Motor
        The nameplate, from which omitted options are scaled.
    seed : int
        The same seed and the same programs give the same samples as `SimulatedDrive`.

    Raises `InputError` where the options do not describe a motor.
    """

    safe_bandwidth_hz: ClassVar[float] = 250.0
    """Control bandwidth of the emergency ramp, where the sampling frequency permits it."""
    safe_ramp_s: ClassVar[float] = 6e-3
    """Shortest emergency ramp, without a jerk of the torque."""

    def __init__(self, options: SimulatedOptions, motor: Motor, seed: int) -> None:
        self.options = options
        self.own_nameplate = self.nameplate = read_nameplate(motor)
        bus_v = bus_voltage(options, self.nameplate)
        plant = derive(options, self.nameplate, bus_v)
        self.permission = Permission.of(options, self.nameplate, plant, bus_v, bus_notes(options, motor, bus_v))
        self.bench = Bench(options.plant, seed)
        rest, fs = self.bench.rest_angle(), options.sampling_frequency_hz
        self.simulator = Simulator(plant, fs, seed, rest, thermometer=options.thermometer)
        self.simulator.hold_rotor(self.bench.mechanics(self.simulator))
        own = self.permission.capabilities
        self._power = _Power(CurrentControl(), own.max_current_a, own.max_voltage_v)
        self.pwm_ratio = 1.0
        self.number = 0
        """Number of programs so far, which seeds the noise of each."""
        self._draws = 0

    # Properties

    @property
    def capabilities(self) -> Capabilities:
        """The drive's capabilities by its options."""
        return self.permission.capabilities

    @property
    def trip_a(self) -> float:
        """Length of the current vector above which a step raises `Tripped`."""
        return self.options.trip_ratio * self._power.max_current_a

    @property
    def ticks(self) -> int:
        """Samples since the start of the experiment's clock."""
        memory = self.simulator.memory
        return memory.ticks + round(memory.base_s * self.options.sampling_frequency_hz)

    @property
    def reading_a(self) -> float:
        """Present length of the current vector as measured, without noise."""
        x = self.simulator.memory.state
        return math.hypot(x[READING_A], (x[READING_A] + 2.0 * x[READING_B]) / SQRT3)

    @property
    def braked(self) -> bool:
        return self.bench.braked

    # Commands

    def limit(self, limits: Limits) -> None:
        """Set the limits of an experiment."""
        self._power = replace(self._power, max_current_a=limits.current_a, max_voltage_v=limits.voltage_v)

    def retune(self, nameplate: Nameplate) -> None:
        """Tune the control by this nameplate."""
        self.nameplate = nameplate

    def set_brake(self, engaged: bool) -> None:
        """Engage or release the brake; engaging turns the shaft by the plant's misalignment."""
        self.bench.set_brake(engaged, self.simulator)

    def check(self, excitation: Excitation, limits: Limits) -> None:
        """Raises `DriveRefused` for an excitation beyond these limits or the drive's own."""
        refuse_excitation(excitation, limits, self.capabilities, self.own_nameplate.resistance_ohm)
        self.permission.check(excitation, braked=self.braked)

    # Motion

    def excite(self, excitation: Excitation, samples: int) -> Iterator[Step]:
        """Run an excitation from the present operating point; `hold` then keeps its end."""
        self.number += 1
        program = self.program(excitation)
        noise = self.simulator.noise(0, self.number)
        return self.simulator.stepwise(program, self.tuning(), self.pwm_ratio, noise, samples)

    def program(self, excitation: Excitation) -> Program:
        """Set an excitation's control, frame and PWM frequency; returns its program from the present set-point."""
        self._power = replace(self._power, control=excitation.control)
        pwm = excitation.pwm_frequency_hz
        self.pwm_ratio = 1.0 if pwm is None else pwm / self.capabilities.pwm_frequency_hz
        self.simulator.set_believed_angle(excitation.rotor_angle_rad)
        return self.planner.program(excitation, self.simulator.set_point)

    def length(self, excitation: Excitation) -> int:
        """Samples of an excitation's program, settling included, without running it."""
        return self.planner.program(excitation, self.simulator.set_point).samples

    def hold(self, samples: int) -> Iterator[Step]:
        """Hold the present operating point, without end."""
        still = Piece(CONTROL, ENDLESS_SAMPLES, *self.simulator.set_point)
        return self._run(Program((Stretch(still),)), samples)

    def record(self, rows: int, off: bool, samples: int) -> Iterator[Step]:
        """Capture rows at the present operating point, or with the gates off."""
        still = Piece(OFF, rows) if off else Piece(CONTROL, rows, *self.simulator.set_point)
        return self._run(Program((Stretch(still, captured=True),)), samples)

    def off(self, samples: int) -> Iterator[Step]:
        """Gates off, without end."""
        return self._run(Program((Stretch(Piece(OFF, ENDLESS_SAMPLES)),)), samples)

    def drain(self) -> None:
        """Switch the gates off and run until the current has decayed through the diodes."""
        for _ in self._run(self.gates_off(), ENDLESS_SAMPLES):
            pass

    def to_zero(self, samples: int) -> Iterator[Step]:
        """Ramp the current to zero at the control's bandwidth."""
        return self._run(self.ramp_down(), samples)

    def ramp_down(self) -> Program:
        """Program that ramps the current to zero and brings a driven rotor to rest."""
        program = self.planner.to_zero(self._power.control, self.simulator.set_point)
        if not self.simulator.is_driven:
            return program
        return Program((*program.stretches, self.planner.decelerate(CONTROL, self.simulator.speed_rad_s)))

    def gates_off(self) -> Program:
        """Program with the gates off until the current has decayed; a driven rotor is brought to rest."""
        off = Stretch(Piece(OFF, max(1, self.planner.samples(DRAIN_S))))
        if not self.simulator.is_driven:
            return Program((off,))
        return Program((off, self.planner.decelerate(OFF, self.simulator.speed_rad_s)))

    def to_safety(self, samples: int) -> Iterator[Step]:
        """Ramp the current to zero as fast as voltage and sampling permit without a jerk, in about 10 ms."""
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
        """Planner for the present nameplate."""
        return Planner(self.options.sampling_frequency_hz, self.nameplate, self.capabilities.max_voltage_v)

    def tuning(self, control: CurrentControl | None = None) -> ControlParameters:
        """Present parameters of the control."""
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
        """Write the plant's state and the faults that have occurred; raises `StorageError`."""
        memory, power = self.simulator.memory, self._power.control
        saved = _memory.Saved(memory, self.number, self.braked, power.bandwidth_hz, power.damping, tuple(sorted(fired)))
        _memory.save(directory, point_id, saved)

    def restore(self, directory: Path, point_id: str) -> tuple[int, ...]:
        """Restore a saved state; returns the faults that had occurred. Raises `DriveRefused` where there is none."""
        saved = _memory.load(directory, point_id)
        self.simulator.memory = saved.memory
        self.number, self.bench.braked = saved.number, saved.braked
        control = CurrentControl(bandwidth_hz=saved.bandwidth_hz, damping=saved.damping)
        self._power = replace(self._power, control=control)
        self.simulator.parameters = self.bench.mechanics(self.simulator)
        return saved.fired

    def load(self, directory: Path) -> bool:
        """Restore the latest saved state with the gates off; returns False where there is none."""
        try:
            self.restore(directory, _LATEST)
        except DriveRefused:
            return False
        self.drain()
        return True


def is_ramp(stretch: Stretch) -> bool:
    """Whether the set-point changes during the stretch."""
    return stretch.piece.mode == CONTROL and (stretch.piece.slope_d, stretch.piece.slope_q) != (0.0, 0.0)
