"""Runs programs on the plant: the drive's firmware loop, its clock and its memory.

Permissions, link and wall time belong to `drive`. Everything that a resumed run needs is in `Memory`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from plugins.drives.simulated import _state as layout
from plugins.drives.simulated._bridge import NO_EDGE_S
from plugins.drives.simulated._derive import TruePlant
from plugins.drives.simulated._energy import Array
from plugins.drives.simulated._program import Program, Stretch
from plugins.drives.simulated._run import CONTROL, OFF, ControlParameters, Piece, run
from plugins.drives.simulated._sensing import BenchParameters, Rows
from plugins.drives.simulated._state import PlantParameters
from plugins.drives.simulated._switching import at_frequency
from protocols import Capture

_Buffers = tuple[Rows, Rows, Rows, Rows]
"""i_ab, v_ab, v_dc and i_abc; i_abc is empty on a drive with two sensors."""


class Tripped(Exception):
    """The drive's own protection acted: overload, or else overcurrent."""

    def __init__(self, overload: bool) -> None:
        self.overload = overload
        super().__init__("overload" if overload else "overcurrent")


class Step(NamedTuple):
    """A few samples of a program, captured or not; the arrays are overwritten by the next step."""

    stretch: Stretch
    i_ab: Rows
    """Shape (n, 2)."""
    v_ab: Rows
    v_dc: Rows


@dataclass
class Memory:
    """State of plant and control."""

    state: Array
    ticks: int = 0
    """Samples since `base_s`."""
    base_s: float = 0.0
    angle_rad: float = 0.0
    """Believed rotor angle of the frame in which the control's state is kept."""
    base_v: tuple[float, float] = (0.0, 0.0)
    """Frozen voltage of the last injection."""
    open_loop: bool = False


