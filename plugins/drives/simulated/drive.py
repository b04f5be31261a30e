"""The simulated drive: permissions, trips, watchdog, link and injected faults, as strict as on hardware.

`_simulator` computes the currents. Simulated time passes only while an excitation (or a ramp) runs,
so that a run does not depend on how long the host takes between two calls.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import ClassVar

from pydantic import BaseModel

from orchestrator.driving import DriveShell
from plugins.drives.simulated._faults import FaultPlan, corrupted
from plugins.drives.simulated._program import Program
from plugins.drives.simulated._simulator import Simulator, Tripped
from plugins.drives.simulated.options import Fault, SimulatedOptions
from plugins.drives.simulated.rig import Rig
from plugins.drives.simulated.truth import describe, write_json
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    FaultCause,
    Limits,
    Telemetry,
)

TRUTH_FILE = "truth.json"


class SimulatedDrive(DriveShell):
    """A drive, its motor and its bench in one process; implements `Drive` and `ResumableDrive`."""

    name: ClassVar[str] = "simulated"
    Options: ClassVar[type[BaseModel]] = SimulatedOptions
    sealed_options: ClassVar[frozenset[str]] = frozenset({"plant"})

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: SimulatedOptions = setup.options
        self._faults = FaultPlan(self._options.faults)
        self._link_lost = self._interlocks_open = False
        self._last_beat = 0.0
        self._connected_rig: Rig | None = None

    # Link

    def open(self) -> Capabilities:
        """Create the plant, compile its loop, seal the truth; raises `InputError` where they describe no motor."""
        setup = self.setup
        self._connected_rig = rig = Rig(self._options, setup.motor, setup.seed)
        if setup.private_directory is not None:
            truth = describe(rig.nameplate, self._plant.plant, setup.seed)
            write_json(setup.private_directory / TRUTH_FILE, truth)
        rig.warm_up()
        return rig.capabilities

    def heartbeat(self) -> None:
        """Feed the watchdog."""
        self._last_beat = time.monotonic()

    # Power stage

    def energise(self, limits: Limits) -> None:
        """Set the limits and start the watchdog."""
        self._rig.limit(limits)
        self.heartbeat()

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Check the excitation against the plant's limits; it runs as blocks are drawn from the iterator."""
        self._rig.permission.check(excitation, braked=self._rig.braked)
        return self._run(excitation)

    def telemetry(self) -> Telemetry:
        """Low-pass filtered readings in the frame of the last excitation."""
        self._check_link()
        self._watch()
        i_d, i_q, v_dc = self._plant.filtered
        time_s = self._plant.time_s
        return Telemetry(
            state=self.state,
            time_s=time_s,
            i_d_a=i_d,
            i_q_a=i_q,
            v_dc_v=v_dc,
            temperature_c=self._plant.temperature_c,
            pwm_frequency_hz=self._rig.pwm_ratio * self._rig.capabilities.pwm_frequency_hz,
            faults=self.faults,
            open_interlocks=self._options.interlocks if self._interlocks_open else (),
        )

    def ramp(self) -> None:
        """Ramp the current to zero under control and hold it there."""
        self._check_link()
        if not self._watch():
            self._controlled(self._rig.ramp_down(), 1)

    def switch_off(self) -> None:
        """Switch the bridge off; a residual current decays through the diodes."""
        self._check_link()
        self._drain(self._rig.gates_off(), 3)

    def forget_fault(self) -> None:
        """Nothing to clear beside what the shell keeps."""
        self._check_link()

    def set_brake(self, engaged: bool) -> None:
        """Engage or release the brake; engaging turns the shaft by the plant's misalignment."""
        self.check_link()
        if not self._options.has_brake:
            raise DriveRefused("this drive has no brake")
        self._rig.set_brake(engaged)

    # Memory

    def checkpoint(self, point_id: str) -> None:
        """Save plant, control, clock and brake, where there is a private directory."""
        if self.setup.private_directory is not None:
            self._rig.save(self.setup.private_directory, point_id, self._faults.fired)

    def restore(self, point_id: str, start_s: float) -> None:
        """Restore the state after a point, with the clock at `start_s`."""
        self.check_link()
        if self.setup.private_directory is None:
            raise DriveRefused("no private directory, so there is no state to restore")
        if self.state is not DriveState.DISARMED:
            raise DriveRefused(f"a state can be restored only while disarmed (now {self.state.value})")
        self._faults.fired = set(self._rig.restore(self.setup.private_directory, point_id))
        if abs(start_s - self._plant.time_s) > 0.5 / self._options.sampling_frequency_hz:
            self._plant.memory.base_s += start_s - self._plant.time_s

    # Excitation

    def _run(self, excitation: Excitation) -> Iterator[Capture]:
        rig, simulator, fs = self._rig, self._plant, self._options.sampling_frequency_hz
        rig.number += 1
        if rig.number > 1 and self._options.gap_s > 0:
            self._controlled(rig.planner.wait(simulator.set_point, self._options.gap_s), 2)
        program = rig.program(excitation)
        due = self._faults.due(rig.number, simulator.time_s, fs, program.samples)
        noise = simulator.noise(0, rig.number)
        pace = _Pace(self._options.realtime_factor)
        corruption: Fault | None = None
        blocks = simulator.run(program, rig.tuning(), rig.pwm_ratio, noise, tuple(due))
        while True:
            try:
                block = next(blocks, None)
            except Tripped as trip:
                raise self._trip_of(trip) from None
            if block is None:
                return
            if isinstance(block, int):
                corruption = self._strike(self._faults.strike(due[block])) or corruption
                continue
            pace.wait(len(block) / fs)
            self.check_link()
            if corruption is not None:
                block, corruption = corrupted(block, corruption), None
            yield block
            self.check_link()

    def _strike(self, fault: Fault) -> Fault | None:
        """Trigger a fault; returns it where it corrupts the next block."""
        match fault.kind:
            case "lost_link":
                self._link_lost = True
                self._check_link()
            case "stuck":
                time.sleep(fault.timeout_s)
                raise DriveFault(FaultCause.NO_ANSWER, f"no data for {fault.timeout_s:g} s")
            case "slow":
                time.sleep(fault.sleep_s)
            case "trip":
                raise self.trip(DriveFault(FaultCause(fault.cause), "the drive tripped"))
            case "exception":
                raise RuntimeError("the drive plugin failed")
            case "interlock":
                self._interlocks_open = True
            case "wrong_data":
                return fault
        return None

    def _trip_of(self, trip: Tripped) -> DriveFault:
        if trip.overload:
            return self.trip(DriveFault(FaultCause.OVERTEMPERATURE, "overload protection"))
        return self.trip(DriveFault(FaultCause.OVERCURRENT, f"current above {self._rig.trip_a:.4g} A"))

    def _controlled(self, program: Program, kind: int) -> None:
        try:
            self._drain(program, kind)
        except Tripped as trip:
            raise self._trip_of(trip) from None

    def _drain(self, program: Program, kind: int) -> None:
        noise = self._plant.noise(kind, self._rig.number)
        for _ in self._plant.run(program, self._rig.tuning(), 1.0, noise, ()):
            pass

    # Watchdog and link

    def check_link(self) -> None:
        """Raise `DriveFault` where the link is lost or the watchdog has acted."""
        self._check_link()
        if self._watch():
            raise self.latched[-1]

    def _check_link(self) -> None:
        if self._link_lost:
            raise DriveFault(FaultCause.LINK_LOST, "the drive does not answer")

    def _watch(self) -> bool:
        """Whether the drive's watchdog has just acted."""
        watchdog = self._options.watchdog_s
        if self.state is not DriveState.ARMED or watchdog is None:
            return False
        if time.monotonic() - self._last_beat <= watchdog:
            return False
        self._controlled(self._rig.ramp_down(), 1)
        problem = f"no heartbeat for {watchdog:g} s, this computer may be too busy; current ramped down, bridge off"
        self.trip(DriveFault(FaultCause.HEARTBEAT_LOST, problem))
        return True

    # Plant

    @property
    def _rig(self) -> Rig:
        if self._connected_rig is None:
            raise DriveRefused("not connected")
        return self._connected_rig

    @property
    def _plant(self) -> Simulator:
        return self._rig.simulator


class _Pace:
    """Keeps simulated time from running ahead of the wall clock, scaled by a factor."""

    def __init__(self, factor: float | None) -> None:
        self._factor, self._due = factor, time.monotonic()

    def wait(self, seconds: float) -> None:
        if self._factor is None:
            return
        self._due += seconds / self._factor
        time.sleep(max(0.0, self._due - time.monotonic()))
