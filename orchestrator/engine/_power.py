"""The one owner of an energised drive: arms it, sends its heartbeat and shuts it down.

However the energised time ends (finished, an exception, a signal, a lost link), `stand_down` ramps
the current to zero, switches PWM off, and reports what failed.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import TypeVar

from pydantic import ValidationError

from orchestrator.driving.readings import check_telemetry, impossible_reading
from orchestrator.engine._heartbeat import LEASE_S, HeartbeatKeeper
from orchestrator.engine._interrupts import Interrupts
from protocols import (
    Capabilities,
    Capture,
    Drive,
    DriveFault,
    DriveState,
    Excitation,
    FaultCause,
    FluxbenchError,
    Limits,
    Telemetry,
)

T = TypeVar("T")

DISARMED_TEXT = "current ramped down, drive disarmed"

SHUTDOWN_TIMEOUT_S = 10.0
"""Longest ramp-down, and disarming, before the drive counts as lost."""


class PowerStage:
    """A drive's power stage, owned by one run.

    Parameters
    ----------
    drive : Drive
        Connected.
    capabilities : Capabilities
    limits : Limits
        Handed to the drive each time it is armed.
    interrupts : Interrupts
        Enforces deadlines, so that a drive that does not return cannot block the shutdown.
    """

    def __init__(self, drive: Drive, capabilities: Capabilities, limits: Limits, interrupts: Interrupts) -> None:
        self._drive, self._capabilities, self._limits = drive, capabilities, limits
        self._interrupts = interrupts
        self._keeper: HeartbeatKeeper | None = None
        self.unsafe: FluxbenchError | None = None
        """Why the drive may still be energised after the command to disarm."""

    @property
    def armed(self) -> bool:
        return self._keeper is not None

    def telemetry(self) -> Telemetry:
        """A reading, now."""
        return check_telemetry(self._unchecked_telemetry(), self._capabilities, self._limits)

    def _unchecked_telemetry(self) -> Telemetry:
        with as_drive_errors(self._capabilities.name):
            return self._drive.telemetry()

    def verify_at_rest(self) -> None:
        """Raise `DriveFault` where the drive is not disarmed, or has an uncleared fault."""
        telemetry = self.telemetry()
        if telemetry.state is not DriveState.DISARMED or telemetry.faults:
            faults = ", ".join(telemetry.faults) or "none"
            raise DriveFault(
                FaultCause.INTERNAL,
                f"{self._capabilities.name} should be disarmed without faults, "
                f"but is {telemetry.state.value} with faults: {faults}",
            )

    def require_interlocks(self) -> None:
        """Raise `DriveFault` where one of the drive's interlock inputs forbids power."""
        if not self._capabilities.interlocks:
            return
        open_inputs = self.telemetry().open_interlocks
        if open_inputs:
            message = f"interlock open: {', '.join(open_inputs)}; close it, and resume"
            raise DriveFault(FaultCause.EMERGENCY_STOP, message)

    def arm(self) -> None:
        """Energise and start the heartbeat, with the interlocks closed; no effect where already armed."""
        self.require_interlocks()
        if self.armed:
            return
        with as_drive_errors(self._capabilities.name):
            keeper = HeartbeatKeeper(self._drive, self._capabilities.watchdog_s)
        try:
            with as_drive_errors(self._capabilities.name):
                self._drive.arm(self._limits)
        except BaseException:
            keeper.close()
            raise
        self._keeper = keeper.__enter__()

    def execute(self, excitation: Excitation, quiet_s: float) -> Generator[Capture]:
        """Run one excitation on the armed drive; `quiet_s` may pass before the first block comes."""
        if self._keeper is None:
            raise RuntimeError("execute before arm")
        self._keeper.renew(quiet_s)
        blocks = self._within_deadline(lambda: self._drive.execute(excitation), LEASE_S)
        timeout_s = quiet_s + LEASE_S
        while (capture := self._within_deadline(lambda: next(blocks, None), timeout_s)) is not None:
            self._keeper.renew()
            timeout_s = LEASE_S
            yield self._checked(capture)
        self._keeper.renew()

    def _within_deadline(self, call: Callable[[], T], seconds: float) -> T:
        with as_drive_errors(self._capabilities.name), self._interrupts.deadline(seconds):
            return call()

    def _checked(self, capture: object) -> Capture:
        """A plugin's capture after validation, by reference."""
        try:
            return Capture.model_validate(dict(capture) if isinstance(capture, Capture) else capture)
        except ValidationError as error:
            raise impossible_reading(self._capabilities.name, error) from None

    def set_brake(self, engaged: bool) -> None:
        """Move the drive's brake, where it has one."""
        if self._capabilities.has_brake:
            with as_drive_errors(self._capabilities.name):
                self._drive.set_brake(engaged)

    def stand_down(self) -> str:
        """Ramp to zero, disarm, stop the heartbeat. Never raises; returns the result as text, empty if disarmed."""
        if self._keeper is None:
            return ""
        failed_ramp = self._attempt(self._drive.ramp_down)
        self._keeper.renew()
        self.unsafe = self._attempt(self._disarm)
        self._keeper.close()
        self._keeper = None
        failures = {"ramping down": failed_ramp, "disarming": self.unsafe}
        failed = "; ".join(f"{deed} failed ({error})" for deed, error in failures.items() if error is not None)
        return f"{failed}; {self._remaining_safeguard()}" if failed else DISARMED_TEXT

    def _remaining_safeguard(self) -> str:
        """The remaining protection from a drive that ignored a command."""
        if isinstance(self.unsafe, DriveFault) and self.unsafe.cause is FaultCause.STILL_ARMED:
            return "THE DRIVE MAY STILL BE ARMED: CUT ITS POWER"
        watchdog = self._capabilities.watchdog_s
        if watchdog is None:
            return "it has no watchdog: CUT ITS POWER"
        return f"its watchdog makes it safe within {watchdog:g} s"

    def _disarm(self) -> None:
        """PWM off; raises `DriveFault` where the drive says that it is armed all the same."""
        self._drive.disarm()
        try:
            is_armed = self._unchecked_telemetry().state is DriveState.ARMED
        except FluxbenchError:
            return  # it took the command; no telemetry contradicts it
        if is_armed:
            raise DriveFault(FaultCause.STILL_ARMED, "after disarming, its telemetry says that it is armed")

    def _attempt(self, call: Callable[[], None]) -> FluxbenchError | None:
        try:
            with as_drive_errors(self._capabilities.name), self._interrupts.deadline(SHUTDOWN_TIMEOUT_S):
                call()
        except FluxbenchError as error:
            return error
        return None


@contextmanager
def as_drive_errors(name: str) -> Iterator[None]:
    """Context that turns foreign exceptions of a drive plugin into a `DriveFault`."""
    try:
        yield
    except (FluxbenchError, GeneratorExit):
        raise
    except ValidationError as error:
        raise impossible_reading(name, error) from None
    except (Exception, SystemExit) as error:  # a plugin that leaves must not take the run with it
        raise DriveFault(
            FaultCause.INTERNAL, f"the drive plugin {name!r} raised {type(error).__name__}: {error}"
        ) from error
