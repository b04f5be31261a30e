"""Base class of drives with a polled board: clock of the experiment by the host, held current vector, keepalives.

A subclass of `PolledDrive` sets `board` and gives `board_fault`, beside what `DriveShell` requires.
"""

from __future__ import annotations

import cmath
import time
from collections.abc import Callable, Generator, Iterator
from typing import ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from orchestrator.driving import DriveShell, in_blocks, keepalive
from protocols import Capture, DriveFault, DriveRefused, DriveSetup, Excitation, FaultCause, Telemetry


class Board(Protocol):
    """A board at the other end of an open link."""

    def check(self) -> None:
        """Raise `DriveFault` where the link is lost."""
        ...

    def close(self) -> None:
        """Close the link."""
        ...


BoardT = TypeVar("BoardT", bound=Board)


class PolledDrive(DriveShell, Generic[BoardT]):
    """Base of a drive that polls its board; with its clock it implements `ResumableDrive`.

    Attributes
    ----------
    board : Board or None
        To be set by `open`; None while the drive is not connected.
    target_a : complex
        Current vector that the board holds, i_alpha + j i_beta [A].
    rotor_angle_rad : float
        Believed rotor angle of the last excitation.
    origin_s : float
        Instant of the host's monotonic clock at which the experiment began.
    """

    keepalive_period_s: ClassVar[float] = 0.2
    """Longest time without a block."""

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self.board: BoardT | None = None
        self.target_a, self.rotor_angle_rad, self.origin_s = 0j, 0.0, 0.0

    def connected(self) -> BoardT:
        """The board; raises `DriveRefused` where it is not connected, `DriveFault` where the link is lost."""
        if self.board is None:
            raise DriveRefused("not connected")
        self.board.check()
        return self.board

    def release(self) -> None:
        """Close the link."""
        board, self.board = self.board, None
        if board is not None:
            board.close()

    def board_fault(self) -> DriveFault | None:
        """The present fault of the armed board; None without one."""
        return None

    @property
    def faults(self) -> tuple[str, ...]:
        return tuple(f"{fault.cause.value}: {fault.detail}" for fault in self.latched)

    def check_link(self) -> None:
        """Raise `DriveFault` where the link is lost or the armed board has tripped."""
        self.connected()
        if self.limits is not None and not self.latched:
            self.require_sound(self.board_fault())

    def require_sound(self, fault: DriveFault | None) -> None:
        """Trip on a fault and raise it; nothing where it is None."""
        if fault is not None:
            raise self.trip(fault)

    def aim(self, excitation: Excitation) -> None:
        """Take target and rotor angle from an excitation."""
        self.rotor_angle_rad = excitation.rotor_angle_rad
        self.target_a = complex(*excitation.start_dq_a) * cmath.exp(1j * excitation.rotor_angle_rad)

    def tripping(self, blocks: Iterator[Capture]) -> Generator[Capture]:
        """The blocks; a `DriveFault` among them trips the drive."""
        try:
            yield from blocks
        except DriveFault as fault:
            raise self.trip(fault) from None

    def waiting(self, wait_s: float) -> Generator[Capture]:
        """Wait, with keepalives."""
        until_s = time.monotonic() + wait_s
        while (remaining_s := until_s - time.monotonic()) > 0.0:
            time.sleep(min(remaining_s, self.keepalive_period_s))
            yield self.keepalive()

    def await_zero_current(self, flows: Callable[[], bool], timeout_s: float) -> None:
        """Wait until no current flows; raises `DriveFault` (no_answer) where one still does after this time."""
        deadline = time.monotonic() + timeout_s
        while flows():
            if time.monotonic() > deadline:
                message = f"a current still flows after {timeout_s:g} s of ramping down"
                raise DriveFault(FaultCause.NO_ANSWER, message)

    def keepalive(self) -> Capture:
        """A block without rows, now."""
        return keepalive(self.now_s(), self.own.sampling_frequency_hz)

    def blocks(
        self, i: NDArray[np.complex128], v: NDArray[np.complex128], start_s: float, v_dc: NDArray[np.float64] | float
    ) -> Iterator[Capture]:
        """Blocks of current and voltage vectors (n,), alpha + j beta; `start_s` by the experiment's clock."""
        i_ab, v_ab = (np.stack([x.real, x.imag], axis=1).astype(np.float32) for x in (i, v))
        fs, bus = self.own.sampling_frequency_hz, np.full(len(i), v_dc, np.float32)
        return in_blocks(Capture(start_s=start_s, sampling_frequency_hz=fs, i_ab=i_ab, v_ab=v_ab, v_dc=bus))

    def reading(self, i_dq: complex, v_dc: float, pwm_frequency_hz: float | None = None) -> Telemetry:
        """Telemetry of currents i_d + j i_q [A] and a bus voltage, now."""
        return Telemetry(
            state=self.state,
            time_s=self.now_s(),
            i_d_a=i_dq.real,
            i_q_a=i_dq.imag,
            v_dc_v=v_dc,
            pwm_frequency_hz=pwm_frequency_hz,
            faults=self.faults,
        )

    # Clock

    def now_s(self) -> float:
        """Time since the experiment began."""
        return time.monotonic() - self.origin_s

    def checkpoint(self, point_id: str) -> None:
        """Does nothing: real hardware needs no saved state."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Let the experiment's clock go on from `start_s`."""
        self.origin_s = time.monotonic() - start_s
