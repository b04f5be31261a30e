"""A scripted drive for trying the drive kit on: an ideal R-L motor, computed backwards from its current.

No plant and no controller: the current equals its set-point, the voltage is what it takes. The
watchdog and the state of the power stage are real, so that the kit meets a drive as strict as
hardware.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    FaultCause,
    Hold,
    Injection,
    Limits,
    NoOptions,
    Telemetry,
    Trapezoid,
)

FS = 10000.0
INDUCTANCE_H = 0.05
RISE_PER_JOULE = 3e-3
"""Much too large for a real motor: one excitation shows in the next one's voltage."""

Complex = NDArray[np.complexfloating[Any, Any]]


class ExampleDrive:
    """R-L motor at zero speed; R rises with the heat that went in."""

    name: ClassVar[str] = "example"
    Options: ClassVar[type[BaseModel]] = NoOptions
    sealed_options: ClassVar[frozenset[str]] = frozenset()

    capabilities: ClassVar[Capabilities] = Capabilities(
        name="example",
        sampling_frequency_hz=FS,
        pwm_frequency_hz=10000.0,
        pwm_frequencies_hz=(5000.0, 10000.0),
        dc_bus_voltage_v=540.0,
        max_current_a=6.0,
        max_voltage_v=300.0,
        excitations=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
        watchdog_s=0.05,
        watchdog_covers=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
        clock_is_simulated=True,
    )

    def __init__(self, setup: DriveSetup) -> None:
        self.setup = setup
        self.limits: Limits | None = None
        self.state = DriveState.DISARMED
        self.faults: tuple[str, ...] = ()
        self.current = 0j
        self.clock_s = 0.0
        self.pwm_frequency_hz: float | None = None
        self.bridge_on = False
        self.heat_j = 0.0
        self.beaten = time.monotonic()

    def connect(self) -> Capabilities:
        return self.capabilities

    def arm(self, limits: Limits) -> None:
        if self.state is DriveState.FAULTED:
            raise DriveRefused("a fault is latched")
        if limits.current_a > self.capabilities.max_current_a or limits.voltage_v > self.capabilities.max_voltage_v:
            raise DriveRefused("limits above the drive's own")
        self.limits, self.state, self.bridge_on = limits, DriveState.ARMED, True
        self.heartbeat()

    def heartbeat(self) -> None:
        self.beaten = time.monotonic()

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        self.watch()
        if self.state is not DriveState.ARMED:
            raise DriveRefused(f"the drive is {self.state.value}")
        if excitation.kind not in self.capabilities.excitations:
            raise DriveRefused(f"no {excitation.kind}")
        if excitation.pwm_frequency_hz not in (None, *self.capabilities.pwm_frequencies_hz):
            raise DriveRefused("no such PWM frequency")
        self.check(excitation)
        self.pwm_frequency_hz = excitation.pwm_frequency_hz or self.capabilities.pwm_frequency_hz
        self.clock_s += excitation.settling_s
        if not isinstance(excitation, Trapezoid):
            yield self.block(excitation, np.zeros(0, dtype=complex), np.zeros(0, dtype=complex))
        i, v = self.waveforms(excitation)
        for part_i, part_v in zip(
            *(np.array_split(x, -(-len(i) // max(1, int(self.fs / 2)))) for x in (i, v)), strict=True
        ):
            self.watch()
            self.current = complex(part_i[-1])
            yield self.block(excitation, part_i, part_v)
        self.current = self.rests_at(excitation)

    def block(self, excitation: Excitation, i: Complex, v: Complex) -> Capture:
        """One block in the stator frame; clock and heat go on."""
        turn = np.exp(1j * excitation.rotor_angle_rad)
        start_s, self.clock_s = self.clock_s, self.clock_s + len(i) / self.fs
        self.heat_j += 1.5 * float(np.sum(np.abs(i) ** 2)) * self.resistance_ohm / self.fs
        return Capture(
            start_s=start_s,
            sampling_frequency_hz=self.fs,
            i_ab=np.stack([(i * turn).real, (i * turn).imag], axis=1),
            v_ab=np.stack([(v * turn).real, (v * turn).imag], axis=1),
            v_dc=np.full(len(i), 540.0),
        )

    @property
    def fs(self) -> float:
        return self.capabilities.sampling_frequency_hz

    @property
    def resistance_ohm(self) -> float:
        return 4.0 * (1.0 + RISE_PER_JOULE * self.heat_j)

    def check(self, excitation: Excitation) -> None:
        """Refuse what does not fit into the limits; written so that NaN does not fit either."""
        assert self.limits is not None
        i, v = self.waveforms(excitation)
        if isinstance(excitation, Injection):
            i = np.full(1, complex(excitation.target_d_a, excitation.target_q_a))
        if not np.abs(i).max() <= self.limits.current_a or not np.abs(v).max() <= self.limits.voltage_v:
            raise DriveRefused("past the limits")

    def waveforms(self, excitation: Excitation) -> tuple[Complex, Complex]:
        """Current and voltage (d + jq) of what is captured."""
        if isinstance(excitation, Injection):
            return self.injection(excitation)
        if isinstance(excitation, Trapezoid):
            t = np.arange(excitation.rows(self.fs)) / self.fs
            wave = np.interp(t / excitation.period_s % 1, [0, 0.125, 0.375, 0.625, 0.875, 1], [0, 1, 1, -1, -1, 0])
            swept = excitation.amplitude_a * wave
            held = excitation.held_a
            paths: dict[str, Complex] = {
                "d": swept + 1j * held,
                "q": held + 1j * swept,
                "dq": swept * (1 + 1j) / np.sqrt(2),
            }
            i_dq = paths[excitation.swept_axis]
            rise = np.gradient(i_dq, 1 / self.fs)
            return i_dq, self.resistance_ohm * i_dq + INDUCTANCE_H * rise
        rows = excitation.rows(self.fs)
        if excitation.kind == "gates_off":
            return np.zeros(rows, dtype=complex), np.zeros(rows, dtype=complex)
        if not isinstance(excitation, Hold):
            raise DriveRefused(f"no {excitation.kind} on this bench")
        i_dq = np.full(rows, complex(excitation.current_d_a, excitation.current_q_a))
        return i_dq, self.resistance_ohm * i_dq

    def injection(self, excitation: Injection) -> tuple[Complex, Complex]:
        t = excitation.discard_s + np.arange(excitation.rows(self.fs)) / self.fs
        phase = np.round(excitation.frequency_hz * t, 9) % 1.0
        wave = np.where(phase < 0.5, 1.0, -1.0) if excitation.waveform == "square" else np.sin(2 * np.pi * phase)
        turn = np.exp(2j * np.pi * excitation.rotation_hz * t)
        base = complex(excitation.target_d_a, excitation.target_q_a)
        flux = np.cumsum(wave) - wave
        i = base + excitation.amplitude_v * turn * (flux - flux.mean()) / self.fs / INDUCTANCE_H
        return i, self.resistance_ohm * base + excitation.amplitude_v * turn * wave

    def rests_at(self, excitation: Excitation) -> complex:
        """Where the drive stays after the last block."""
        if isinstance(excitation, Injection):
            return complex(excitation.target_d_a, excitation.target_q_a)
        return self.current

    def watch(self) -> None:
        """The dead man."""
        assert self.capabilities.watchdog_s is not None
        if self.state is DriveState.ARMED and time.monotonic() - self.beaten > self.capabilities.watchdog_s:
            self.state, self.faults, self.current = DriveState.FAULTED, ("heartbeat_lost",), 0j
            raise DriveFault(FaultCause.HEARTBEAT_LOST, "no heartbeat")

    def telemetry(self) -> Telemetry:
        return Telemetry(
            state=self.state,
            time_s=self.clock_s,
            i_d_a=self.current.real,
            i_q_a=self.current.imag,
            v_dc_v=540.0,
            pwm_frequency_hz=self.pwm_frequency_hz,
            faults=self.faults,
        )

    def ramp_down(self) -> None:
        self.current = 0j

    def disarm(self) -> None:
        self.current, self.bridge_on = 0j, False
        if self.state is DriveState.ARMED:
            self.state = DriveState.DISARMED

    def clear_fault(self) -> None:
        self.state, self.faults = DriveState.DISARMED, ()

    def set_brake(self, engaged: bool) -> None:
        raise DriveRefused("no brake")

    def close(self) -> None:
        pass

    def saved(self, point_id: str) -> Path:
        assert self.setup.private_directory is not None
        return self.setup.private_directory / f"{point_id}.json"

    def checkpoint(self, point_id: str) -> None:
        self.saved(point_id).write_text(json.dumps({"heat_j": self.heat_j}), encoding="utf-8")

    def restore(self, point_id: str, start_s: float) -> None:
        self.heat_j = json.loads(self.saved(point_id).read_text(encoding="utf-8"))["heat_j"]
        self.clock_s = start_s