class Simulator:
    """Plant, sensors and control loop, sample by sample."""

    block_s: ClassVar[float] = 0.5
    """Duration of the longest block of rows."""
    start_c: ClassVar[float] = 20.0
    """Winding temperature at the start [C]."""
    copper_per_k: ClassVar[float] = 3.93e-3
    """Temperature coefficient of copper at 20 degrees (IEC 60028) [1/K]."""

    def __init__(
        self,
        plant: TruePlant,
        sampling_frequency_hz: float,
        seed: int,
        angle_rad: float,
        *,
        thermometer: bool = False,
    ) -> None:
        self.plant = plant
        self.parameters = plant.parameters
        self.sampling_frequency_hz = sampling_frequency_hz
        self.seed = seed % 2**64
        self.block = max(1, int(Simulator.block_s * sampling_frequency_hz))
        self._thermometer = thermometer
        self._sums = np.zeros(2)
        self._three = plant.bench is not None and plant.bench.sensing.three
        self._scratch = _buffers(self.block, self._three)
        state = np.zeros(layout.STATE_LENGTH)
        state[layout.PSI_D] = plant.magnetics.energy.psi_m
        state[layout.BUS] = state[layout.SUPPLY] = self.parameters.dc_bus_v
        state[layout.DUE : layout.DUE + 3] = NO_EDGE_S
        self.memory = Memory(state)
        self.turn_to(angle_rad)

    @property
    def time_s(self) -> float:
        """Time of the drive's clock."""
        return self.memory.base_s + self.memory.ticks / self.sampling_frequency_hz

    @property
    def set_point(self) -> tuple[float, float]:
        """Present current set-point in the believed dq frame [A]."""
        x = self.memory.state
        return float(x[layout.COMMAND_D]), float(x[layout.COMMAND_Q])

    @property
    def filtered(self) -> tuple[float, float, float]:
        """Low-pass filtered readings (i_d [A], i_q [A], v_dc [V]) of telemetry."""
        x = self.memory.state
        return float(x[layout.FILTERED_D]), float(x[layout.FILTERED_Q]), float(x[layout.BUS])

    @property
    def temperature_c(self) -> float | None:
        """Winding temperature from the rise of its resistance; None without a thermometer."""
        if not self._thermometer:
            return None
        return self.start_c + float(self.memory.state[layout.HEAT]) / self.copper_per_k

    def turn_to(self, theta_rad: float) -> None:
        """Set the electrical angle of the resting rotor."""
        x = self.memory.state
        x[layout.THETA] = x[layout.ANCHOR] = theta_rad
        x[layout.COS], x[layout.SIN] = np.cos(theta_rad), np.sin(theta_rad)

    def hold_rotor(self, parameters: PlantParameters) -> None:
        """Replace the mechanical parameters; the rotor is at rest."""
        self.parameters = parameters
        x = self.memory.state
        x[layout.MOVING] = x[layout.OMEGA] = 0.0

    def set_believed_angle(self, angle_rad: float) -> None:
        """Transform the control's state into another believed frame; the stator voltages do not change."""
        turn = self.memory.angle_rad - angle_rad
        if turn == 0.0:
            return
        c, s, x = np.cos(turn), np.sin(turn), self.memory.state
        for d, q in ((layout.INTEGRAL_D, layout.INTEGRAL_Q), (layout.COMMAND_D, layout.COMMAND_Q)):
            x[d], x[q] = c * x[d] - s * x[q], s * x[d] + c * x[q]
        v_d, v_q = self.memory.base_v
        self.memory.base_v = (float(c * v_d - s * v_q), float(s * v_d + c * v_q))
        self.memory.angle_rad = angle_rad

    def noise(self, *number: int) -> np.random.Generator:
        """Noise generator of one excitation, independent of those before it."""
        return np.random.Generator(np.random.SFC64(np.random.SeedSequence([self.seed, *number])))

    def run(
        self,
        program: Program,
        control: ControlParameters,
        pwm_ratio: float,
        noise: np.random.Generator,
        breakpoints: tuple[int, ...],
    ) -> Iterator[Capture | int]:
        """Run a program; yields captures, and each number of `breakpoints` once that many samples are done.

        Raises
        ------
        Tripped
            Where the reading is above the trip level; the rest of the program is not run.
        """
        switching = self._switching(pwm_ratio)
        pending = sorted(breakpoints)
        elapsed, rows, remaining = 0, self._scratch, program.captured
        temperature = np.empty(0, np.float32)
        theta = np.empty(0, np.float64)
        filled, space = 0, 0
        for stretch in program.stretches:
            if stretch.averaged:
                self._sums[:] = 0.0
            piece, done = self._begin(stretch, control), 0
            while done < piece.samples:
                while pending and pending[0] <= elapsed:
                    yield pending.pop(0)
                if stretch.captured and space == 0:
                    space, filled = min(self.block, remaining), 0
                    start_s = self.time_s
                    rows, temperature = _buffers(space, self._three), np.empty(space, np.float32)
                    theta = np.empty(space)
                n = min(piece.samples - done, space if stretch.captured else self.block)
                if pending:
                    n = min(n, pending[0] - elapsed)
                before = self.temperature_c
                if self.is_driven and stretch.captured:
                    theta[filled : filled + n] = self._encoder(control, n)
                self._rows(
                    switching, control, piece, done, n, noise, rows if stretch.captured else self._scratch, filled
                )
                if before is not None and self.temperature_c is not None and stretch.captured:
                    temperature[filled : filled + n] = np.linspace(before, self.temperature_c, n, endpoint=False)
                done += n
                elapsed += n
                if stretch.captured:
                    filled, space, remaining = filled + n, space - n, remaining - n
                    if space == 0:
                        yield Capture(
                            start_s=start_s,
                            sampling_frequency_hz=self.sampling_frequency_hz,
                            i_ab=rows[0],
                            v_ab=rows[1],
                            v_dc=rows[2],
                            i_abc=rows[3] if self._three else None,
                            temperature_c=temperature if self._thermometer else None,
                            theta_rad=theta if self.is_driven else None,
                        )
                        filled = 0
            self._end(stretch)
        yield from pending

    def stepwise(
        self,
        program: Program,
        control: ControlParameters,
        pwm_ratio: float,
        noise: np.random.Generator,
        samples: int,
    ) -> Iterator[Step]:
        """As `run`, in steps of at most `samples`, between which a drive serves its link and watchdog.

        Raises
        ------
        Tripped
            Where the reading is above the trip level; the rows of that step are lost.
        """
        for stretch in program.stretches:
            if stretch.averaged:
                self._sums[:] = 0.0
            piece, done = self._begin(stretch, control), 0
            while done < piece.samples:
                n = min(piece.samples - done, samples, self.block)
                self._rows(self._switching(pwm_ratio), control, piece, done, n, noise, self._scratch, 0)
                done += n
                i, v, bus, _ = self._scratch
                yield Step(stretch, i[:n], v[:n], bus[:n])
            self._end(stretch)

    def _switching(self, pwm_ratio: float) -> tuple[PlantParameters, BenchParameters | None]:
        """Plant and inverter at `pwm_ratio` times the drive's own PWM frequency."""
        bench = self.plant.bench
        if bench is None:
            return self.parameters._replace(dead_time_v=self.plant.parameters.dead_time_v * pwm_ratio), None
        return self.parameters, bench._replace(switching=at_frequency(bench.switching, self.parameters, pwm_ratio))

    def _rows(
        self,
        switching: tuple[PlantParameters, BenchParameters | None],
        control: ControlParameters,
        piece: Piece,
        done: int,
        count: int,
        noise: np.random.Generator,
        rows: _Buffers,
        at: int,
    ) -> None:
        x = self.memory.state
        parameters, bench = switching
        values = noise.standard_normal((count, 2 if bench is None else 6), dtype=np.float32)
        i, v, bus, phases = (array[at : at + count] for array in rows)
        finished = run(
            parameters,
            *self.plant.magnetics,
            self.plant.sensors,
            control,
            piece,
            done,
            count,
            x,
            self._sums,
            values,
            i,
            v,
            bus,
            phases,
            bench,
        )
        self.memory.ticks += finished
        if finished < count:
            raise Tripped(bool(x[layout.OVERLOAD] > control.overload_s))

    @property
    def is_driven(self) -> bool:
        """Whether another machine drives the rotor."""
        return float(self.memory.state[layout.MOVING]) == layout.MOVING_DRIVEN

    @property
    def speed_rad_s(self) -> float:
        """Electrical speed."""
        return float(self.memory.state[layout.OMEGA])

    def _encoder(self, control: ControlParameters, rows: int) -> Array:
        """Readings of the angle sensor at the next rows, extrapolated at constant speed."""
        x = self.memory.state
        turned = x[layout.THETA] - x[layout.ANCHOR] + x[layout.OMEGA] * control.sample_s * np.arange(rows)
        return np.asarray(np.mod(control.angle_rad + control.encoder_ratio * turned, 2.0 * np.pi))

    def _begin(self, stretch: Stretch, control: ControlParameters) -> Piece:
        piece, memory, x = stretch.piece, self.memory, self.memory.state
        if stretch.driven and not self.is_driven:
            x[layout.MOVING] = layout.MOVING_DRIVEN
            x[layout.ANCHOR] = x[layout.THETA]
        if stretch.on_base:
            memory.open_loop = True
            return piece._replace(d=memory.base_v[0], q=memory.base_v[1])
        if piece.mode == CONTROL and memory.open_loop:
            # Bumpless transfer: the control starts from the frozen voltage.
            x[layout.INTEGRAL_D] = memory.base_v[0] - control.resistance_ohm * x[layout.COMMAND_D]
            x[layout.INTEGRAL_Q] = memory.base_v[1] - control.resistance_ohm * x[layout.COMMAND_Q]
            memory.open_loop = False
        elif piece.mode == OFF:
            self.forget_control()
        return piece

    def _end(self, stretch: Stretch) -> None:
        if stretch.averaged:
            n = stretch.piece.samples
            self.memory.base_v = (float(self._sums[0]) / n, float(self._sums[1]) / n)
        if stretch.parked and self.is_driven:
            x = self.memory.state
            x[layout.MOVING] = x[layout.OMEGA] = 0.0
            self.turn_to(float(x[layout.ANCHOR]))

    def forget_control(self) -> None:
        """Set-point and integrals to zero, as when the bridge is off."""
        x = self.memory.state
        x[[layout.INTEGRAL_D, layout.INTEGRAL_Q, layout.COMMAND_D, layout.COMMAND_Q]] = 0.0
        self.memory.open_loop, self.memory.base_v = False, (0.0, 0.0)


def _buffers(n: int, three: bool) -> _Buffers:
    phases = np.empty((n, 3) if three else (0, 3), np.float32)
    return np.empty((n, 2), np.float32), np.empty((n, 2), np.float32), np.empty(n, np.float32), phases
