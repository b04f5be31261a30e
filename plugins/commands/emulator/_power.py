"""The power stage: state, running program, and protections that act on their own.

It keeps the clocks of the plant and of the heartbeat; `_device` interprets commands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._log import Log
from plugins.commands.emulator._memory import Capture
from plugins.drives.simulated.rig import Rig, Step, Tripped, is_ramp
from plugins.wire import Fault, Heartbeat, Message, Phase, PowerState, Watchdog
from protocols import Excitation, GatesOff, Limits

_RUNNING_STEP_S = 2.5e-3
_IDLE_STEP_S = 2e-2
_FREE_STEP_S = 5e-2
_BUS_LIMITS_RATIO = (0.5, 1.3)
"""Range of the bus voltage over the nominal one; the drive trips outside it."""
_ENERGISED = (PowerState.HOLDING, PowerState.RUNNING, PowerState.STOPPING)


class PowerStage:
    """Plant, watchdog and protections.

    Parameters
    ----------
    rig : Rig
    clock : callable
        Wall time [s], monotonic.
    speed : float, optional
        Simulated over wall time. None: as fast as possible while a program runs; between programs
        simulated time stops.
    log : Log
    directory : Path, optional
        Folder for the plant's state, saved whenever the gates are switched off.
    read_interlocks : callable
        Returns the bits of the open interlock inputs.
    """

    def __init__(
        self,
        rig: Rig,
        clock: Callable[[], float],
        speed: float | None,
        log: Log,
        directory: Path | None,
        read_interlocks: Callable[[], int],
    ) -> None:
        self.rig, self.speed, self.log = rig, speed, log
        self._read_interlocks = read_interlocks
        self.open_interlocks = 0
        """Bits of the inputs that were open at the last `guard`."""
        self._clock, self._directory = clock, directory
        self._fs = rig.options.sampling_frequency_hz
        limit_s = rig.options.watchdog_s
        self._watchdog = None if limit_s is None else Watchdog(limit_s)
        self.state, self.phase = PowerState.DISARMED, Phase.IDLE
        self.cause, self.faults, self.value, self.limit = Fault.NONE, 0, 0.0, 0.0
        self.capture: Capture | None = None
        self.capture_start = 0
        self.energy_j = 0.0
        self._pwm = False
        self._limits: Limits | None = None
        self._armed_at = 0
        self._fed_s = self._tripped_s = self._since_s = clock()
        self._off_after = self._recording = False
        self._begun_at = self._due_at = 0
        self._samples = max(
            1, round(self._fs * (_FREE_STEP_S if speed is None else _RUNNING_STEP_S * min(speed, 20.0)))
        )
        self._idle = self._samples if speed is None else max(1, round(self._fs * _IDLE_STEP_S * min(speed, 20.0)))
        self._steps: Iterator[Step] = rig.off(self._idle)
        self._next = self._idle
        self._anchor = (clock(), rig.ticks)

    # Commands

    @property
    def energised(self) -> bool:
        return self.state in _ENERGISED

    @property
    def last_beat(self) -> int:
        return 0 if self._watchdog is None else self._watchdog.last_seq

    def feed(self, beat: Heartbeat, session: int, now_s: float) -> None:
        """Feed the watchdog by a heartbeat."""
        if self.energised and self._watchdog is not None and self._watchdog.feed(beat, session, now_s):
            self._fed_s = now_s

    def arm(self, limits: Limits) -> None:
        """Switch PWM on, at zero current."""
        self._fed_s = self._clock()
        if self._watchdog is not None:
            self._watchdog.start(self._fed_s)
        self._limits, self._armed_at, self.energy_j = limits, self.rig.ticks, 0.0
        self.rig.limit(limits)
        self._pwm, self.state, self.phase = True, PowerState.HOLDING, Phase.IDLE
        self._off_after = False
        self._set_steps(self.rig.hold(self._samples))

    def run(self, excitation: Excitation, capture: Capture) -> None:
        """Start a program from the present operating point."""
        self.capture, self.capture_start = capture, 0
        self.state, self.phase = PowerState.RUNNING, Phase.RAMPING
        self._off_after, self._recording = isinstance(excitation, GatesOff), False
        self._begun_at, self._due_at = self.rig.ticks, self.rig.ticks + self.rig.length(excitation)
        self._set_steps(self.rig.excite(excitation, self._samples))

    def record(self, capture: Capture) -> None:
        """Capture at the held operating point."""
        self.capture, self.capture_start = capture, 0
        self._recording = True
        self._set_steps(self.rig.record(capture.rows, self._off_after, self._samples))

    def stop(self) -> None:
        """Abort the program and ramp the current to zero, if PWM is on."""
        if not self.energised or self.state is PowerState.STOPPING:
            return
        self._abort_capture()
        if self._off_after and self.state is PowerState.HOLDING:
            return
        self._off_after = False
        self.state = PowerState.STOPPING
        self._set_steps(self.rig.to_zero(self._samples))

    def disarm(self) -> None:
        """Switch PWM off; a fault stays latched."""
        self._abort_capture()
        if self._pwm:
            self._gates_off()
        if self.state is not PowerState.FAULTED:
            self.state = PowerState.DISARMED

    def clear(self) -> None:
        """Clear latched faults; the state is disarmed afterwards."""
        if self.state is PowerState.FAULTED:
            self.disarm()
            self.state = PowerState.DISARMED
        self.cause, self.faults, self.value, self.limit = Fault.NONE, 0, 0.0, 0.0

    def shut_down(self) -> None:
        """Go to the safe state before the process ends."""
        begun_s = self._clock()
        self._abort_capture()
        try:
            for _ in self.rig.to_safety(self._samples):
                pass
        except Tripped as trip:
            self.log("fault", cause=_name(Fault.OVERLOAD if trip.overload else Fault.OVERCURRENT), first="ended")
        self.state = PowerState.DISARMED
        self._gates_off()
        self.log("safe", cause="ended", latency_s=round(self._clock() - begun_s, 6))

    # Protections

    def guard(self, now_s: float) -> None:
        """Check watchdog and interlocks; to be called before the link is read, so that late frames have no effect."""
        self.open_interlocks = self._read_interlocks()
        if self.energised and self.open_interlocks:
            self.trip(Fault.INTERLOCK, float(self.open_interlocks))
        if self.energised and self._watchdog is not None and self._watchdog.expired(now_s):
            self.trip(Fault.WATCHDOG, now_s - self._fed_s, self._watchdog.limit_s, since_s=self._fed_s)
        if self.state is PowerState.FAULTED and self._pwm and now_s - self._tripped_s > BOUNDS.max_trip_delay_s:
            self._gates_off()

    def trip(
        self,
        fault: Fault,
        value: float = 0.0,
        limit: float = 0.0,
        *,
        at_once: bool = False,
        since_s: float | None = None,
    ) -> None:
        """Latch a fault and go to the safe state: current to zero and PWM off, or PWM off at once."""
        if self.faults >> fault & 1:
            return
        now_s = self._clock()
        if self.cause is Fault.NONE:
            self.cause, self.value, self.limit = fault, value, limit
            self._since_s = now_s if since_s is None else since_s
        self.faults |= 1 << fault
        self.log(
            "fault",
            cause=_name(fault),
            first=_name(self.cause),
            value=value,
            limit=limit,
            since_beat_s=self._age(now_s),
        )
        was_energised = self.energised
        self._abort_capture()
        self.state = PowerState.FAULTED
        if at_once and self._pwm:
            self._gates_off()
        elif was_energised:
            self._tripped_s = now_s
            self._set_steps(self.rig.to_safety(self._samples))

    def _gates_off(self) -> None:
        now_s = self._clock()
        self._pwm = False
        self.rig.drain()
        self._set_steps(self.rig.off(self._idle), self._idle)
        if self.state is PowerState.FAULTED:
            latency_s = round(now_s - self._since_s, 6)
            self.log("safe", cause=_name(self.cause), latency_s=latency_s, since_beat_s=self._age(now_s))
        if self._directory is not None:
            self.rig.save(self._directory)

    def _age(self, now_s: float) -> float:
        return round(now_s - self._fed_s, 6)

    def _abort_capture(self) -> None:
        if self.state is PowerState.RUNNING or self._recording:
            self.phase, self._recording = Phase.GIVEN_UP, False

    # Time

    def advance(self) -> list[Message]:
        """Advance the plant by the time that is due; returns live ripple rows."""
        begun_s, messages = self._clock(), list[Message]()
        while self._is_due() and self._clock() - begun_s < BOUNDS.max_turn_s:
            messages += self._step()
        return messages

    def wait_s(self) -> float:
        """Time until the next step is due [s]."""
        if self.speed is None:
            return 0.0 if self._is_due() else 0.02
        anchor_s, ticks = self._anchor
        due_s = anchor_s + (self.rig.ticks + self._next - ticks) / (self.speed * self._fs)
        return min(0.02, max(0.0, due_s - self._clock()))

    def _is_due(self) -> bool:
        if self.speed is None:
            ramping = self.state is PowerState.FAULTED and self._pwm
            return ramping or self._recording or self.state in (PowerState.RUNNING, PowerState.STOPPING)
        anchor_s, ticks = self._anchor
        behind = (self._clock() - anchor_s) * self.speed * self._fs - (self.rig.ticks - ticks)
        if behind > BOUNDS.max_catch_up_s * self.speed * self._fs + self._next:
            self._anchor = (self._clock(), self.rig.ticks)
            return True
        return behind >= self._next

    def _set_steps(self, steps: Iterator[Step], samples: int = 0) -> None:
        if self.speed is not None and self._next != (samples or self._samples):
            # On a change from a coarse to a fine grid, steps that are not due yet would delay the start.
            self._anchor = (self._clock(), self.rig.ticks)
        self._steps, self._next = steps, samples or self._samples

    def _step(self) -> list[Message]:
        try:
            step = next(self._steps, None)
        except Tripped as trip:
            if trip.overload:
                self.trip(Fault.OVERLOAD, at_once=True)
            else:
                self.trip(Fault.OVERCURRENT, self.rig.reading_a, self.rig.trip_a, at_once=True)
            return []
        if step is None:
            self._finished()
            return []
        self._watch(step)
        return self._captured(step)

    def _finished(self) -> None:
        if self.state is PowerState.FAULTED:
            self._gates_off()
            return
        if self.state is PowerState.RUNNING or self._recording:
            self.phase, self._recording = Phase.COMPLETE, False
            self.log("complete", capture=self.capture.number if self.capture else 0)
        self.state = PowerState.HOLDING
        self._set_steps(self.rig.off(self._samples) if self._off_after else self.rig.hold(self._samples))

    def _captured(self, step: Step) -> list[Message]:
        if self.state is not PowerState.RUNNING and not self._recording:
            return []
        if not step.stretch.captured or self.capture is None:
            self.phase = Phase.RAMPING if is_ramp(step.stretch) else Phase.SETTLING
            return []
        if self.phase is not Phase.CAPTURING:
            self.phase = Phase.CAPTURING
            self.capture_start = self.rig.ticks - len(step.i_ab)
            if self.capture.ripple is not None:
                self.capture.ripple.base_v = self.rig.simulator.memory.base_v
        return self.capture.take(step)

    def _watch(self, step: Step) -> None:
        """Check energy, durations and bus voltage, which the step loop does not."""
        if not self.energised or self._limits is None:
            return
        squares = float(np.einsum("nk,nk->", step.i_ab, step.i_ab, dtype=np.float64))
        self.energy_j += 1.5 * self.rig.nameplate.resistance_ohm * squares / self._fs
        duration_s = (self.rig.ticks - self._armed_at) / self._fs
        for used, limit in ((self.energy_j, self._limits.energy_j), (duration_s, self._limits.duration_s)):
            if limit is not None and used > limit:
                self.trip(Fault.LIMIT, used, limit)
        if self.state is PowerState.RUNNING and self.rig.ticks > self._due_at:
            taken, allowed = self.rig.ticks - self._begun_at, self._due_at - self._begun_at
            self.trip(Fault.PROGRAM_TOO_LONG, taken / self._fs, allowed / self._fs)
        nominal, v_dc = self.rig.capabilities.dc_bus_voltage_v, float(step.v_dc[-1])
        if not _BUS_LIMITS_RATIO[0] * nominal <= v_dc <= _BUS_LIMITS_RATIO[1] * nominal:
            edge = _BUS_LIMITS_RATIO[v_dc > nominal] * nominal
            self.trip(Fault.BUS_VOLTAGE, v_dc, edge)


def _name(fault: Fault) -> str:
    return fault.name.lower()
